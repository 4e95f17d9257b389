"""The seam between the paper's method and what goes beyond it: what `train` and `plan` take as arguments.

    Augmentation     batch, sequences, generator -> batch       before an update of the training
    InitialGuess     problem, objective, generator -> coordinates       where a search begins
    Search           problem, objective, coordinates -> Regression      how an intention is moved
    ErrorTerm        generated -> error a step                  what is added to the error of the goal
    PlanCorrection   draft, problem -> draft                    what is made of a plan that was found

`Ideas()` is the paper: random guesses, Adam, the goal's own error, nothing corrected.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol, Self

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from preimage.compute.precision import resolve_precision
from preimage.data.sequences import Sequences
from preimage.method.config import Modalities, PlanConfig
from preimage.network.coding import to_frames
from preimage.network.inputs import as_inputs, home
from preimage.network.intention import IntentionSpace, IntentionState
from preimage.network.pdvmrnn import PDVMRNN, Generated, Sensed
from preimage.records import Percept, Plan, Stopped


@dataclass(frozen=True, eq=False)
class Batch:
    """The B sequences of an update, each a weighted sum of P training sequences; by the paper each is one of them."""

    rows: Int[Tensor, "B P"]
    """The training sequences, in whose intentions a batch is generated."""
    weights: Float[Tensor, "B P"]
    sequences: Sequences
    """What is to be generated."""
    blurred: Bool[Tensor, " B"]
    """Sequences whose pictures are compared through `blur`."""
    blur: Callable[[Tensor], Tensor] | None = None

    def __getitem__(self, chosen: Tensor) -> "Batch":
        sequences = self.sequences
        part = replace(sequences, frames=sequences.frames[chosen], joints=sequences.joints[chosen], lengths=sequences.lengths[chosen])
        return replace(self, rows=self.rows[chosen], weights=self.weights[chosen], sequences=part, blurred=self.blurred[chosen])


class Augmentation(Protocol):
    """Another batch instead of the one that was drawn."""

    def __call__(self, batch: Batch, sequences: Sequences, generator: torch.Generator) -> Batch: ...


@dataclass(frozen=True, eq=False)
class Problem:
    """What a plan is searched for: from a start to a goal, with one network."""

    model: PDVMRNN
    start: Sensed
    goal: Sensed
    config: PlanConfig
    goal_joints: Float[Tensor, " J"] | None = None
    """The joints that are asked for, in their units, where they are."""

    @classmethod
    def between(cls, model: PDVMRNN, start: Percept, goal: Percept, config: PlanConfig) -> Self:
        """From a start to a goal; a modality of the goal that is not used is filled in and never looked at.

        Raises:
            ValueError: a percept does not fit the model.
        """
        used: dict[Modalities, tuple[str, ...]] = {"vision": ("frame",), "joints": ("joints",), "both": ("frame", "joints")}
        looked_at = replace(home(model), **{name: getattr(goal, name) for name in used[config.modalities]})
        asked = torch.from_numpy(goal.joints) if config.modalities != "vision" and goal.joints is not None else None
        return cls(model, as_inputs(model, start, name="start"), as_inputs(model, looked_at, name="goal"), config, asked)

    @property
    def dtype(self) -> torch.dtype:
        """Precision of the layers' arithmetic."""
        return getattr(torch, resolve_precision(self.config.precision, self.model.home_pixels.device))

    @property
    def num_steps(self) -> int:
        """Steps imagined, T_max."""
        return self.config.horizon or int(self.model.longest)

    @property
    def earliest_arrival(self) -> int:
        """First step at which the goal may be reached."""
        asked = self.config.earliest_arrival
        return min(max(0, int(self.model.shortest) - 1) if asked is None else asked, self.num_steps - 1)

    @cached_property
    def space(self) -> IntentionSpace:
        return self.model.intention_table.space(self.config.dimensions)

    def imagine(self, intention: IntentionState, num_steps: int | None = None) -> Generated:
        """What follows from intentions in closed loop from the start, up to the horizon or for so many steps."""
        pixels, codes = (part.expand(len(intention), *part.shape) for part in self.start)
        return self.model.generate_closed_loop(intention, (pixels, codes), num_steps=num_steps or self.num_steps, dtype=self.dtype)

    @cached_property
    @torch.no_grad()
    def rollouts(self) -> Generated:
        """What is imagined from each of the training intentions; takes as long as a search, and is imagined when first needed."""
        return self.imagine(self.model.intention_table.intentions())

    @property
    def rollouts_at_hand(self) -> Generated | None:
        """The same, if they have been needed before."""
        return vars(self).get("rollouts")


