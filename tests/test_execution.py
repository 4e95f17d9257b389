"""Execution: limits, blind plans, and policies that see what the robot senses."""

import dataclasses

import numpy as np
import pytest

from played import plan_of
from preimage.robot import TASKS, Arm, MoveObject, Reach, forward_kinematics, record, with_frames
from preimage.robot.execution import execute, execute_open_loop, limits_of, play
from preimage.robot.limits import Limits, within_limits

LIMITS = Limits(("yaw", "gripper"), ("rad", "m"), np.array([-1.0, 0.0]), np.array([1.0, 0.04]), np.array([2.0, 0.1]))


@pytest.fixture(scope="module")
def arm():
    return Arm()


@pytest.fixture(scope="module")
def shown():
    """One demonstration of every task, by name."""
    return {name: record(Arm(), task, count=1, seed=0)[0] for name, task in TASKS.items()}


@pytest.fixture(params=TASKS)
def demonstration(shown, request):
    return shown[request.param]


def repeat(joints):
    """A policy that commands one row after the other, whatever it senses."""
    rows = iter(joints)
    return lambda percept: next(rows)


# Limits


def test_what_is_allowed_passes_unchanged():
    wanted = np.array([[0.0, 0.04], [0.3, 0.03], [0.1, 0.03]])
    commands, limited = within_limits(wanted, LIMITS, period_s=0.2)
    np.testing.assert_allclose(commands, wanted, atol=1e-12)
    assert limited == ()


def test_too_fast_is_made_up_for_later():
    """At 0.5 s a step, 2 rad/s allow 1 rad a step, and 0.1 m/s allow 5 cm."""
    commands, limited = within_limits(np.array([[-1.0, 0.0], [0.9, 0.0], [0.9, 0.0]]), LIMITS, period_s=0.5)
    assert commands[:, 0].tolist() == pytest.approx([-1, 0, 0.9])
    assert limited == ("yaw slowed to 2 rad/s in 1 step",)


def test_steps_are_added_until_the_end_is_reached():
    commands, limited = within_limits(np.array([[0.0, 0.04], [0.0, 0.0]]), LIMITS, period_s=0.1)
    assert commands[:, 1].tolist() == pytest.approx([0.04, 0.03, 0.02, 0.01, 0.0])
    assert limited == ("gripper slowed to 0.1 m/s in 3 steps",)


def test_what_lies_outside_is_kept_inside():
    commands, limited = within_limits(np.array([[0.9, 0.04], [1.1, 0.06], [1.2, 0.04]]), LIMITS, period_s=1.0)
    assert commands.max(axis=0).tolist() == [1.0, 0.04]
    assert limited == ("yaw kept above -1 and below 1 rad in 2 steps", "gripper kept above 0 and below 0.04 m in 1 step")


def test_wild_commands_keep_every_limit():
    wanted = np.random.default_rng(0).normal(scale=2, size=(50, 2))
    wanted[0] = [0.0, 0.02]
    commands, _ = within_limits(wanted, LIMITS, period_s=0.1)
    assert ((commands >= LIMITS.lower) & (commands <= LIMITS.upper)).all()
    assert (np.abs(np.diff(commands, axis=0)) <= LIMITS.velocity * 0.1 + 1e-9).all()
    np.testing.assert_allclose(commands[-1], np.clip(wanted[-1], LIMITS.lower, LIMITS.upper), atol=1e-6)


def test_the_limits_are_those_of_the_hand_the_arm_wears():
    arm = Arm()
    assert limits_of(arm).units == ("rad",) * 4
    arm.set_up(MoveObject().workspace)
    limits = limits_of(arm)
    assert (limits.joint_names[4], limits.units[4], limits.lower[4], limits.upper[4]) == ("gripper", "m", 0.0, 0.04)


# Blind


def test_a_true_plan_succeeds(arm, demonstration):
    trial = execute(plan_of(demonstration), arm, demonstration.scene)
    assert trial.success
    assert trial.limited == ()
    assert trial.scene is demonstration.scene
    assert len(trial.frames) == len(trial.joints) == len(trial.end_effector_m) == len(demonstration) + 1, "one more, at rest"
    np.testing.assert_array_equal(trial.frames[0], demonstration.frames[0])
    np.testing.assert_allclose(forward_kinematics(trial.joints[:, :4]), trial.end_effector_m, atol=1e-3)


