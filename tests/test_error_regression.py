"""Laws of error regression by Adam: gradients are true, and the best iterate comes back, by what is charged, with its own error."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import pytest
import torch
from torch import Tensor

from bars import bar, objective_of, problem_to, tiny_double
from preimage.method.error_regression import adam
from preimage.method.prediction_error import ToGoal
from preimage.method.seam import Problem
from preimage.network.config import ModelConfig
from preimage.network.intention import IntentionSpace, IntentionState
from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Stopped

pytestmark = pytest.mark.usefixtures("unchecked")  # double precision, which cannot be asked for elsewhere
NETWORKS = {"latent": ModelConfig.tiny(), "free": ModelConfig.tiny().as_paper()}


@pytest.fixture(scope="module", params=NETWORKS)
def model(request: pytest.FixtureRequest) -> PDVMRNN:
    return tiny_double(NETWORKS[request.param])


@pytest.fixture(scope="module")
def latent() -> PDVMRNN:
    return tiny_double()


@pytest.mark.parametrize("modalities", ["vision", "joints", "both"])
def test_gradient_of_the_goal_error_agrees_with_finite_differences(model: PDVMRNN, modalities: str) -> None:
    problem = problem_to(model, bar(0.7), modalities=modalities, dimensions=2)
    objective, point = objective_of(problem), problem.space.training[:1].clone().requires_grad_()

    def error(at: Tensor) -> Tensor:
        return objective.errors(problem.imagine(problem.space.intention(at)))[0].sum()

    (gradient,) = torch.autograd.grad(error(point), point)
    for number in range(point.shape[1]):
        nudge = torch.zeros_like(point)
        nudge[0, number] = 1e-5
        with torch.no_grad():
            slope = (error(point + nudge) - error(point - nudge)) / 2e-5
        assert gradient[0, number].item() == pytest.approx(slope.item(), rel=1e-5, abs=1e-8)


@dataclass
class Watched:
    """A search, and every point and error that it met."""

    problem: Problem
    points: list[Tensor] = field(default_factory=list)
    errors_met: list[Tensor] = field(default_factory=list)

    def __post_init__(self) -> None:
        space = self.problem.space
        vars(self.problem)["space"] = IntentionSpace(space.training, self.met(space.intention))
        self.objective = objective_of(self.problem)

    def met(self, intention_of: Callable[[Tensor], IntentionState]) -> Callable[[Tensor], IntentionState]:
        def intention(point: Tensor) -> IntentionState:
            self.points.append(point.detach().clone())
            return intention_of(point)

        return intention

    def errors(self, generated) -> tuple[Tensor, Tensor]:
        error, arrival = self.objective.errors(generated)
        self.errors_met.append(error.detach().clone())
        return error, arrival


def test_the_best_iterate_is_chosen_by_the_error_that_is_charged(latent: PDVMRNN) -> None:
    """Once the charge for the intention was descended, and the iterate chosen without it."""
    problem = problem_to(latent, bar(0.7), iterations=12, learning_rate=0.3, intention_cost=20.0)
    watched = Watched(problem)
    found = adam(problem, watched, problem.space.training[:1] + 1.0)
    points, errors = torch.cat(watched.points)[: len(watched.errors_met)], torch.cat(watched.errors_met)
    charged = errors + 20.0 * points.square().sum(1)
    chosen = charged.argmin()
    assert chosen != errors.argmin(), "a law that says nothing"
    assert found.error.item() == errors[chosen].item()
    assert found.errors[-1].item() == charged[chosen].item()
    again, _ = watched.objective.errors(problem.imagine(found.intention))
    assert again.item() == pytest.approx(found.error.item(), rel=1e-12)


def test_every_candidate_comes_back_at_its_best_with_its_own_error(latent: PDVMRNN) -> None:
    problem = problem_to(latent, bar(0.7), iterations=5)
    objective, guesses = objective_of(problem), problem.space.training
    found = adam(problem, objective, guesses)
    again, _ = objective.errors(problem.imagine(found.intention))
    torch.testing.assert_close(again, found.error)
    alone = [adam(problem, objective, guess[None]).error.item() for guess in guesses]
    assert found.error.tolist() == pytest.approx(alone, rel=1e-6)
    assert objective.errors(problem.imagine(found.best))[0].item() == pytest.approx(min(alone), rel=1e-6)


def test_without_iterations_the_guesses_come_back(latent: PDVMRNN) -> None:
    problem = problem_to(latent, bar(0.7), iterations=0)
    objective, guesses = objective_of(problem), problem.space.training
    found = adam(problem, objective, guesses)
    assert found.intention.flatten().equal(problem.space.intention(guesses).flatten())
    assert found.stopped is Stopped.ITERATIONS
    assert len(found.errors) == 1


def test_the_guesses_are_left_as_they_are(latent: PDVMRNN) -> None:
    problem = problem_to(latent, bar(0.7), iterations=3)
    guesses = problem.space.training.clone()
    adam(problem, objective_of(problem), guesses)
    assert guesses.equal(problem.space.training)


def test_a_dearer_intention_stays_nearer_to_the_middle(latent: PDVMRNN) -> None:
    def size(cost: float) -> float:
        problem = problem_to(latent, bar(0.7), iterations=20, intention_cost=cost)
        found = Watched(problem)
        adam(problem, found, problem.space.training[:1])
        return found.points[-1].norm().item()

    assert size(100.0) < size(0.001)


def test_the_delay_penalty_picks_the_arrival_and_does_not_enter_the_error(latent: PDVMRNN) -> None:
    problem = problem_to(latent, bar(0.7))
    plain, hasty = (replace(objective_of(problem), delay_penalty=penalty) for penalty in (1.0, 100.0))
    generated = problem.imagine(problem.space.intention(problem.space.training))
    assert isinstance(plain, ToGoal)
    assert (hasty.errors(generated)[1] <= plain.errors(generated)[1]).all()
    assert hasty.errors(generated)[1].tolist() == [0] * 3
    at_once = plain.start_error(generated) + plain.goal_error(generated)[:, 0]
    torch.testing.assert_close(hasty.errors(generated)[0], at_once)
