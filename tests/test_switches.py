"""Laws of switches: what every demonstration switches is found, at the step at which it is on the other side; what merely moves is not."""

import pytest
import torch

from preimage.switches import MOST, changes_side, find_switches


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
