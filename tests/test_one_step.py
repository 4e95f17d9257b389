"""Laws of one-step prediction: it is the network's open loop, corrected as the plan is, and keeps no graph."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bars import bar, tiny_double
from preimage.ideas.no_goal import imagine_without_goal
from preimage.method.config import PlanConfig
from preimage.method.one_step import follow
from preimage.method.plan import plan
from preimage.network.inputs import as_inputs
from preimage.network.intention import unflatten
from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Percept

SHOWN = bar(0.6)
CONFIG = PlanConfig(precision="float32", iterations=1, candidates=2)


@pytest.fixture(scope="module")
def model() -> PDVMRNN:
    return tiny_double()


def test_it_is_the_open_loop(model: PDVMRNN) -> None:
    policy = follow(model, found := plan(model, start=SHOWN.first, goal=SHOWN.last, config=CONFIG))
    stepwise = np.stack([policy(SHOWN[step]) for step in range(len(SHOWN) - 1)])
    sensed = [torch.stack(part)[None] for part in zip(*(as_inputs(model, SHOWN[step], name="step") for step in range(6)), strict=True)]
    intention = unflatten(torch.from_numpy(found.intention)[None], model.intention_table.shapes)
    opened = model.generate_open_loop(intention, (sensed[0], sensed[1]))
    np.testing.assert_allclose(stepwise, model.coding.decode(opened.log_codes.exp())[0, 1:].numpy(), atol=1e-6)


def test_it_is_corrected_as_the_plan_is(model: PDVMRNN) -> None:
    straight = imagine_without_goal(model, SHOWN.first, config=CONFIG)
    correction = 0.03 * np.arange(len(straight.joints))[:, None] * np.array([1.0, -1.0])
    policy = follow(model, straight)
    corrected_policy = follow(model, replace(straight, joints=straight.joints + correction))
    for step in range(len(correction) + 2):
        here, there = correction[min(step, len(correction) - 1)], correction[min(step + 1, len(correction) - 1)]  # after the end it stays
        sensed = SHOWN[min(step, len(SHOWN) - 1)]
        predicted = corrected_policy(Percept(sensed.frame, sensed.joints + here))
        np.testing.assert_allclose(predicted, policy(sensed) + there, atol=1e-6)


def test_the_papers_plan_is_followed_without_a_correction(model: PDVMRNN) -> None:
    found = plan(model, start=SHOWN.first, goal=SHOWN.last, config=CONFIG)
    one, other = follow(model, found), follow(model, replace(found, imagined_joints=None))
    np.testing.assert_array_equal(one(SHOWN[0]), other(SHOWN[0]))


def test_no_graph_is_kept_of_a_model_that_is_not_frozen(model: PDVMRNN, monkeypatch: pytest.MonkeyPatch) -> None:
    """Once each step held on to all before it, until memory was full."""
    found = plan(model, start=SHOWN.first, goal=SHOWN.last, config=CONFIG)
    recorded = []
    plain = model.at

    def watched(*how):
        step = plain(*how)

        def stepped(inputs, states):
            outputs, after = step(inputs, states)
            recorded.extend(value.requires_grad for pair in after.values() for value in pair)
            return outputs, after

        return stepped

    monkeypatch.setattr(model, "at", watched)
    model.requires_grad_(True)
    try:
        policy = follow(model, found)
        policy(SHOWN[0])
    finally:
        model.requires_grad_(False)
    assert recorded
    assert not any(recorded)


def test_what_is_not_sensed_is_refused(model: PDVMRNN) -> None:
    policy = follow(model, plan(model, goal=SHOWN.last, config=CONFIG))
    with pytest.raises(ValueError, match="percept has no joints"):
        policy(Percept(SHOWN.last.frame))
