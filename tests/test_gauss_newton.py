"""Laws of Gauss-Newton: a step solves what is linear, Jacobians agree with finite differences, and a search never rises."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bars import FULL, SOLVED, bar, objective_of, problem_to
from preimage.ideas.gauss_newton import (
    BEHIND,
    GaussNewton,
    Iterate,
    better_of,
    broyden_update,
    evaluate,
    jacobian_from,
    measured_jacobian,
    slopes,
    steps_from,
)
from preimage.ideas.memory import DemonstrationMemory
from preimage.ideas.residuals import residuals_of
from preimage.network.pdvmrnn import PDVMRNN, Generated
from preimage.presets import Planner
from preimage.records import Percept, Stopped


def iterate(points: torch.Tensor, residuals: torch.Tensor, error: torch.Tensor | None = None) -> Iterate:
    """Points with what is imagined from each: a frame of one pixel, which has the point's first number."""
    count = len(points)
    error = torch.zeros(count) if error is None else error
    generated = Generated(points[:, :1].view(count, 1, 1, 1, 1), torch.zeros(count, 1, 1, 1))
    return Iterate(points, error, torch.zeros(count, dtype=torch.long), residuals, generated)


def test_a_step_solves_what_is_linear_and_learns_what_it_did() -> None:
    generator = torch.Generator().manual_seed(0)
    jacobian, start = torch.randn(1, 3, 7, generator=generator), torch.randn(1, 7, generator=generator)
    here = iterate(torch.zeros(1, 3), start)
    least = -torch.linalg.lstsq(jacobian[0].T, start[0]).solution
    torch.testing.assert_close(steps_from(here, jacobian, cost=0.0)[0, 0], least, atol=2e-2, rtol=0)  # the least damped
    there = iterate(torch.tensor([[0.1, -0.2, 0.3]]), torch.randn(1, 7, generator=generator))
    updated = broyden_update(jacobian, here, there)
    torch.testing.assert_close(((there.points - here.points)[:, :, None] * updated).sum(1), there.residuals - here.residuals)


def test_a_more_damped_step_is_shorter() -> None:
    generator = torch.Generator().manual_seed(0)
    jacobian, start = torch.randn(1, 3, 7, generator=generator), torch.randn(1, 7, generator=generator)
    sizes = steps_from(iterate(torch.zeros(1, 3), start), jacobian, cost=0.0)[0].norm(dim=1)
    assert (sizes.diff() < 0).all()


def test_of_a_point_and_its_steps_the_best_is_kept_and_what_is_no_number_never() -> None:
    here = iterate(torch.zeros(2, 1), torch.zeros(2, 1), torch.tensor([5.0, 1.0]))
    errors = torch.tensor([4.0, torch.nan, 3.0, 2.0, 7.0, torch.nan])
    best = better_of(here, iterate(torch.arange(1.0, 7)[:, None], torch.zeros(6, 1), errors))
    assert best.points[:, 0].tolist() == [3.0, 0.0]
    assert best.error.tolist() == [3.0, 1.0]
    assert best.generated.pixels.flatten().tolist() == [3.0, 0.0]


def test_a_measured_jacobian_agrees_with_finite_differences(trained: PDVMRNN) -> None:
    problem = problem_to(trained, bar(0.5), dimensions=2)
    objective = objective_of(problem)
    with torch.no_grad():
        here = evaluate(problem.space.training[:2], problem, objective)
        measured = measured_jacobian(here, None, None, problem, objective, 0.01)
        for number, way in enumerate(torch.eye(2)):
            generated = problem.imagine(problem.space.intention(here.points + 0.01 * way))
            by_hand = (residuals_of(objective, generated, here.arrival) - here.residuals) / 0.01
            assert (measured[:, number] - by_hand).norm() < 0.05 * by_hand.norm()
        again = measured_jacobian(here, 0.5 * measured, measured, problem, objective, 0.01)  # all directions are among the leading ones
        assert (again - measured).norm() < 0.05 * measured.norm()


