"""The prediction error as residuals, numbers whose squares sum to about it, for searches that solve for them.

The paper's errors (`method.prediction_error`) have theirs here; what ideas charge for besides says itself what its residuals are.
"""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from preimage.method.prediction_error import GoalError, ToGoal, ToSequence
from preimage.method.seam import ErrorTerm, Objective, at_step
from preimage.network.divergence import proprioceptive_residuals, visual_residuals
from preimage.network.pdvmrnn import Generated, InputSequence, Sensed


@runtime_checkable
class HasResiduals(Protocol):
    """An error that says what its residuals are."""

    def residuals(self, generated: Generated, arrival: Int[Tensor, " B"]) -> Float[Tensor, "B R"]:
        """Numbers whose squares sum to about the error at given arrival steps."""
        ...

    def num_steps(self, arrival: Int[Tensor, " B"]) -> int | None:
        """How many steps have to be imagined to know the residuals; None: all up to the horizon."""
        ...


Error = Objective | ErrorTerm


def residuals_of(error: Error, generated: Generated, arrival: Int[Tensor, " B"]) -> Float[Tensor, "B R"]:
    """Numbers whose squares sum to about an error at given arrival steps.

    Raises:
        TypeError: nobody says what its residuals are.
    """
    if isinstance(error, HasResiduals):
        return error.residuals(generated, arrival)
    if isinstance(error, ToGoal):
        first = Generated(generated.pixels[:, :1], generated.log_codes[:, :1])
        return torch.cat([*(residuals_of(term, generated, arrival) for term in error.terms), *apart(first, error.start)], dim=1)
    if isinstance(error, ToSequence):
        return torch.cat(apart(generated, error.sensed), dim=1) / error.sensed[0].shape[1] ** 0.5
    if isinstance(error, GoalError):
        there = at_step(generated, arrival)
        if error.modality == "vision":
            return visual_residuals(there.pixels, error.goal[0]).flatten(1)
        return proprioceptive_residuals(there.log_codes, error.goal[1]).flatten(1)
    raise TypeError(f"{type(error).__name__} says of no residuals: give it those of ideas.residuals.HasResiduals")


def apart(generated: Generated, sensed: Sensed | InputSequence) -> list[Float[Tensor, "rows _"]]:
    """The residuals of both modalities."""
    seen, felt = visual_residuals(generated.pixels, sensed[0]), proprioceptive_residuals(generated.log_codes, sensed[1])
    return [seen.flatten(1), felt.flatten(1)]


def num_steps(error: Error, arrival: Int[Tensor, " B"]) -> int | None:
    """How many steps have to be imagined to know the residuals of an error; None: all up to the horizon."""
    if isinstance(error, HasResiduals):
        return error.num_steps(arrival)
    if isinstance(error, ToGoal):
        return num_steps_of_all(error.terms, arrival)
    return int(arrival.max()) + 1 if isinstance(error, GoalError) else None


def num_steps_of_all(terms: Sequence[ErrorTerm], arrival: Int[Tensor, " B"]) -> int | None:
    """As many as the term needs that looks furthest."""
    needed = [num_steps(term, arrival) for term in terms]
    return None if None in needed else max(each for each in needed if each is not None)
