"""The prediction error: of whole sequences (training, recognition) and of a start and a goal alone (planning).

>>> import torch
>>> error = torch.tensor([[9.0, 4.0, 4.0, 8.0]])
>>> int(arrival_step(error, delay_penalty=1.01))  # the first of two equal errors: arriving sooner is better
1
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from preimage.method.config import Modalities
from preimage.method.seam import ErrorTerm, summed_errors
from preimage.network.divergence import VISUAL_WEIGHT, proprioceptive_error, sensed_log, visual_error
from preimage.network.pdvmrnn import Generated, InputSequence, Sensed


@dataclass(frozen=True, eq=False)
class SequenceError:
    """Mean error of a percept, one value per sequence."""

    visual: Float[Tensor, " B"]
    proprioceptive: Float[Tensor, " B"]

    @property
    def total(self) -> Float[Tensor, " B"]:
        return VISUAL_WEIGHT * self.visual + self.proprioceptive


def sequence_error(
    generated: Generated,
    pixels: Float[Tensor, "B T C H W"],
    codes: Float[Tensor, "B T J K"],
    mask: Float[Tensor, "B T"],
) -> SequenceError:
    """Both modalities' errors against a full sequence (equation 1), averaged over the steps where mask is 1."""
    steps = mask.sum(1)
    visual = (visual_error(generated.pixels, pixels) * mask).sum(1) / steps
    proprioceptive = (proprioceptive_error(generated.log_codes, codes) * mask).sum(1) / steps
    return SequenceError(visual, proprioceptive)


def arrival_step(goal_error: Float[Tensor, "B T"], *, delay_penalty: float) -> Int[Tensor, " B"]:
    """The step whose error times delay_penalty^t is smallest: T-hat of the paper. Where two are equal the earlier wins."""
    steps = torch.arange(goal_error.shape[1], device=goal_error.device)
    return (goal_error.detach() * delay_penalty**steps).argmin(1)


@dataclass(frozen=True, eq=False)
class GoalError:
    """The goal's part of equation 2 in one modality."""

    goal: Sensed
    modality: Literal["vision", "joints"]

    def errors(self, generated: Generated) -> Float[Tensor, "B T"]:
        if self.modality == "vision":
            return VISUAL_WEIGHT * visual_error(generated.pixels, self.goal[0])
        return proprioceptive_error(generated.log_codes, self.goal[1])


def goal_terms(goal: Sensed, modalities: Modalities) -> list[ErrorTerm]:
    """The goal's part of equation 2; the term of a modality that is not given is left out (section II-D)."""
    return [GoalError(goal, modality) for modality in ("vision", "joints") if modalities in (modality, "both")]


@dataclass(frozen=True, eq=False)
class ToGoal:
    """Equation 2: the first percept as observed, and the goal at the step that shows it best.

    Args:
        start: what is observed at the first step.
        terms: what is charged at the goal; their errors are summed.
        delay_penalty: the factor that prefers early steps.
        earliest: the first step at which the goal may be reached.
    """

    start: Sensed
    terms: Sequence[ErrorTerm]
    delay_penalty: float = 1.01
    earliest: int = 0

    def start_error(self, generated: Generated) -> Float[Tensor, " B"]:
        """The start's part: the first predicted percept against the one observed, both modalities."""
        pixels, codes = self.start
        visual = visual_error(generated.pixels[:, 0], pixels)
        return VISUAL_WEIGHT * visual + proprioceptive_error(generated.log_codes[:, 0], codes)

    def goal_error(self, generated: Generated) -> Float[Tensor, "B T"]:
        """The goal's part if it is reached at each of the imagined steps."""
        return summed_errors(self.terms, generated)

    def errors(self, generated: Generated) -> tuple[Float[Tensor, " B"], Int[Tensor, " B"]]:
        """The prediction error and the arrival step. The delay penalty picks the step; it does not enter the error."""
        at_every_step = self.goal_error(generated)
        arrival = self.earliest + arrival_step(at_every_step[:, self.earliest :], delay_penalty=self.delay_penalty)
        return self.start_error(generated) + at_every_step.gather(1, arrival[:, None])[:, 0], arrival

    @property
    def to_explain(self) -> float:
        """The goal's part of the error of staying at the start, as sensed."""
        pixels, codes = self.start
        staying = Generated(pixels[None, None], sensed_log(codes)[None, None])
        return float(self.goal_error(staying)[0, 0])


@dataclass(frozen=True, eq=False)
class ToSequence:
    """Equation 1: every percept of a sensed sequence."""

    sensed: InputSequence

    def errors(self, generated: Generated) -> tuple[Float[Tensor, " B"], Int[Tensor, " B"]]:
        """The mean prediction error of a step; there is nothing to aim at."""
        pixels, codes = (part.expand(len(generated.pixels), *part.shape[1:]) for part in self.sensed)
        error = sequence_error(generated, pixels, codes, pixels.new_ones(pixels.shape[:2])).total
        return error, torch.zeros(len(error), dtype=torch.long, device=error.device)

    @property
    def to_explain(self) -> float:
        """The error of staying at the first percept."""
        pixels, codes = (part[:, :1].expand_as(part) for part in self.sensed)
        return float(self.errors(Generated(pixels, sensed_log(codes)))[0])
