"""Holding the goal: it is to be stayed in, not passed through. In passing, a hand above the table can look like one on it.

The goal's error at a step becomes its mean over that step and all later ones, and the plan rests, from its arrival on, at the mean of what
is imagined from there.

>>> resting(torch.tensor([[9.0, 0.0, 6.0, 3.0]])).tolist()
[[4.5, 3.0, 4.5, 3.0]]
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from preimage.ideas.residuals import residuals_of
from preimage.method.seam import Draft, ErrorTerm, Objective, Problem, summed_errors
from preimage.network.pdvmrnn import Generated


def resting(error: Float[Tensor, "B T"]) -> Float[Tensor, "B T"]:
    """The mean of the error over a step and all that follow: what it is to arrive there and stay."""
    num_later = torch.arange(error.shape[1], 0, -1, device=error.device)
    return error.flip(1).cumsum(1).flip(1) / num_later


@dataclass(frozen=True, eq=False)
class Held:
    """The sum of other terms, held from the arrival on."""

    terms: Sequence[ErrorTerm]

    def errors(self, generated: Generated) -> Float[Tensor, "B T"]:
        return resting(summed_errors(self.terms, generated))

    def residuals(self, generated: Generated, arrival: Int[Tensor, " B"]) -> Float[Tensor, "B R"]:
        later = torch.arange(generated.pixels.shape[1], device=arrival.device) >= arrival[:, None]
        shares = (later / later.sum(1, keepdim=True)).sqrt().to(generated.pixels.dtype)  # (B, T)
        steps = Generated(generated.pixels.flatten(0, 1)[:, None], generated.log_codes.flatten(0, 1)[:, None])
        first = arrival.new_zeros(shares.numel())
        each = [residuals_of(term, steps, first).to(shares.dtype).unflatten(0, shares.shape) for term in self.terms]
        return torch.cat([(residuals * shares[..., None]).flatten(1) for residuals in each], dim=1)

    def num_steps(self, arrival: Int[Tensor, " B"]) -> None:
        """All of them."""
        return None


def hold_goal(problem: Problem, terms: Sequence[ErrorTerm]) -> Sequence[ErrorTerm]:
    """All terms so far, held."""
    return [Held(terms)]


def rest_at_goal(draft: Draft, problem: Problem, objective: Objective) -> Draft:
    """From the arrival on, the mean of the joints that are imagined from there, without the sway of single steps."""
    joints = draft.joints.clone()
    joints[draft.arrival :] = joints[draft.arrival :].mean(0)
    return replace(draft, joints=joints)
