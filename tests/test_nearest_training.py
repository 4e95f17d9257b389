"""Laws of beginning at training intentions: those that come nearest to the goal, each once, and no more than are asked for."""

import torch

from bars import bar, objective_of, problem_to
from preimage.ideas.nearest_training import NearestToGoal
from preimage.network.pdvmrnn import PDVMRNN


def nearest(model: PDVMRNN, far: float, count: int) -> torch.Tensor:
    problem = problem_to(model, bar(far))
    guesses = NearestToGoal(count)(problem, objective_of(problem, held=True), torch.Generator())
    rows = [(problem.space.training == guess).all(1).nonzero().item() for guess in guesses]
    return torch.tensor(rows)


def test_the_sequence_that_ends_at_the_goal_comes_first(trained: PDVMRNN) -> None:
    for number, far in ((1, 0.36), (3, 0.68), (5, 1.0)):
        assert nearest(trained, far, 1).tolist() == [number]


def test_each_comes_once_and_the_number_is_kept(trained: PDVMRNN) -> None:
    for count in (1, 4, 6):
        assert len(set(nearest(trained, 0.6, count).tolist())) == len(nearest(trained, 0.6, count)) == count
    assert len(nearest(trained, 0.6, 60)) == 6, "there are no more"


def test_what_is_imagined_for_them_is_at_hand_afterwards(trained: PDVMRNN) -> None:
    problem = problem_to(trained, bar(0.6))
    assert problem.rollouts_at_hand is None
    NearestToGoal(2)(problem, objective_of(problem), torch.Generator())
    assert problem.rollouts_at_hand is problem.rollouts
