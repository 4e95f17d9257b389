"""Laws of recognition: one intention regenerates a whole sequence that was never shown, by any search."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bars import EXACT, PAPER, REGRESSION, SOLVED, bar, nearly, problem_to
from preimage.ideas.nearest_training import NearestSequences
from preimage.ideas.residuals import residuals_of
from preimage.method.plan import recognise
from preimage.method.prediction_error import ToSequence
from preimage.network.inputs import as_inputs
from preimage.network.pdvmrnn import PDVMRNN, Generated, InputSequence
from preimage.presets import Planner, PlanOptions
from preimage.records import Demonstration, Stopped


def sensed_of(model: PDVMRNN, shown: Demonstration) -> InputSequence:
    percepts = [as_inputs(model, shown[step], name="step") for step in range(len(shown))]
    return torch.stack([one[0] for one in percepts])[None], torch.stack([one[1] for one in percepts])[None]


def test_residuals_of_a_sequence_are_its_error(trained: PDVMRNN) -> None:
    sensed = sensed_of(trained, bar(0.5))
    objective, near = ToSequence(sensed), Generated(sensed[0] + 0.01, nearly(sensed[1]))
    error, arrival = objective.errors(near)
    assert residuals_of(objective, near, arrival).square().sum().item() == pytest.approx(error.item(), rel=0.05)


def test_what_there_is_to_explain_is_the_error_of_staying_at_the_first_percept(trained: PDVMRNN) -> None:
    pixels, _ = sensed = sensed_of(trained, bar(0.5))
    moved = (pixels - pixels[:, :1]).square().sum((2, 3, 4)).mean() * 16 / 40  # 16x16 pixels count as 64x64
    assert ToSequence(sensed).to_explain > moved.item()
    still = pixels[:, :1].expand_as(pixels), sensed[1][:, :1].expand_as(sensed[1])
    assert ToSequence(still).to_explain == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("options", [PAPER, REGRESSION, SOLVED], ids=["paper", "regression", "gauss-newton"])
def test_recognition_regenerates_a_new_sequence(trained: PDVMRNN, options: PlanOptions) -> None:
    shown = bar(0.45)  # the prior mean imagines one of 0.55
    found = Planner(trained, None, replace(options, iterations=min(options.iterations, 30))).recognise(shown)
    objective = ToSequence(sensed_of(trained, shown))
    prior = problem_to(trained, shown, horizon=len(shown)).imagine(trained.intention_table.prior_mean(1))
    assert found.error < 0.2 * objective.errors(prior)[0].item()
    assert found.error == pytest.approx(objective.errors(found.generated)[0].item(), rel=1e-6)
    joints = trained.coding.decode(found.generated.log_codes[0].exp()).numpy()
    assert np.abs(joints - shown.joints).max() < 0.15
    assert found.stopped in (Stopped.ITERATIONS, Stopped.CONVERGED), "there is nothing that would be enough"
    assert (np.diff(found.errors) <= 0).all()


def test_the_papers_recognition_is_planning_with_every_percept(trained: PDVMRNN) -> None:
    few = {"iterations": 2, "candidates": 2}
    one = recognise(trained, bar(0.55), config=replace(EXACT, **few))
    other = Planner(trained, None, replace(PAPER, **few)).recognise(bar(0.55))
    assert one.intention.flatten().equal(other.intention.flatten())


def test_recognition_begins_at_the_training_sequences_that_are_most_alike(trained: PDVMRNN) -> None:
    for number, far in enumerate(np.linspace(0.2, 1, 6)):
        problem = problem_to(trained, bar(far))
        objective = ToSequence(sensed_of(trained, bar(far)))
        nearest = NearestSequences(2)(problem, objective, torch.Generator())
        assert nearest[0].equal(problem.space.training[number])
        assert len(nearest) == 2


def test_a_faster_recording_is_recognised_at_the_models_rate(trained: PDVMRNN) -> None:
    fast = replace(bar(0.55, 11), rate_hz=5.0)
    assert Planner(trained, None, replace(PAPER, iterations=0)).recognise(fast).generated.pixels.shape[1] == 6
