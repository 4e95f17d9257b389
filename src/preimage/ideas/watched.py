"""A search that is watched: whoever looks on sees every point that it evaluates, and may end it.

What is wrapped are the two things that every search uses, the objective and the way from coordinates to an intention. So that Adam and
Gauss-Newton are watched alike, none of them knows of it, and a plan that was watched is the one that would have been found alone.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from preimage.ideas.residuals import num_steps, residuals_of
from preimage.method.seam import Objective, Problem, Regression, Search
from preimage.network.intention import IntentionSpace, IntentionState
from preimage.network.pdvmrnn import Generated


@dataclass(frozen=True, eq=False)
class Considered:
    """The B points that a search has just evaluated."""

    points: Float[Tensor, "B K"]
    error: Float[Tensor, " B"]
    arrival: Int[Tensor, " B"]
    generated: Generated
    """What is imagined from them."""


See = Callable[[Considered], None]
"""Called after each evaluation. What it raises ends the search, and leaves it."""


class WatchedObjective:
    """An objective whose evaluations are seen.

    Args:
        objective: what is lowered.
        last_points: the points of the intention space that were imagined last.
    """

    def __init__(self, objective: Objective, see: See, last_points: Callable[[], Tensor]) -> None:
        self._objective, self._see, self._last_points = objective, see, last_points

    def errors(self, generated: Generated) -> tuple[Float[Tensor, " B"], Int[Tensor, " B"]]:
        """Those of the objective, once they have been seen."""
        error, arrival = self._objective.errors(generated)
        with torch.no_grad():
            imagined = Generated(generated.pixels.detach(), generated.log_codes.detach())
            self._see(Considered(self._last_points().detach(), error.detach(), arrival, imagined))
        return error, arrival

    def residuals(self, generated: Generated, arrival: Int[Tensor, " B"]) -> Float[Tensor, "B R"]:
        return residuals_of(self._objective, generated, arrival)

    def num_steps(self, arrival: Int[Tensor, " B"]) -> int | None:
        return num_steps(self._objective, arrival)

    @property
    def to_explain(self) -> float:
        return self._objective.to_explain


@dataclass(frozen=True, eq=False)
class Watched:
    """A search that reports every point it evaluates."""

    search: Search
    see: See

    def __call__(self, problem: Problem, objective: Objective, guesses: Float[Tensor, "B K"]) -> Regression:
        points, space = [guesses], problem.space

        def noted(coordinates: Float[Tensor, "B K"]) -> IntentionState:
            points[0] = coordinates
            return space.intention(coordinates)

        watched = WatchedObjective(objective, self.see, lambda: points[0])
        vars(problem)["space"] = IntentionSpace(space.training, noted)  # not a new problem: what was imagined for this one is kept with it
        try:
            return self.search(problem, watched, guesses)
        finally:
            vars(problem)["space"] = space
