"""The records refuse what does not fit together, and say which part of it."""

import dataclasses

import numpy as np
import pytest

from preimage.records import Demonstration, Percept, Stopped, verdict_of


def make(num_frames=4, num_angles=4, names=("yaw", "elbow"), num_joints=2):
    joints = np.arange(float(num_angles * num_joints)).reshape(num_angles, num_joints)
    return Demonstration(np.zeros((num_frames, 4, 6, 1), np.uint8), joints, 10.0, names)


def test_a_demonstration_is_a_sequence_of_percepts():
    demonstration = make()
    assert len(demonstration) == 4
    assert demonstration.first.joints.tolist() == [0, 1]
    assert demonstration.last.joints.tolist() == demonstration[3].joints.tolist() == [6, 7]
    assert demonstration[2].frame.shape == (4, 6, 1)


@pytest.mark.parametrize(
    ("parts", "sentence"),
    [
        ({"num_angles": 3}, "frames has 4 steps and joints 3: give one of each per step"),
        ({"num_frames": 1, "num_angles": 1}, "a demonstration needs 2 steps or more .* has 1"),
        ({"names": ("yaw",)}, "joints has 2 angles a step, joint_names names 1"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_parts_that_do_not_fit_together_are_refused(parts, sentence):
    with pytest.raises(ValueError, match=sentence):
        make(**parts)


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_a_joint_that_is_not_finite_is_named(number):
    demonstration = make()
    joints = demonstration.joints.copy()
    joints[2, 1] = number
    with pytest.raises(ValueError, match=f"joints holds {number} at step 2, joint elbow"):
        dataclasses.replace(demonstration, joints=joints)


def test_records_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        make().rate_hz = 5.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        Percept().frame = None


def test_a_goal_may_leave_a_modality_out():
    assert Percept(joints=np.zeros(2)).frame is None
    assert Percept(frame=np.zeros((4, 6, 1), np.uint8)).joints is None


@pytest.mark.parametrize("stopped", Stopped)
def test_every_reason_to_stop_says_what_to_try(stopped):
    assert ";" in stopped.value


WORDS = {0.0: "reached", 0.049: "reached", 0.05: "near", 0.24: "near", 0.25: "in doubt", 3.0: "in doubt", np.nan: "in doubt"}


@pytest.mark.parametrize(("share", "verdict"), WORDS.items())
def test_a_share_of_staying_at_the_start_has_its_word(share, verdict):
    found = verdict_of(share)
    assert found is not None
    assert found.value == verdict
