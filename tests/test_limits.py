"""Limits for a robot that is known by its demonstrations alone: what was seen, what a file says, and commands that keep to both."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from preimage.data.sequences import sensors_of
from preimage.records import Percept, Plan, Shown, Stopped
from preimage.robot.limits import commands_of, limits_seen, read_limits
from shared import make_demonstration

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


@given(st.integers(0, 10**6), st.sampled_from([None, 1.0, 10.0, 30.0, 37.3]))
def test_whatever_is_planned_the_commands_keep_to_the_limits_and_end(seed, rate_hz):
    wanted = np.random.default_rng(seed).normal(scale=2, size=(5, 2))
    commands, _ = commands_of(plan_along(wanted), SEEN, rate_hz=rate_hz)
    np.testing.assert_array_equal(commands[0], wanted[0])  # where the robot stands
    outside = np.maximum(SEEN.lower - commands, 0) + np.maximum(commands - SEEN.upper, 0)
    assert (np.diff(outside, axis=0) <= 1e-9).all()  # it only comes in
    assert (outside[-1] <= 1e-4).all()
    assert (np.abs(np.diff(commands, axis=0)) <= SEEN.velocity / (rate_hz or 10) + 1e-9).all()
    np.testing.assert_allclose(commands[-1], np.clip(wanted[-1], SEEN.lower, SEEN.upper), atol=1e-4)


def test_a_start_outside_the_limits_is_not_jumped_away_from():
    limits = replace(SEEN, lower=np.full(2, -1.0), upper=np.full(2, 1.0), velocity=np.full(2, 4.0))
    start = Percept(joints=np.array([2.0, 0.5]))
    commands, limited = commands_of(plan_along(np.array([[0.9, 0.5], [0.9, 0.5], [0.9, 0.5], [0.9, 0.5]]), start=start), limits)
    np.testing.assert_allclose(commands[:, 0], [2.0, 1.6, 1.2, 0.9])
    assert limited[0] == "joint 0 stands at 2 units, outside -1 to 1, from where it comes in at 4 units/s or slower"


@pytest.mark.parametrize("limit", [{"step": 1e-6}, {"velocity": 1e-9}, {"step": 1e-300}, {"step": 5e-324}])
def test_the_steps_that_limits_add_are_bounded(tmp_path, limit):
    (tmp_path / "limits.json").write_text(json.dumps({"joint 1": limit}))
    limits = read_limits(tmp_path / "limits.json", SEEN, rate_hz=10.0)
    with pytest.raises(ValueError, match=r"joint 1 would need .* more steps at .* units/s, and at most 10000 are added"):
        commands_of(plan_along(np.array([[0.0, 0.0], [0.1, 0.4]])), limits)


def test_added_steps_are_reported():
    limits = replace(SEEN, velocity=np.array([4.0, 0.1]))
    _, limited = commands_of(plan_along(np.array([[0.0, 0.0], [0.0, 0.1], [0.0, 0.1]])), limits)
    assert limited[-1] == "the limits add 8 steps (0.8 s) to 3 steps"


def test_between_steps_the_way_is_straight_and_as_fast_as_from_step_to_step():
    limits = replace(SEEN, velocity=np.full(2, 10.0))
    commands, limited = commands_of(plan_along(np.array([[0.0, 0.0], [0.1, 0.2], [0.1, 0.1]])), limits, rate_hz=40.0)
    np.testing.assert_allclose(commands[:, 1], [0, 0.05, 0.1, 0.15, 0.2, 0.175, 0.15, 0.125, 0.1])
    assert limited == ()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_is_never_commanded(value):
    with pytest.raises(ValueError, match=r"joint 1 is (nan|inf) at step 1: a robot is commanded finite joints only"):
        commands_of(plan_along(np.array([[0.0, 0.0], [0.0, value], [0.0, 0.0]])), SEEN)
    with pytest.raises(ValueError, match="limits hold numbers that are not finite"):
        replace(SEEN, upper=np.array([0.1, value]))


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
        ('{"joint 1": {"upper": 1e999}}', "has upper inf for joint 1"),
        ('{"joint 1": {"upper": 1' + 400 * "0" + "}}", "has upper 1000"),
        ("[" * 100_000, "is no JSON file that can be read"),
        ("\x00", "is no JSON file that can be read"),
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


@pytest.mark.parametrize("unit", [None, "rad"])
def test_limits_in_degrees_of_joints_in_radians_are_refused(tmp_path, unit):
    path = tmp_path / "limits.json"
    path.write_text(json.dumps({name: {"lower": -170, "upper": 165} for name in SEEN.joint_names}))
    with pytest.raises(ValueError, match=r"lets joint 0 go from -170 to 165, and it was demonstrated from .*: 170 degrees are 2.967 rad"):
        read_limits(path, limits_seen(sensors_of(RECORDED), SHOWN, unit=unit), rate_hz=10.0)
    assert read_limits(path, limits_seen(sensors_of(RECORDED), SHOWN, unit="mm"), rate_hz=10.0).upper.tolist() == [165, 165]
