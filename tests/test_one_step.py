"""Laws of one-step prediction: it is the network's open loop, bent as the plan is."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bars import bar, tiny_double
from preimage.ideas.test_time_augmentation import glances
from preimage.method.one_step import follow
from preimage.method.plan import PlanConfig, as_inputs, imagine_without_goal, plan
from preimage.network.intention import unflatten
from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Percept

SHOWN = bar(0.6)


@pytest.fixture(scope="module")
def model() -> PDVMRNN:
    return tiny_double()


@pytest.mark.parametrize("glance", [0.0, 0.05])
def test_it_is_the_open_loop_of_what_is_seen_at_a_glance(model: PDVMRNN, glance: float) -> None:
    config = PlanConfig(precision="float64", glance=glance, recalls=False, rests=False)
    found = plan(model, start=SHOWN.first, goal=SHOWN.last, config=config)
    policy = follow(model, found, config=config)
    stepwise = np.stack([policy(SHOWN[step]) for step in range(len(SHOWN) - 1)])
    pixels, codes = (torch.stack(parts) for parts in zip(*(as_inputs(model, SHOWN[step], name="step") for step in range(6)), strict=True))
    looks = torch.stack([glances(frame, glance) for frame in pixels], 1)  # (looks, T, C, H, W)
    intention = unflatten(torch.from_numpy(found.intention).expand(len(looks), -1), model.intention_table.shapes)
    opened = model.generate_open_loop(intention, (looks, codes.expand(len(looks), *codes.shape)))
    at_once = model.coding.decode(opened.log_codes.exp()).mean(0).numpy()
    np.testing.assert_allclose(stepwise, at_once[1:], atol=1e-6)


def test_it_is_bent_as_the_plan_is(model: PDVMRNN) -> None:
    config = PlanConfig(precision="float64", glance=0.0)
    straight = imagine_without_goal(model, SHOWN.first, config=config)
    bend = 0.03 * np.arange(len(straight.joints))[:, None] * np.array([1.0, -1.0])
    policy = follow(model, straight, config=config)
    bent_policy = follow(model, replace(straight, joints=straight.joints + bend), config=config)
    for step in range(len(bend) + 2):
        here, there = bend[min(step, len(bend) - 1)], bend[min(step + 1, len(bend) - 1)]  # after the end it stays bent
        sensed = SHOWN[min(step, len(SHOWN) - 1)]
        there_in_fact = bent_policy(Percept(sensed.frame, sensed.joints + here))
        np.testing.assert_allclose(there_in_fact, policy(sensed) + there, atol=1e-6)


def test_what_is_not_sensed_is_refused(model: PDVMRNN) -> None:
    policy = follow(model, plan(model, goal=SHOWN.last, config=PlanConfig(iterations=1)))
    with pytest.raises(ValueError, match="percept has no joints"):
        policy(Percept(SHOWN.last.frame))
