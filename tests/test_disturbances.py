"""Laws of robots that are driven, and of what disturbs them: limits are kept, and what goes wrong is what is said and no more."""

from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
import pytest

from played import plan_of
from preimage.data.sequences import at_rate
from preimage.evaluation.disturbed import cells_for
from preimage.evaluation.loops import Disturbed
from preimage.evaluation.trials import Circumstances, try_out
from preimage.presets import ReplanConfig
from preimage.records import Demonstration, Percept
from preimage.robot import TASKS, Arm, forward_kinematics
from preimage.robot.disturbances import BIAS_RAD, DISTURBANCES, LATE_S, OBJECT_M, PUSH_M, disturbance_of
from preimage.robot.execution import execute
from preimage.robot.limits import Limits
from preimage.robot.protocol import drive
from preimage.robot.simulated import SimulatedRobot

PERIOD_S = 0.4


@pytest.fixture(scope="module")
def arm() -> Arm:
    return Arm()


@pytest.fixture
def shown(recorded) -> Demonstration:
    return recorded["reach"][0]


def robot_of(arm: Arm, demonstration: Demonstration, kind: str | None, **how) -> SimulatedRobot:
    """The arm in a scene, disturbed at its second step."""
    scene, task = demonstration.scene, TASKS[demonstration.scene.task]
    disturbance = disturbance_of(kind, scene, **{"half": 2, "grasp": 2, "seed": (0,)} | how) if kind else None
    return SimulatedRobot(arm, task, scene, rate_hz=1 / PERIOD_S, disturbance=disturbance)


def sensed(robot: SimulatedRobot, joints: np.ndarray, num_steps: int = 4) -> list[Percept]:
    """What is sensed on a way straight to some joints."""
    begin = robot.sense()
    percepts = [begin]
    for step in range(1, num_steps + 1):
        robot.command(begin.joints + (joints - begin.joints) * step / num_steps)
        percepts.append(robot.sense())
    return percepts


def hand_m(percept: Percept) -> np.ndarray:
    return forward_kinematics(percept.joints[:4])


def test_what_can_be_asked_for_is_what_there_is():
    assert get_args(Disturbed) == DISTURBANCES


def test_a_push_is_as_far_as_it_is_said_and_over_with_the_next_command(arm, shown):
    as_usual, pushed = (sensed(robot_of(arm, shown, kind), shown.joints[-1]) for kind in (None, "push"))
    apart = [float(np.linalg.norm(hand_m(one) - hand_m(other))) for one, other in zip(as_usual, pushed, strict=True)]
    assert apart[1] < 1e-3
    assert apart[2] == pytest.approx(PUSH_M, abs=0.01)
    assert apart[4] < 5e-3
    robot = robot_of(arm, shown, "push")
    sensed(robot, shown.joints[-1])
    trial = robot.finish()
    assert len(trial.frames) == len(trial.end_effector_m) == 6  # a push is no moment of its own


def test_a_biased_encoder_is_believed_by_the_motor(arm, shown):
    as_usual, biased = (robot_of(arm, shown, kind) for kind in (None, "bias"))
    one, other = (sensed(robot, shown.joints[-1]) for robot in (as_usual, biased))
    off = other[0].joints - one[0].joints
    assert np.sort(np.abs(off)) == pytest.approx([0, 0, 0, BIAS_RAD])
    np.testing.assert_allclose(other[-1].joints, one[-1].joints, atol=2e-3)  # it reads what was asked for
    assert float(np.linalg.norm(biased.finish().end_effector_m[-1] - as_usual.finish().end_effector_m[-1])) > 0.005


def test_frames_go_missing_as_often_as_it_is_said_but_never_the_first(arm, shown):
    robot = robot_of(arm, shown, "camera")
    frames = [robot._disturbance.sensed(shown.first, step).frame is None for step in range(1000)]
    assert not frames[0]
    assert 0.15 < np.mean(frames) < 0.25


def test_a_late_frame_shows_where_the_arm_was(arm, shown):
    late, usual = robot_of(arm, shown, "late"), robot_of(arm, shown, None)
    one, other = sensed(late, shown.joints[-1]), sensed(usual, shown.joints[-1], num_steps=8)
    half = LATE_S / PERIOD_S
    assert half == 0.5
    np.testing.assert_allclose(one[2].joints, other[4].joints, atol=0.02)
    apart = [np.abs(one[2].frame.astype(float) - each.frame).mean() for each in other]
    assert int(np.argmin(apart)) == 3