def test_without_a_film_the_same_happens(arm, demonstration):
    filmed, unseen = (execute(plan_of(demonstration), arm, demonstration.scene, filmed=filmed) for filmed in (True, False))
    assert unseen.frames.shape == (0, *filmed.frames.shape[1:])
    np.testing.assert_array_equal(unseen.joints, filmed.joints)
    np.testing.assert_array_equal(unseen.end_effector_m, filmed.end_effector_m)
    assert (unseen.success, unseen.deviation_m, unseen.details) == (filmed.success, filmed.deviation_m, filmed.details)


def test_execution_ends_at_the_arrival_step(arm, shown):
    demonstration = shown["reach"]
    trial = execute(plan_of(demonstration, arrival_step=5), arm, demonstration.scene)
    assert len(trial.frames) == 5 + 2
    assert not trial.success


def test_an_arm_that_stood_at_another_task_is_refurnished(shown):
    arm = Arm()
    for name in ("move-object", "reach", "two-points", "move-object"):
        trial = execute(plan_of(shown[name], arrival_step=1), arm, shown[name].scene)
        np.testing.assert_array_equal(trial.frames[0], shown[name].frames[0])


def test_a_trial_can_be_seen_in_other_frames(arm, shown):
    demonstration = shown["reach"]
    trial = execute(plan_of(demonstration), arm, demonstration.scene, task=with_frames(Reach(), 32))
    assert trial.frames.shape[1:] == (32, 32, 1)
    assert trial.success


def test_a_plan_for_other_joints_is_refused(arm, shown):
    with pytest.raises(ValueError, match="the plan moves joint1, joint2, joint4, joint6, move-object needs joint1"):
        execute(plan_of(shown["reach"]), arm, shown["move-object"].scene)


def test_a_scene_of_an_unknown_task_is_refused(arm, shown):
    scene = dataclasses.replace(shown["reach"].scene, task="juggle")
    with pytest.raises(ValueError, match="the scene is of task 'juggle'; known are reach, two-points"):
        play(shown["reach"].joints, 10, arm, scene)


# Open loop


def test_a_policy_that_repeats_the_tutor_succeeds(arm, demonstration):
    blind = play(demonstration.joints, demonstration.rate_hz, arm, demonstration.scene)
    trial = execute_open_loop(
        repeat(demonstration.joints[1:]), arm, demonstration.scene, num_steps=len(demonstration) - 1, rate_hz=demonstration.rate_hz
    )
    assert trial.success
    np.testing.assert_array_equal(trial.joints, blind.joints)
    np.testing.assert_array_equal(trial.frames, blind.frames)
    assert trial.details == blind.details


def test_a_policy_senses_what_the_trial_keeps(arm, shown):
    demonstration, sensed = shown["reach"], []

    def stay(percept):
        sensed.append(percept)
        return percept.joints

    trial = execute_open_loop(stay, arm, demonstration.scene, num_steps=3, rate_hz=10)
    assert len(sensed) == 3
    assert len(trial.frames) == 3 + 2
    np.testing.assert_array_equal([percept.joints for percept in sensed], trial.joints[:3])
    np.testing.assert_array_equal([percept.frame for percept in sensed], trial.frames[:3])


def test_a_policy_that_asks_for_too_much_is_slowed(arm, shown):
    demonstration = shown["reach"]
    far = np.add(demonstration.scene.start_joints, [2.0, 0, 0, 0])
    trial = execute_open_loop(lambda percept: far, arm, demonstration.scene, num_steps=3, rate_hz=10)
    assert trial.limited == ("joint1 slowed to 2.175 rad/s in 3 steps",)
    assert np.abs(np.diff(trial.joints[:4, 0])).max() < 0.25


def test_a_policy_can_correct_what_it_senses(arm, shown):
    """It steps from where the arm really is, not from where it was told to be, and arrives."""
    demonstration = shown["reach"]
    goal = demonstration.last.joints

    def step(percept):
        return percept.joints + np.clip(goal - percept.joints, -0.1, 0.1)

    assert execute_open_loop(step, arm, demonstration.scene, num_steps=40, rate_hz=10).success


def test_a_policy_for_other_joints_is_refused(arm, shown):
    with pytest.raises(ValueError, match="policy"):
        execute_open_loop(lambda percept: np.zeros(3), arm, shown["reach"].scene, num_steps=1, rate_hz=10)


def test_no_steps_are_refused(arm, shown):
    with pytest.raises(ValueError, match="num_steps is 0"):
        execute_open_loop(lambda percept: percept.joints, arm, shown["reach"].scene, num_steps=0, rate_hz=10)
