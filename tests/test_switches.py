"""Laws of switches: what every demonstration switches is found, at the step at which it is on the other side; what merely moves is not."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bars import bar
from preimage.ideas.gripper_events import MOST, changes_side, find_switches
from preimage.ideas.memory import expected_at_switches
from preimage.method.plan import PlanConfig, as_inputs, plan, switch_steps
from preimage.method.prediction_error import ToGoal
from preimage.method.train import TrainConfig, train
from preimage.network.config import ModelConfig
from preimage.records import Demonstration, Percept


def gripping(far: float) -> Demonstration:
    """A bar that is gripped a third of the way and let go at two thirds of its nine steps."""
    shown = bar(far, 9)
    steps = np.arange(9)
    gripper = np.where((steps >= 3) & (steps < 6), 0.0, 0.04)
    return replace(shown, joints=np.column_stack([shown.joints, gripper]), joint_names=(*shown.joint_names, "gripper"))


def hands(close: list[int], open_: list[int], num_steps: int = 20) -> torch.Tensor:
    """An arm that sways, and a gripper (0.04 open) that closes and opens at the steps given, one pair a demonstration."""
    steps = torch.arange(num_steps)
    gripper = torch.stack([torch.where((steps >= a) & (steps < b), 0.0, 0.04) for a, b in zip(close, open_, strict=True)])
    arm = torch.sin(0.4 * steps).expand(len(close), -1)
    return torch.stack([arm, gripper], dim=-1)


def test_a_gripper_that_closes_and_opens_is_found_at_its_steps() -> None:
    found = find_switches(hands([3, 5, 9], [12, 15, 19]))
    assert found is not None
    assert found.joint == 1
    assert found.steps.tolist() == [[3, 12], [5, 15], [9, 19]]


def test_a_demonstration_that_switches_otherwise_leaves_none_in_common() -> None:
    assert find_switches(hands([3, 5, 9], [12, 15, 25])) is None  # the last one never opens again


@pytest.mark.parametrize("times", [MOST, MOST + 1])
def test_more_switches_than_are_kept_are_none(times: int) -> None:
    restless = (torch.arange(3 * (times + 1)) // 3 % 2).float().expand(2, -1)[..., None]
    assert (find_switches(restless) is not None) == (times <= MOST)


def test_a_joint_that_moves_through_its_middle_does_not_switch() -> None:
    assert find_switches(torch.linspace(0, 1, 30).expand(4, -1)[..., None]) is None


def test_a_joint_that_never_moves_does_not_switch() -> None:
    assert find_switches(torch.ones(3, 5, 2)) is None


def test_the_start_is_no_change_of_side() -> None:
    assert changes_side(torch.tensor([[[1.0], [1.0], [0.0]]]), 0.5)[0, :, 0].tolist() == [False, False, True]


def test_memory_tells_where_a_goal_between_those_shown_is_gripped_and_let_go() -> None:
    config = TrainConfig(updates=1, batch_size=6, rest_steps=3, precision="float32")
    model = train([gripping(far) for far in np.linspace(0.2, 1, 9)], ModelConfig.tiny(), config=config)
    assert model.switching.tolist() == [2, 2]
    wanted = gripping(0.65)
    start, goal = (as_inputs(model, each, name="percept") for each in (wanted.first, wanted.last))
    gripped, let_go = expected_at_switches(model, ToGoal(start, goal))
    assert gripped.mean.numpy() == pytest.approx(wanted.joints[3], abs=0.02)
    assert let_go.mean.numpy() == pytest.approx(wanted.joints[6], abs=0.04)
    found = plan(model, start=wanted.first, goal=Percept(wanted.last.frame), config=PlanConfig(precision="float32", iterations=0))
    assert found.recalled is not None
    assert found.recalled.shape == (3, 3)


def test_a_plan_switches_where_its_joint_crosses_the_middle_of_its_range() -> None:
    model = train([gripping(far) for far in (0.4, 0.9)], ModelConfig.tiny(), config=TrainConfig(updates=1, rest_steps=3))
    assert switch_steps(model, torch.from_numpy(gripping(0.6).joints)) == [3, 6]
