"""Laws of memory where demonstrations begin in different joints: a start among theirs is theirs, and tells something of the goal."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bars import bar
from preimage.ideas.memory import begins_as_shown, expected_joints
from preimage.method.plan import PlanConfig, as_inputs, imagine_library
from preimage.method.prediction_error import ToGoal
from preimage.method.train import TrainConfig, train
from preimage.network.config import ModelConfig
from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Demonstration

CONFIG = PlanConfig(precision="float32", glance=0.0)


def begun_at(hidden: float, far: float) -> Demonstration:
    """A bar whose second joint, which nobody sees, begins somewhere and stays there."""
    shown = bar(far)
    return replace(shown, joints=np.stack([shown.joints[:, 0], np.full(len(shown), hidden)], 1))


@pytest.fixture(scope="module")
def model() -> PDVMRNN:
    rng = np.random.default_rng(0)
    shown = [begun_at(hidden, far) for hidden, far in zip(np.linspace(-1, 1, 16), rng.uniform(0.2, 1, 16), strict=True)]
    return train(shown, ModelConfig.tiny(), config=TrainConfig(updates=1, rest_steps=2, precision="float32"))


def wanted(model: PDVMRNN, one: Demonstration) -> ToGoal:
    return ToGoal(as_inputs(model, one.first, name="start"), as_inputs(model, one.last, name="goal"))


@pytest.mark.parametrize(("hidden", "theirs"), [(0.05, True), (-0.7, True), (1.11, True), (1.6, False)])
def test_a_start_among_different_ones_is_as_theirs_are(model: PDVMRNN, hidden: float, theirs: bool) -> None:
    start = as_inputs(model, begun_at(min(hidden, 1.0), 0.5).first, name="start")
    start = start[0], model.coding.encode(torch.tensor([0.0, hidden]))
    assert begins_as_shown(model, start) == theirs


def test_first_joints_tell_what_no_picture_does(model: PDVMRNN) -> None:
    for hidden in (-0.55, 0.0, 0.63):
        one = begun_at(hidden, 0.62)
        library = imagine_library(model, one.first, config=CONFIG)
        told = expected_joints(library, wanted(model, one), model.coding)
        untold = expected_joints(replace(library, firsts=library.firsts[:1].repeat(16, 1)), wanted(model, one), model.coding)
        assert told.mean.numpy() == pytest.approx(one.joints[-1], abs=0.08)
        assert told.deviation[1] < 0.5 * untold.deviation[1]
