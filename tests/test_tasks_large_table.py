"""The tasks on the large table, one by one: two points, and an object that is moved."""

import dataclasses

import mujoco
import numpy as np
import pytest

from preimage.records import Scene
from preimage.robot import (
    Arm,
    GroundTruth,
    MoveObject,
    ReachTwo,
    forward_kinematics,
    move_object,
    succeeds_within,
    two_points,
)
from preimage.robot.execution import play
from preimage.robot.kinematics import grasping_joints, reaching_joints
from preimage.robot.task import NEVER_M, apart_m, at_height
from test_tasks import MILLIMETRE, scenes_of

PIXEL_M = 0.013
"""The paper's pixel."""


@pytest.fixture(scope="module")
def arm():
    return Arm()


# Two points


def hand_at(x, y, z, gripper_m=0.0, object_m=None, uprightness=1.0):
    thing = None if object_m is None else np.array(object_m)
    return GroundTruth(np.array([x, y, z]), np.array([x, y, z]), gripper_m, thing, None if thing is None else uprightness)


TWO = Scene("two-points", (0.0,) * 4, {"marker": (0.4, 0.0, 0.0), "goal": (0.6, 0.2, 0.03)})


@pytest.mark.parametrize(
    ("way", "end", "touched", "error_m", "success"),
    [
        ((0.40, 0.03, 0.02), (0.60, 0.20, 0.03), True, 0.03, True),
        ((0.40, 0.059, 0.039), (0.60, 0.239, 0.03), True, 0.059, True),
        ((0.40, 0.061, 0.02), (0.60, 0.20, 0.03), False, 0.061, False),
        ((0.40, 0.00, 0.041), (0.60, 0.20, 0.05), False, NEVER_M, False),
        ((0.40, 0.00, 0.02), (0.60, 0.241, 0.03), True, 0.0, False),
    ],
)
def test_two_points_are_judged_by_hand(way, end, touched, error_m, success):
    judgement = ReachTwo().judge(TWO, [hand_at(0.2, 0, 0.3), hand_at(*way), hand_at(*end)])
    assert judgement.details["touched"] is touched
    assert judgement.details["marker_error_m"] == pytest.approx(error_m)
    assert judgement.success is success
    assert judgement.deviation_m == pytest.approx(np.linalg.norm(np.subtract(end, TWO.positions_m["goal"])))


def test_going_straight_to_the_goal_is_not_enough(arm):
    task = ReachTwo()
    for scene in scenes_of(task, 2):
        start, goal = np.array(scene.start_joints), reaching_joints(np.array(scene.positions_m["goal"]))
        trial = play(start + (goal - start) * np.linspace(0, 1, 30)[:, None], 10, arm, scene)
        assert trial.deviation_m < MILLIMETRE
        assert trial.success is bool(trial.details["touched"])
    assert not trial.success


def test_marker_and_goal_lie_apart_and_where_the_arm_reaches(arm):
    for scene in scenes_of(ReachTwo(), 200):
        places = np.array([scene.positions_m["marker"], scene.positions_m["goal"]])
        assert apart_m(*places) >= two_points.APART_M
        assert (np.linalg.norm(places - forward_kinematics(np.array(scene.start_joints)), axis=1) > 0.1).all()
        assert ReachTwo().is_in_reach(places[:, :2]).all()
    assert two_points.reachable_share(ReachTwo()) == pytest.approx(0.452, abs=0.005)


def test_the_tutor_touches_the_marker_but_not_the_table(arm, recorded):
    for demonstration in recorded["two-points"]:
        heights_m = forward_kinematics(demonstration.joints)[:, 2]
        assert heights_m.min() < two_points.LOW_M
        arm.set_up(ReachTwo().workspace)
        for joints in demonstration.joints:
            arm.reset(joints)
            assert arm._data.ncon == 0


# Moving an object

MOVE = Scene("two-circles", (0.0,) * 5, {"object": (0.4, 0.0, 0.05), "circle": (0.6, 0.2, 0.0), "other_circle": (0.6, -0.2, 0.0)})
OPEN, CLOSED = 0.04, 0.0


