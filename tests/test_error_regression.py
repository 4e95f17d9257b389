"""Laws of error regression: gradients are true, a leap solves what is linear, the best iterate comes back with its own error."""

import pytest
import torch

from bars import objective, tiny_double
from preimage.method.error_regression import Places, leaps_from, learn_from_leap, regress_intention
from preimage.method.plan import PlanConfig, imagine


@pytest.mark.parametrize("dimensions", [4, None])
@pytest.mark.parametrize("modalities", ["vision", "joints", "both"])
def test_gradient_of_the_goal_error_agrees_with_finite_differences(dimensions: int | None, modalities: str) -> None:
    model = tiny_double(dimensions)
    goal, space = objective(model, modalities), model.intention_table.space(2)
    point = space.training[:1].clone().requires_grad_()

    def error(at: torch.Tensor) -> torch.Tensor:
        return goal.errors(imagine(model, space.intention(at), goal.start, num_steps=6, precision="float64"))[0].sum()

    (gradient,) = torch.autograd.grad(error(point), point)
    for number in range(point.shape[1]):
        nudge = torch.zeros_like(point)
        nudge[0, number] = 1e-5
        with torch.no_grad():
            slope = (error(point + nudge) - error(point - nudge)) / 2e-5
        assert gradient[0, number].item() == pytest.approx(slope.item(), rel=1e-5, abs=1e-8)


def test_the_best_of_several_candidates_is_returned() -> None:
    model = tiny_double()
    goal, space = objective(model), model.intention_table.space(None)

    def from_start(intention, num_steps=None):
        return imagine(model, intention, goal.start, num_steps=num_steps or 6, precision="float64")

    found = regress_intention(
        space, space.training, from_start, goal, config=PlanConfig(precision="float32", method="descend", iterations=5)
    )
    again, _ = goal.errors(from_start(found.best))
    assert again.item() == pytest.approx(found.error.min().item())


def test_a_leap_solves_what_is_linear_and_learns_what_it_did() -> None:
    generator = torch.Generator().manual_seed(0)
    slopes, start = torch.randn(1, 3, 7, generator=generator), torch.randn(1, 7, generator=generator)
    here = Places(torch.zeros(1, 3), torch.zeros(1), torch.zeros(1, dtype=torch.long), start)
    least = -torch.linalg.lstsq(slopes[0].T, start[0]).solution
    torch.testing.assert_close(leaps_from(here, slopes, cost=0.0)[0, 0], least, atol=2e-2, rtol=0)  # the least damped
    there = Places(torch.tensor([[0.1, -0.2, 0.3]]), torch.zeros(1), here.aims, torch.randn(1, 7, generator=generator))
    learned = learn_from_leap(slopes, here, there)
    torch.testing.assert_close(((there.points - here.points)[:, :, None] * learned).sum(1), there.residuals - here.residuals)
