"""Gripper events: moments at which a gripper closes about an object, and opens again.

Between them the robot moves, and how is its own affair; at them it has to be in the right place, and before the last of them nothing has
been achieved. They are found where one joint is, in every demonstration, nearly always near the one or the other end of its range, and
changes sides equally often.

>>> open_, closed = [0.0, 0.0], [1.0, 1.0]
>>> gripper = torch.tensor([open_ + closed + open_, open_ + open_ + closed])[..., None]
>>> find_events(gripper) is None  # twice in the one, once in the other
True
>>> find_events(gripper[:1]).steps.tolist()
[[2, 4]]
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from preimage.ideas.residuals import num_steps_of_all, residuals_of
from preimage.method.seam import ErrorTerm, Problem, summed_errors
from preimage.network.coding import JointCoding
from preimage.network.pdvmrnn import Generated

MAX_EVENTS = 4
"""Demonstrations with more than so many are not searched for what is common to them."""
BETWEEN = 0.05
"""A joint that is in the middle third of its range for a larger share of the steps is no gripper, it moves."""


@dataclass(frozen=True, eq=False)
class Events:
    """Which joint opens and closes, and at which K steps of each of N demonstrations it is on the other side for the first time."""

    joint: int
    steps: Int[Tensor, "N K"]


def find_events(joints: Float[Tensor, "N T J"]) -> Events | None:
    """The events that all demonstrations have in common, of the joint that changes sides most cleanly; None where there are none."""
    lower, upper = joints.amin((0, 1)), joints.amax((0, 1))
    places = (joints - lower) / (upper - lower).clamp(min=1e-9)
    between = ((places - 0.5).abs() < 1 / 6).float().mean((0, 1))
    changed = changes_side(places, 0.5)
    counts = changed.sum(1)  # (N, J)
    common = (counts == counts[0]).all(0) & (counts[0] > 0) & (counts[0] <= MAX_EVENTS) & (between <= BETWEEN)
    if not bool(common.any()):
        return None
    joint = int(torch.where(common, between, torch.inf).argmin())
    return Events(joint, changed[..., joint].nonzero()[:, 1].view(len(joints), -1))


def changes_side(joints: Float[Tensor, "N T J"], middle: float | Float[Tensor, " J"]) -> Bool[Tensor, "N T J"]:
    """Where each joint is on another side of a value than at the step before."""
    above = joints > middle
    return torch.cat([torch.zeros_like(above[:, :1]), above[:, 1:] != above[:, :-1]], dim=1)


def events_in(joints: Float[Tensor, "N T J"], joint: int, coding: JointCoding) -> Bool[Tensor, "N T"]:
    """The steps at which a joint passes the middle of its range."""
    middle = ((coding.lower + coding.upper) / 2).to(joints)
    return changes_side(joints, middle)[..., joint]


@dataclass(frozen=True, eq=False)
class AfterEvents:
    """The sum of other terms, of which nothing counts before the last event: what was gripped has to be let go first.

    A sequence that has more or fewer events than the demonstrations may arrive at any step.
    """

    terms: Sequence[ErrorTerm]
    joint: int
    num_events: int
    coding: JointCoding

    def errors(self, generated: Generated) -> Float[Tensor, "B T"]:
        error = summed_errors(self.terms, generated)
        events = events_in(self.coding.decode(generated.log_codes.detach().exp()), self.joint, self.coding)
        counts = events.cumsum(1)
        before = (counts < self.num_events) & (counts[:, -1:] == self.num_events)
        return error.masked_fill(before, torch.inf)

    def residuals(self, generated: Generated, arrival: Int[Tensor, " B"]) -> Float[Tensor, "B R"]:
        return torch.cat([residuals_of(term, generated, arrival) for term in self.terms], dim=1)

    def num_steps(self, arrival: Int[Tensor, " B"]) -> int | None:
        return num_steps_of_all(self.terms, arrival)


@dataclass(frozen=True)
class ArriveAfterEvents:
    """Let plans arrive after as many events as the demonstrations have."""

    joint: int
    num_events: int

    def __call__(self, problem: Problem, terms: Sequence[ErrorTerm]) -> Sequence[ErrorTerm]:
        return [AfterEvents(terms, self.joint, self.num_events, problem.model.coding)] if self.num_events else terms