def moved(end, *, uprightness=1.0, lifted_to=0.2, grasp=(0.41, 0.0), release=(0.6, 0.2), last_gripper=OPEN):
    """A course: open above the object, closed on it, lifted, at the circle, open there."""
    return [
        hand_at(*grasp, 0.16, OPEN, (0.4, 0, 0.05)),
        hand_at(*grasp, 0.08, 0.019, (0.405, 0, 0.05)),
        hand_at(0.5, 0.1, 0.2, CLOSED, (0.5, 0.1, lifted_to)),
        hand_at(*release, 0.08, 0.021, end),
        hand_at(*release, 0.2, last_gripper, end, uprightness),
    ]


@pytest.mark.parametrize(
    ("course", "failing"),
    [
        (moved((0.6, 0.2, 0.05)), set()),
        (moved((0.6, 0.259, 0.05)), set()),
        (moved((0.6, 0.261, 0.05)), {"inside"}),
        (moved((0.6, 0.2, 0.05), uprightness=0.94), {"upright"}),
        (moved((0.6, 0.2, 0.05), lifted_to=0.07), {"grasped"}),
        (moved((0.6, 0.2, 0.05), last_gripper=CLOSED), {"released"}),
        (moved((0.6, 0.2, 0.1)), {"released"}),
    ],
)
def test_moving_is_judged_by_hand(course, failing):
    judgement = MoveObject().judge(MOVE, course)
    assert {name for name in ("grasped", "upright", "inside", "released") if not judgement.details[name]} == failing
    assert judgement.success is (not failing)
    assert judgement.details["grasp_error_m"] == pytest.approx(0.01), "from where the object stood, not from where it was pushed"
    assert judgement.details["release_error_m"] == pytest.approx(0)
    assert judgement.deviation_m == judgement.details["place_error_m"]
    assert judgement.details["inside_other"] is False


def test_the_wrong_circle_is_told_from_the_right_one():
    details = MoveObject.with_two_circles().judge(MOVE, moved((0.6, -0.2, 0.05), release=(0.6, -0.2))).details
    assert details["inside_other"] is True
    assert details["inside"] is False
    assert details["place_error_m"] == pytest.approx(0.4)
    one_circle = dataclasses.replace(MOVE, positions_m={name: MOVE.positions_m[name] for name in ("object", "circle")})
    assert "inside_other" not in MoveObject().judge(one_circle, moved((0.6, 0.2, 0.05))).details


def test_a_hand_that_never_closes_or_never_opens_again():
    never_closed = [hand_at(0.4, 0, 0.1, OPEN, (0.4, 0, 0.05))] * 3
    details = MoveObject().judge(MOVE, never_closed).details
    assert details["grasp_error_m"] == details["release_error_m"] == NEVER_M
    never_opened = [*never_closed, hand_at(0.4, 0, 0.08, CLOSED, (0.4, 0, 0.05))]
    details = MoveObject().judge(MOVE, never_opened).details
    assert details["grasp_error_m"] == 0
    assert details["release_error_m"] == NEVER_M


@pytest.mark.parametrize(
    ("grasp_cm", "release_cm", "pixels_that_count"),
    [(1.2, 0, [1, 2, 3]), (2.5, 5.9, [2, 3]), (3.8, 0, [3]), (4.0, 0, []), (1.0, 6.1, [])],
)
def test_allowances_of_table_3(grasp_cm, release_cm, pixels_that_count):
    course = moved((0.4, 0.0, 0.05), grasp=(0.4 + grasp_cm / 100, 0.0), release=(0.6, 0.2 + release_cm / 100))
    judgement = MoveObject().judge(MOVE, course)
    assert not judgement.success
    assert [pixels for pixels in range(4) if succeeds_within(judgement.details, pixels * PIXEL_M)] == pixels_that_count


def test_success_counts_whatever_the_allowance():
    details = MoveObject().judge(MOVE, moved((0.6, 0.2, 0.05), grasp=(0.45, 0.0))).details
    assert all(succeeds_within(details, pixels * PIXEL_M) for pixels in range(4))


