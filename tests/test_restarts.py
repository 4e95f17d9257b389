"""Laws of restarts: a plan in doubt is searched for once more, from other guesses, and never gets worse."""

from dataclasses import dataclass, field, replace

import pytest
import torch

from bars import FULL, bar, objective_of, problem_to
from preimage.ideas.memory import DemonstrationMemory
from preimage.ideas.restarts import Restarts
from preimage.method.seam import Objective, Problem, Regression
from preimage.network.pdvmrnn import PDVMRNN
from preimage.presets import PlanOptions
from preimage.records import Stopped


@dataclass
class Search:
    """Moves nothing; tells with which errors it ends, and remembers from how many guesses it was asked to begin."""

    ends: list[float]
    begun: list[int] = field(default_factory=list)

    def __call__(self, problem: Problem, objective: Objective, guesses: torch.Tensor) -> Regression:
        error = torch.full((len(guesses),), self.ends[len(self.begun)])
        self.begun.append(len(guesses))
        return Regression(problem.space.intention(guesses), error, error[:1], Stopped.ITERATIONS)


def others(problem: Problem, objective: Objective, generator: torch.Generator) -> torch.Tensor:
    return problem.space.training[:4]


@pytest.mark.parametrize(
    ("ends", "begun", "taken"),
    [([0.04, 0.01], [2], 0.04), ([0.2, 0.1], [2, 4], 0.1), ([0.2, 0.3], [2, 4], 0.2)],
    ids=["sure", "in doubt", "in doubt, and the others are worse"],
)
def test_a_plan_in_doubt_is_searched_for_from_other_guesses(trained: PDVMRNN, ends: list[float], begun: list[int], taken: float) -> None:
    problem = problem_to(trained, bar(0.7))
    objective = objective_of(problem)
    search = Search([end * objective.to_explain for end in ends])
    found = Restarts(search, others, threshold=0.05)(problem, objective, problem.space.training[:2])
    assert search.begun == begun
    assert found.error.min().item() == pytest.approx(taken * objective.to_explain)


@pytest.mark.parametrize(("threshold", "imagined"), [(0.0, True), (1e9, False)])
def test_training_sequences_are_imagined_only_for_a_plan_in_doubt(
    trained: PDVMRNN, memory: DemonstrationMemory, threshold: float, imagined: bool
) -> None:
    problem = problem_to(trained, bar(0.7))
    objective = objective_of(problem)
    ideas = replace(FULL, restart_threshold=threshold, iterations=1).ideas(memory)
    assert ideas.initial_guess is not None
    assert ideas.search is not None
    ideas.search(problem, objective, ideas.initial_guess(problem, objective, torch.Generator()))
    assert (problem.rollouts_at_hand is not None) == imagined


def test_no_preset_without_restarts_has_any() -> None:
    assert not [preset for preset in ("paper", "regression") if isinstance(PlanOptions.of(preset).ideas(None).search, Restarts)]
