"""Restarts: a plan in doubt is searched for once more, from other guesses, and the better of both is taken.

Most goals need one search from one good guess; those that do not are known by their error.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from preimage.method.seam import InitialGuess, Objective, Problem, Regression, Search


@dataclass(frozen=True, eq=False)
class Restarts:
    """A search, and, where it leaves too much unexplained, the same from more guesses."""

    search: Search
    guess: InitialGuess
    threshold: float = 0.05
    """Share of the error of staying at the start above which a plan is in doubt."""

    def __call__(self, problem: Problem, objective: Objective, guesses: Float[Tensor, "B K"]) -> Regression:
        found = self.search(problem, objective, guesses)
        if found.error.min() < self.threshold * objective.to_explain:
            return found
        others = self.guess(problem, objective, torch.Generator().manual_seed(problem.config.search_seed))
        again = self.search(problem, objective, others)
        return min(found, again, key=lambda one: float(one.error.min()))
