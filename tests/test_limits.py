"""Limits for a robot that is known by its demonstrations alone: what was seen, what a file says, and commands that keep to both."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import make_demonstration
from preimage.data.sequences import sensors_of
from preimage.records import Percept, Plan, Shown, Stopped
from preimage.robot.limits import commands_of, limits_seen, read_limits

RECORDED = [make_demonstration(seed, num_joints=2, num_steps=5 + seed, size=(16, 16, 1)) for seed in range(3)]
SHOWN = [Shown(one.frames[-1], one.joints, one.rate_hz) for one in RECORDED]
SEEN = limits_seen(sensors_of(RECORDED), SHOWN)


def plan_along(joints: np.ndarray, *, arrival_step: int | None = None, start: Percept | None = None) -> Plan:
    frames = np.arange(len(joints), dtype=np.uint8)[:, None, None, None] * np.ones((16, 16, 1), np.uint8)
    start = start or Percept(frames[0], joints[0])
    arrival = len(joints) - 1 if arrival_step is None else arrival_step
    known = {"error": 0.0, "errors": np.zeros(1), "stopped": Stopped.CONVERGED, "seconds": 0.0, "intention": np.zeros(1)}
    return Plan(frames, joints, arrival, 10.0, ("joint 0", "joint 1"), start, Percept(frames[-1]), **known)


@pytest.mark.parametrize("demonstration", RECORDED)
def test_what_was_demonstrated_may_be_commanded(demonstration):
    commands, limited = commands_of(plan_along(demonstration.joints), SEEN)
    np.testing.assert_allclose(commands, demonstration.joints)
    assert limited == ()


def test_twice_as_fast_as_was_ever_shown_takes_longer_and_is_told():
    fastest = max(RECORDED, key=lambda one: np.abs(np.diff(one.joints[:, 0])).max())
    commands, limited = commands_of(plan_along(fastest.joints[::2]), SEEN)
    assert np.abs(np.diff(commands, axis=0) * 10).max(0)[0] <= SEEN.velocity[0] * (1 + 1e-9)
    assert len(commands) > len(fastest.joints[::2])
    np.testing.assert_allclose(commands[-1], fastest.joints[::2][-1], atol=1e-6)
    assert any(sentence.startswith("joint 0 slowed to ") for sentence in limited)


@given(st.integers(0, 10**6))
def test_whatever_is_planned_the_commands_keep_to_the_limits_and_end(seed):
    wanted = np.random.default_rng(seed).normal(scale=2, size=(5, 2))
    commands, _ = commands_of(plan_along(wanted), SEEN)
    assert (commands >= SEEN.lower - 1e-9).all()
    assert (commands <= SEEN.upper + 1e-9).all()
    assert (np.abs(np.diff(commands, axis=0)) <= SEEN.velocity / 10 + 1e-9).all()
    np.testing.assert_allclose(commands[-1], np.clip(wanted[-1], SEEN.lower, SEEN.upper), atol=1e-4)


def test_a_joint_that_never_moved_does_not_stop_the_plan():
    still = [replace(one, joints=one.joints * [1.0, 0.0]) for one in RECORDED]
    limits = limits_seen(sensors_of(still), [Shown(one.frames[-1], one.joints, one.rate_hz) for one in still])
    commands, _ = commands_of(plan_along(np.array([[0.0, 0.0], [0.0, 5e-4]])), limits)
    assert commands[-1, 1] == pytest.approx(5e-4, abs=1e-6)


def test_commands_begin_where_the_robot_stands_and_end_at_the_arrival():
    joints = np.linspace([0.0, 0.0], [0.01, 0.01], 5)
    commands, _ = commands_of(plan_along(joints, arrival_step=3, start=Percept(joints=np.array([0.001, 0.0]))), SEEN)
    assert commands[0].tolist() == [0.001, 0.0]
    np.testing.assert_allclose(commands[1:], joints[1:4])


def test_a_file_overrides_what_it_names(tmp_path):
    path = tmp_path / "limits.json"
    path.write_text(json.dumps({"joint 1": {"upper": 0.5, "step": 0.02, "velocity": 0.3}}))
    limits = read_limits(path, SEEN, rate_hz=10.0)
    assert (limits.lower[1], limits.upper[1], limits.velocity[1]) == (SEEN.lower[1], 0.5, pytest.approx(0.2))
    assert (limits.lower[0], limits.upper[0], limits.velocity[0]) == (SEEN.lower[0], SEEN.upper[0], SEEN.velocity[0])


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("{", "is no JSON file that can be read"),
        ("[1]", "holds no limits by joint"),
        ('{"joint 1": 3}', "holds no limits by joint"),
        ('{"elbow": {"lower": 0}}', "limits elbow, the plan moves joint 0, joint 1"),
        ('{"joint 1": {"lower": true}}', "has lower True for joint 1: give numbers for lower, upper, velocity, step"),
        ('{"joint 1": {"lowest": 0}}', "has lowest 0 for joint 1: give numbers for lower, upper, velocity, step"),
        ('{"joint 1": {"lower": "0"}}', "has lower '0' for joint 1"),
        ('{"joint 1": {"lower": NaN}}', "has lower nan for joint 1"),
        ('{"joint 1": {"lower": 1, "upper": 1}}', "leaves joint 1 no room"),
        ('{"joint 1": {"velocity": 0}}', "leaves joint 1 no room"),
    ],
)
def test_a_file_that_is_off_is_told(tmp_path, content, sentence):
    (tmp_path / "limits.json").write_text(content)
    with pytest.raises(ValueError, match=sentence) as told:
        read_limits(tmp_path / "limits.json", SEEN, rate_hz=10.0)
    assert "\n" not in str(told.value)


def test_a_file_that_is_missing_is_told(tmp_path):
    with pytest.raises(ValueError, match=r"limits.json is no JSON file that can be read"):
        read_limits(tmp_path / "limits.json", SEEN, rate_hz=10.0)