class InitialGuess(Protocol):
    """Coordinates in the problem's intention space, as many as `config.candidates` or fewer."""

    def __call__(self, problem: Problem, objective: "Objective", generator: torch.Generator) -> Float[Tensor, "B K"]: ...


class ErrorTerm(Protocol):
    """A part of the error that a plan is charged for at its goal."""

    def errors(self, generated: Generated) -> Float[Tensor, "B T"]:
        """The error if the goal is reached at each of the imagined steps."""
        ...


def at_step(generated: Generated, steps: Int[Tensor, " B"]) -> Generated:
    """One step of each sequence, as sequences of one step."""
    rows = torch.arange(len(steps), device=steps.device)
    return Generated(generated.pixels[rows, steps][:, None], generated.log_codes[rows, steps][:, None])


def summed_errors(terms: Sequence[ErrorTerm], generated: Generated) -> Float[Tensor, "B T"]:
    """The sum of the terms' errors if the goal is reached at each of the imagined steps."""
    return torch.stack([term.errors(generated) for term in terms]).sum(0)


class Objective(Protocol):
    """What a search lowers."""

    def errors(self, generated: Generated) -> tuple[Float[Tensor, " B"], Int[Tensor, " B"]]:
        """The prediction error of each sequence, and the arrival step it was taken at."""
        ...

    @property
    def to_explain(self) -> float:
        """The error of doing nothing: what there is to be explained."""
        ...


@dataclass(frozen=True, eq=False)
class Regression:
    """Where a search from B guesses ended: for each the best iterate seen, with its own error."""

    intention: IntentionState
    error: Float[Tensor, " B"]
    errors: Float[Tensor, " iterations"]
    """The lowest error of all candidates, iteration by iteration."""
    stopped: Stopped
    generated: Generated | None = None
    """What is imagined from each, where the search has kept it."""

    @property
    def best(self) -> IntentionState:
        return self.intention[self.error.argmin()[None]]

    @property
    def best_generated(self) -> Generated | None:
        """What is imagined from the best, where that is known."""
        return self.generated and self.generated[self.error.argmin()[None]]


class Search(Protocol):
    """Lower the error from each of the guesses; the weights are not touched."""

    def __call__(self, problem: Problem, objective: Objective, guesses: Float[Tensor, "B K"]) -> Regression: ...


@dataclass(frozen=True, eq=False)
class Draft:
    """A plan before it leaves the method."""

    generated: Generated
    """What was imagined, of one sequence."""
    joints: Float[Tensor, "T J"]
    """What will be commanded, in the joints' units."""
    arrival: int
    error: float
    unexplained: float
    """The error as a share of that of staying at the start."""
    intention: IntentionState
    imagined: Float[Tensor, "T J"]
    """The joints as the network imagines them, before anything was corrected."""
    expected: Float[Tensor, "M J"] | None = None
    """Joints that are known from elsewhere, on the way and, last, at the goal."""

    def plan(self, problem: Problem, *, start: Percept, goal: Percept, errors: np.ndarray, stopped: Stopped, seconds: float) -> Plan:
        """The record that leaves the method."""
        return Plan(
            frames=to_frames(self.generated.pixels[0]).cpu().numpy(),
            joints=self.joints.cpu().numpy(),
            arrival_step=self.arrival,
            rate_hz=problem.model.config.rate_hz,
            joint_names=problem.model.sensors.joint_names,
            start=start,
            goal=goal,
            intention=self.intention.flatten()[0].double().cpu().numpy(),
            error=self.error,
            unexplained=self.unexplained,
            errors=errors,
            stopped=stopped,
            seconds=seconds,
            imagined_joints=self.imagined.cpu().numpy(),
            expected_joints=None if self.expected is None else self.expected.double().cpu().numpy(),
        )


class PlanCorrection(Protocol):
    """Another draft instead of the one that was found."""

    def __call__(self, draft: Draft, problem: Problem, objective: Objective) -> Draft: ...


Policy = Callable[[Percept], Float[np.ndarray, " J"]]
"""From what is sensed to the next joints."""
TermsOf = Callable[[Problem, Sequence[ErrorTerm]], Sequence[ErrorTerm]]
"""The terms of the goal's error with those of an idea added."""


@dataclass(frozen=True)
class Ideas:
    """What a plan is made with beyond the paper; by default nothing (None: the paper's own)."""

    initial_guess: InitialGuess | None = None
    search: Search | None = None
    terms: Sequence[TermsOf] = field(default=())
    corrections: Sequence[PlanCorrection] = field(default=())