@pytest.mark.parametrize(("offset_cm", "success"), [(1, True), (-1, True), (3, False), (-3, False)])
def test_how_far_beside_the_object_the_hand_may_close(arm, offset_cm, success):
    """Across the fingers: half their opening, less half the object's width, is 1.5 cm."""
    task, rng = MoveObject(), np.random.default_rng(0)
    pairs = [(scene, scene_with_object_moved(scene, offset_cm / 100)) for scene in scenes_of(task, 10)]
    scene, beside = next(pair for pair in pairs if task.is_in_reach(np.array(pair[1].positions_m["object"][:2])))
    trial = play(task.demonstration_path(rng, beside), task.rate_hz, arm, scene)
    assert trial.success is success
    assert trial.details["grasp_error_m"] == pytest.approx(abs(offset_cm) / 100, abs=0.008), "blocked or not"


def scene_with_object_moved(scene, sideways_m):
    """The scene as a demonstrator sees it who is wrong about where the object is, along the line from finger to finger."""
    x, y, z = scene.positions_m["object"]
    radius, away = np.hypot(x + 0.1, y), np.array([-y, x + 0.1])
    return dataclasses.replace(scene, positions_m={**scene.positions_m, "object": (*(np.array([x, y]) + sideways_m * away / radius), z)})


def test_object_and_circles_lie_apart_and_where_the_arm_grasps():
    task = MoveObject.with_two_circles()
    for scene in scenes_of(task, 100):
        places = np.array(list(scene.positions_m.values()))
        distances = [apart_m(places[one], places[other]) for one, other in ((0, 1), (0, 2), (1, 2))]
        assert min(distances) >= move_object.APART_M
        assert task.is_in_reach(places[:, :2]).all()
        heights_m = np.linspace(move_object.GRASP_M, move_object.CARRY_M, 30)
        assert not np.isnan([grasping_joints(at_height(places[:, :2], height_m)) for height_m in heights_m]).any()
    assert move_object.reachable_share(task) == pytest.approx(0.387, abs=0.005)


def test_either_circle_is_meant():
    """The circle that is meant lies to the left of the other one as often as not."""
    scenes = scenes_of(MoveObject.with_two_circles(), 200)
    left = sum(scene.positions_m["circle"][1] > scene.positions_m["other_circle"][1] for scene in scenes)
    assert 80 < left < 120


def test_the_start_does_not_tell_which_circle_is_meant(arm):
    task = MoveObject.with_two_circles()
    scene = scenes_of(task, 1)[0]
    swapped = {**scene.positions_m, "circle": scene.positions_m["other_circle"], "other_circle": scene.positions_m["circle"]}
    frames = []
    for positions_m in (scene.positions_m, swapped):
        task.lay_out(arm, dataclasses.replace(scene, positions_m=positions_m))
        frames.append(arm.sense().frame)
    np.testing.assert_array_equal(*frames)


def test_the_gripper_of_a_demonstration_is_open_closed_open(recorded):
    for demonstration in recorded["move-object"]:
        gripper = demonstration.joints[:, 4]
        assert set(gripper.round(9)) == {OPEN, CLOSED}
        assert np.count_nonzero(np.diff(gripper)) == 2


def test_the_tutor_takes_the_object_along_and_nothing_else_touches_it(arm, recorded):
    """Only the fingers touch the object, and the hand touches nothing else."""
    task, demonstration = MoveObject(), recorded["move-object"][0]
    task.lay_out(arm, demonstration.scene)
    touching = set()
    for joints in demonstration.joints[1:]:
        arm.move(joints, 1 / task.rate_hz)
        mujoco.mj_collision(arm._model, arm._data)
        bodies = arm._model.geom_bodyid[arm._data.contact.geom]
        touching |= {tuple(sorted(arm._model.body(body).name for body in pair)) for pair in bodies.tolist()}
    assert touching <= {("object", "world"), ("left_finger", "object"), ("object", "right_finger")}