def test_a_moved_object_is_judged_from_where_it_stands(arm, recorded):
    shown = recorded["move-object"][0]
    robot = robot_of(arm, shown, "object")
    percepts = sensed(robot, shown.joints[0])
    assert np.abs(percepts[2].frame.astype(int) - percepts[1].frame).max() > 50
    moved = np.subtract(robot._stage.scene.positions_m["object"], shown.scene.positions_m["object"])
    assert float(np.linalg.norm(moved)) == pytest.approx(OBJECT_M)
    np.testing.assert_allclose(arm.ground_truth().object_m[:2], robot._stage.scene.positions_m["object"][:2], atol=1e-3)


def test_the_judge_takes_the_new_goal_at_half_the_way(arm, recorded):
    one, other = recorded["reach"]
    robot = robot_of(arm, one, "goal", other=other.scene)
    sensed(robot, one.joints[0])
    assert robot._stage.scene.positions_m == other.scene.positions_m


@pytest.mark.parametrize(("kind", "task"), [("goal", "move-object"), ("object", "reach"), ("rain", "reach")])
def test_what_cannot_happen_is_refused(arm, recorded, kind, task):
    with pytest.raises(ValueError, match="--disturb"):
        robot_of(arm, recorded[task][0], kind)


def test_every_loop_meets_everything_that_can_happen():
    cells = cells_for(TASKS["move-object"], ReplanConfig())
    assert {cell.disturb for cell in cells} == {None, "push", "bias", "object", "camera", "late"}
    assert {cell.settings.window for cell in cells if cell.disturb == "object" and cell.settings} == {1, 5, 15, "all"}
    assert len(cells) == len(set(cells))
    assert {cell.disturb for cell in cells_for(TASKS["reach"], ReplanConfig())} == {None, "push", "bias", "goal", "camera", "late"}


def test_undisturbed_a_robot_that_is_driven_does_what_execution_does(arm, shown):
    found = plan_of(at_rate(shown, 2.5))
    usual = execute(found, arm, shown.scene)
    driven, _ = try_out(None, found, arm, TASKS["reach"], shown.scene, "closed", Circumstances())
    assert driven.deviation_m == usual.deviation_m
    np.testing.assert_array_equal(driven.joints, usual.joints)


def test_what_was_recorded_cannot_be_disturbed(arm, shown):
    with pytest.raises(ValueError, match="--loop recorded plays what was recorded, where nothing can go wrong: give closed, open, replan"):
        try_out(None, plan_of(at_rate(shown, 2.5)), arm, TASKS["reach"], shown.scene, "recorded", Circumstances("push"))


# Driving any robot


@dataclass
class Decision:
    command: np.ndarray
    done: bool = False


class Mine:
    """The ten lines."""

    limits = Limits(("yaw",), ("rad",), np.array([-1.0]), np.array([1.0]), velocity=np.array([2.0]))

    def __init__(self) -> None:
        self.at = np.zeros(1)

    def sense(self) -> Percept:
        return Percept(np.zeros((8, 8, 1), np.uint8), self.at)

    def command(self, joints: np.ndarray) -> None:
        self.at = joints


def test_a_robot_is_commanded_within_its_limits_until_it_is_there():
    robot = Mine()
    driven = drive(robot, lambda percept: Decision(np.array([5.0]), done=True), period_s=0.1, most_steps=9)
    np.testing.assert_allclose(driven.commands[:, 0], [0.2, 0.4, 0.6, 0.8, 1.0])
    assert robot.at == pytest.approx(1.0)
    assert driven.limited[0].startswith("yaw kept above -1 and below 1 rad")


@pytest.mark.parametrize("command", [np.zeros(2), np.array([np.nan])])
def test_a_command_that_is_none_is_refused(command):
    with pytest.raises(ValueError, match="is commanded: the robot has yaw"):
        drive(Mine(), lambda percept: Decision(command), period_s=0.1, most_steps=9)


def test_a_robot_that_does_not_feel_itself_is_not_driven():
    robot = Mine()
    robot.sense = lambda: replace(Mine().sense(), joints=None)
    with pytest.raises(ValueError, match="senses no joints"):
        drive(robot, lambda percept: Decision(np.zeros(1)), period_s=0.1, most_steps=9)
    with pytest.raises(ValueError, match="most_steps is 0"):
        drive(Mine(), lambda percept: Decision(np.zeros(1)), period_s=0.1, most_steps=0)


def test_an_environment_is_driven_like_any_robot(shown):
    gymnasium = pytest.importorskip("gymnasium")
    from preimage.robot.gym import EnvironmentRobot

    arm = Arm()
    limits = Limits(arm.joint_names, arm.joint_units, *arm.joint_limits.T, arm.velocity_limits)
    robot = EnvironmentRobot(gymnasium.make("preimage/Reach-v0"), limits, num_actions=4, seed=0)
    there = robot.sense().joints + 0.05
    drive(robot, lambda percept: Decision(there, done=True), period_s=PERIOD_S, most_steps=3)
    np.testing.assert_allclose(robot.sense().joints, there, atol=0.01)
