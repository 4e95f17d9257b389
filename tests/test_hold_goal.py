"""Laws of the held goal: its error is the mean over the arrival and all that follows, and a plan rests where it has arrived."""

from dataclasses import replace

import pytest
import torch

from bars import bar, nearly, objective_of, problem_to
from preimage.ideas.hold_goal import Held, rest_at_goal, resting
from preimage.ideas.residuals import num_steps, residuals_of
from preimage.method.plan import draft_of
from preimage.method.seam import Problem
from preimage.network.pdvmrnn import PDVMRNN, Generated


def way(problem: Problem, *ends: str) -> Generated:
    """Percepts in a row, each nearly the start's or the goal's."""
    pixels, codes = zip(*(problem.start if end == "start" else problem.goal for end in ends), strict=True)
    return Generated(torch.stack(pixels)[None] + 0.01, nearly(torch.stack(codes))[None])


@pytest.mark.parametrize("modalities", ["vision", "joints", "both"])
@pytest.mark.parametrize("held", [False, True])
def test_residuals_are_the_error_near_the_goal(trained: PDVMRNN, modalities: str, held: bool) -> None:
    problem = problem_to(trained, bar(0.7), modalities=modalities)
    objective, near = objective_of(problem, held=held), way(problem, "start", "goal", "goal")
    error, arrival = objective.errors(near)
    assert arrival.item() == 1
    assert residuals_of(objective, near, arrival).square().sum().item() == pytest.approx(error.item(), rel=0.05)


def test_what_follows_counts_only_where_the_goal_is_held(trained: PDVMRNN) -> None:
    problem = problem_to(trained, bar(0.7))
    passing, until = way(problem, "start", "goal", "start"), way(problem, "start", "goal")
    plain, held = objective_of(problem), objective_of(problem, held=True)
    error, arrival = plain.errors(passing)
    assert arrival.item() == 1
    assert residuals_of(plain, passing, arrival).equal(residuals_of(plain, until, arrival))
    assert residuals_of(plain, passing, arrival).square().sum().item() == pytest.approx(error.item(), rel=0.05)
    at_each = plain.goal_error(passing)[0]
    torch.testing.assert_close(held.goal_error(passing)[0], torch.stack([at_each.mean(), at_each[1:].mean(), at_each[2]]))
    assert (num_steps(plain, arrival), num_steps(held, arrival)) == (2, None)


def test_staying_in_the_goal_is_better_than_reaching_it_again_later(trained: PDVMRNN) -> None:
    problem = problem_to(trained, bar(0.7))
    swaying = way(problem, "start", "goal", "start", "goal")
    assert objective_of(problem).errors(swaying)[1].item() == 1
    assert objective_of(problem, held=True).errors(swaying)[1].item() == 3


def test_resting_of_a_single_step_is_its_error() -> None:
    assert resting(torch.tensor([[2.0], [5.0]])).tolist() == [[2.0], [5.0]]


def test_several_terms_are_held_together(trained: PDVMRNN) -> None:
    problem = problem_to(trained, bar(0.7), modalities="both")
    seen, felt = objective_of(problem).terms
    generated = way(problem, "start", "goal", "start")
    torch.testing.assert_close(Held([seen, felt]).errors(generated), Held([seen]).errors(generated) + Held([felt]).errors(generated))


def test_a_plan_rests_at_the_mean_of_what_is_imagined_from_its_arrival_on(trained: PDVMRNN) -> None:
    problem = problem_to(trained, bar(0.7), horizon=9)
    objective = objective_of(problem, held=True)
    draft = replace(draft_of(problem.space.intention(problem.space.training[:1]), problem, objective), arrival=4)
    rested = rest_at_goal(draft, problem, objective)
    assert rested.joints[:4].equal(draft.joints[:4])
    torch.testing.assert_close(rested.joints[4:], draft.joints[4:].mean(0).expand(5, -1))
    assert rested.imagined.equal(draft.imagined)