def test_a_jacobian_is_measured_in_the_leading_directions_of_what_changes_like_it(trained: PDVMRNN, monkeypatch) -> None:
    monkeypatch.setattr("preimage.ideas.gauss_newton.LEADING", 1)
    problem = problem_to(trained, bar(0.5), dimensions=2)
    objective = objective_of(problem)
    with torch.no_grad():
        here = evaluate(problem.space.training[:1], problem, objective)
        full = measured_jacobian(here, None, None, problem, objective, 0.01)
        hint = torch.tensor([[[3.0, 0.0], [0.0, 0.1]]])
        measured = measured_jacobian(here, None, hint, problem, objective, 0.01)
    assert (measured - full)[:, 0].norm() < 0.05 * full[:, 0].norm()  # measured forwards or backwards
    assert measured[:, 1].abs().max() == 0


def test_slopes_of_what_is_linear_are_its_own() -> None:
    generator = torch.Generator().manual_seed(0)
    points, jacobian = torch.randn(30, 3, generator=generator), torch.randn(3, 5, generator=generator)
    found = slopes(torch.randn(2, 3, generator=generator), points, 7.0 + points @ jacobian)
    torch.testing.assert_close(found, jacobian.expand(2, -1, -1), atol=0.02, rtol=0.02)


def test_a_jacobian_is_estimated_from_what_is_known_around(trained: PDVMRNN) -> None:
    problem = problem_to(trained, bar(0.5), dimensions=2)
    objective = objective_of(problem)
    points = torch.cat([torch.zeros(1, 2), 0.01 * torch.randn(20, 2, generator=torch.Generator().manual_seed(0))])
    with torch.no_grad():
        here = evaluate(points[:1], problem, objective)
        estimated = jacobian_from(here, points, problem.imagine(problem.space.intention(points)), objective)
        measured = measured_jacobian(here, None, None, problem, objective, 0.005)
    for number in range(2):
        assert (estimated - measured)[0, number].norm() < 0.2 * measured[0, number].norm()


def test_a_search_never_rises_and_its_best_comes_back_with_its_own_error(trained: PDVMRNN) -> None:
    problem = problem_to(trained, bar(0.8))
    objective = objective_of(problem)
    found = GaussNewton(6)(problem, objective, problem.space.training[3:5])
    assert (found.errors.diff() <= 0).all()
    assert found.errors[-1] < 0.5 * found.errors[0]
    again, _ = objective.errors(problem.imagine(found.intention))
    torch.testing.assert_close(again, found.error, rtol=1e-4, atol=1e-5)
    assert found.generated is not None
    assert objective.errors(found.generated)[0].tolist() == found.error.tolist()


def test_candidates_that_fall_behind_are_dropped(trained: PDVMRNN) -> None:
    problem = problem_to(trained, bar(0.8))
    found = GaussNewton(1)(problem, objective_of(problem), problem.space.training)
    assert 1 <= len(found.error) < len(problem.space.training)
    assert (found.error <= BEHIND * found.error.min()).all()


def test_a_plan_reaches_a_goal_between_the_demonstrations(trained: PDVMRNN) -> None:
    shown = bar(0.8)
    found = Planner(trained, None, SOLVED).plan(start=shown.first, goal=Percept(frame=shown.last.frame))
    assert np.abs(found.joints[found.arrival_step] - shown.joints[-1]).max() < 0.08
    assert found.errors[-1] < found.errors[0]
    assert found.error == pytest.approx(found.errors[-1], rel=1e-4)
    assert (np.diff(found.errors) <= 0).all()
    assert found.stopped is not Stopped.ENOUGH


def test_a_search_ends_where_the_error_is_small_enough(trained: PDVMRNN, memory: DemonstrationMemory) -> None:
    shown, once = bar(0.8), FULL
    whole = Planner(trained, memory, once).plan(start=shown.first, goal=shown.last)
    to_explain = whole.error / whole.unexplained
    half = (whole.errors.min() + whole.errors[0]) / 2
    found = Planner(trained, memory, replace(once, tolerance=float(half) / to_explain)).plan(start=shown.first, goal=shown.last)
    assert found.stopped is Stopped.ENOUGH
    assert found.errors[-1] <= half < found.errors[-2]
    np.testing.assert_array_equal(found.errors, whole.errors[: len(found.errors)])


def test_a_search_that_nobody_expects_joints_of_goes_on(trained: PDVMRNN) -> None:
    shown = bar(0.8)
    options = [replace(SOLVED, iterations=3, tolerance=share) for share in (0.0, 1e9)]
    found = [Planner(trained, None, each).plan(start=shown.first, goal=shown.last) for each in options]
    np.testing.assert_array_equal(*(one.errors for one in found))
