"""The robot: kinematics, camera, arm and what it touches."""

import mujoco
import numpy as np
import pytest

from preimage.robot import Arm, Camera, Workspace, forward_kinematics, inverse_kinematics
from preimage.robot.arm import CIRCLE_RADIUS_M, GRIPPER_OPEN_M, OBJECT_RADIUS_M
from preimage.robot.camera import Renderer
from preimage.robot.kinematics import BASE_M, HOME_M, PITCHES_DEG, from_polar, grasping_joints, reaching_joints, to_polar
from preimage.robot.task import LARGE_TABLE_CAMERA

MILLIMETRE = 1e-3
OBJECT_M = (0.4, 0.1, 0.05)
POSITIONS_M = {"circle": (0.3, -0.2, 0), "other_circle": (0.6, -0.1, 0), "object": OBJECT_M}
FULL = Workspace(1.0, LARGE_TABLE_CAMERA, circles=("circle", "other_circle"), has_object=True, has_gripper=True)


@pytest.fixture(scope="module")
def arm():
    return Arm()


@pytest.fixture
def handy():
    """An arm with a gripper, an object and two circles in reach."""
    return _handy()


def _handy():
    arm = Arm()
    arm.set_up(FULL)
    arm.reset(arm.home, POSITIONS_M)
    return arm


def stand(arm, position_m):
    """The hand, open and tilted as for a grasp, is at a place, and the things are in theirs."""
    arm.reset([*grasping_joints(np.array(position_m)), GRIPPER_OPEN_M], POSITIONS_M)


def go(arm, position_m, opening_m, seconds):
    """Move the hand, tilted as for a grasp, straight to a place, and let it come to rest."""
    here = arm.end_effector_m
    for share in np.linspace(0.1, 1, 10):
        arm.move([*grasping_joints(here + share * (np.array(position_m) - here)), opening_m], seconds / 10)
    arm.move([*grasping_joints(np.array(position_m)), opening_m], 0.4)


def random_joints(num, seed=0):
    lower, upper = Arm().joint_limits.T
    return np.random.default_rng(seed).uniform(lower, upper, size=(num, len(lower)))


def press(arm, *, x_m, depth_m, seconds):
    """Move from 10 cm above the table straight to a place below its top; the lowest end effector on the way (m)."""
    above, below = reaching_joints(np.array([[x_m, 0.1, 0.1], [x_m, 0.1, -depth_m]]))
    arm.reset(above)
    heights_m = []
    for share in np.linspace(0.1, 1, 10):
        arm.move(above + share * (below - above), seconds=seconds / 10)
        heights_m.append(arm.end_effector_m[2])
    assert forward_kinematics(below)[2] == pytest.approx(-depth_m)
    return min(heights_m)


# Kinematics


def test_inverse_kinematics_undoes_forward_kinematics():
    rng = np.random.default_rng(0)
    positions = np.stack([rng.uniform(-0.2, 0.8, 500), rng.uniform(-0.5, 0.5, 500), rng.uniform(0, 0.5, 500)], axis=1)
    pitches = np.radians(rng.uniform(min(PITCHES_DEG), max(PITCHES_DEG), 500))
    joints = inverse_kinematics(positions, pitches)
    reached = ~np.isnan(joints).any(axis=1)
    assert reached.mean() > 0.3
    np.testing.assert_allclose(forward_kinematics(joints[reached]), positions[reached], atol=1e-12)
    _, shoulder, elbow, wrist = joints[reached].T
    np.testing.assert_allclose(wrist - shoulder + elbow, pitches[reached], atol=1e-12)


def test_a_batch_is_solved_like_its_members():
    positions = np.array([[0.3, 0.1, 0.03], [2.0, 0.0, 0.03], [0.6, -0.2, 0.1]])
    batch = inverse_kinematics(positions, 0.1)
    np.testing.assert_array_equal(batch, [inverse_kinematics(position, 0.1) for position in positions])
    assert np.isnan(batch).all(axis=1).tolist() == [False, True, False]


def test_forward_kinematics_agrees_with_mujoco(arm):
    for joints in random_joints(100):
        arm.reset(joints)
        np.testing.assert_allclose(forward_kinematics(joints), arm.end_effector_m, atol=1e-9)


def test_polar_undoes_itself():
    positions = np.random.default_rng(0).uniform([-0.5, -0.5, 0], [1, 0.5, 1], size=(50, 3))
    np.testing.assert_allclose(from_polar(to_polar(positions)), positions, atol=1e-12)
    np.testing.assert_allclose(to_polar(BASE_M + np.array([0.0, 0.5, 0.2])), [0.5, np.pi / 2, 0.2], atol=1e-12)


def test_constants_agree_with_the_model(arm):
    limits = [arm._model.joint(name).range for name in arm.joint_names]
    np.testing.assert_array_equal(arm.joint_limits, limits)
    assert arm.velocity_limits.shape == (len(arm.joint_names),)


# Camera


def test_frame_depends_on_the_state_alone(arm):
    first, second = reaching_joints(np.array([[0.2, 0.1, 0.3], [0.5, -0.2, 0.03]]))
    arm.reset(first)
    before = arm.sense().frame
    arm.reset(second)
    assert not np.array_equal(arm.sense().frame, before)
    arm.reset(first)
    np.testing.assert_array_equal(arm.sense().frame, before)
    np.testing.assert_array_equal(arm.sense().frame, before)


@pytest.mark.parametrize("make", [Arm, _handy])
def test_every_ray_meets_what_mujocos_single_ray_meets(make):
    arm, camera = make(), Camera(height=32, width=32)
    geoms, _, _ = Renderer(camera, arm._model)._meet(arm._data, np.array(camera.position_m), camera.rays(1)[:, 0])
    met = np.empty(1, np.int32)
    for geom, ray in zip(geoms, camera.rays(1)[:, 0], strict=True):
        mujoco.mj_ray(arm._model, arm._data, np.array(camera.position_m), ray, None, True, -1, met, None)
        assert geom == met[0]
    assert (geoms >= 0).all(), "the floor fills the background"


@pytest.mark.parametrize(("height", "width"), [(48, 80), (128, 128), (1, 1)])
def test_frames_come_in_other_sizes(height, width):
    arm = Arm()
    arm.set_up(Workspace(camera=Camera(height=height, width=width)))
    frame = arm.sense().frame
    assert frame.shape == (height, width, 1)
    assert frame.dtype == np.uint8


def test_a_larger_frame_shows_the_same_scene():
    small, large = Arm(), Arm()
    large.set_up(Workspace(camera=Camera(height=128, width=128)))
    shrunk = large.sense().frame.reshape(64, 2, 64, 2).mean(axis=(1, 3))
    assert np.abs(shrunk - small.sense().frame[..., 0]).mean() < 1.5


def test_left_and_far_are_where_they_belong(arm):
    """The camera faces the robot: what is to the robot's left (positive y) appears on the right."""
    camera = Camera()
    rays = camera.rays(1)[:, 0].reshape(64, 64, 3)
    assert rays[32, 63, 1] > 0 > rays[32, 0, 1]
    assert rays[0, 32, 0] < rays[63, 32, 0]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"position_m": (0.3, 0.0, 1.0), "target_m": (0.3, 0.0, 0.0)}, "target_m"),
        ({"fovy_deg": 180.0}, "fovy_deg is 180"),
        ({"height": 0}, "height 0"),
    ],
)
def test_a_camera_that_sees_nothing_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        Camera(**wrong)


# Arm


def test_the_arm_holds_still_at_home(arm):
    arm.reset(arm.home)
    arm.move(arm.home, seconds=1.0)
    assert np.abs(arm.sense().joints - arm.home).max() < 1e-3


def test_a_move_ends_where_it_was_sent(arm):
    arm.reset(arm.home)
    arm.move(arm.home + 0.2, seconds=1.0)
    arm.move(arm.home + 0.2, seconds=0.5)
    np.testing.assert_allclose(arm.sense().joints, arm.home + 0.2, atol=1e-4)
    np.testing.assert_allclose(arm.end_effector_m, forward_kinematics(arm.sense().joints), atol=1e-9)


def test_reset_leaves_nothing_of_what_was_before(arm):
    def swing():
        arm.reset(arm.home)
        arm.move(arm.home + 0.3, seconds=0.3)
        return arm.sense().joints

    first = swing()
    press(arm, x_m=0.4, depth_m=0.05, seconds=0.5)
    np.testing.assert_array_equal(swing(), first)


@pytest.mark.parametrize("x_m", [0.2, 0.4, 0.6])
@pytest.mark.parametrize("seconds", [0.5, 2.0])
def test_the_table_stops_the_hand(arm, x_m, seconds):
    assert press(arm, x_m=x_m, depth_m=0.05, seconds=seconds) > -5 * MILLIMETRE


def test_no_wild_plan_brings_the_hand_through_the_table(arm):
    for goal in random_joints(30) * [0.4, 1, 1, 1]:
        arm.reset(arm.home)
        for share in np.linspace(0.1, 1, 10):
            arm.move(arm.home + share * (goal - arm.home), seconds=0.1)
            x, y, z = arm.end_effector_m
            assert z > -5 * MILLIMETRE or not (0 < x < 0.74 and abs(y) < 0.37)


def test_the_links_never_touch_each_other(arm):
    for joints in random_joints(200):
        arm.reset(joints)
        geoms = {arm._model.geom(geom).name for pair in arm._data.contact.geom.tolist() for geom in pair}
        pairs = arm._data.contact.geom.tolist()
        assert all("table" in {arm._model.geom(geom).name for geom in pair} for pair in pairs), geoms


# Gripper, object and circles


def test_the_gripper_is_a_fifth_joint(handy):
    assert handy.joint_names == ("joint1", "joint2", "joint4", "joint6", "gripper")
    assert handy.joint_units == ("rad",) * 4 + ("m",)
    assert (handy.joint_unit, Arm().joint_unit) == (None, "rad")
    assert handy.joint_limits.shape == (5, 2)
    assert handy.velocity_limits.shape == (5,)
    np.testing.assert_allclose(forward_kinematics(handy.home[:4]), HOME_M, atol=1e-9)
    assert handy.home[4] == GRIPPER_OPEN_M
    np.testing.assert_array_equal(handy.sense().joints, handy.home)
    fingers = [handy._data.joint(name).qpos[0] for name in ("left_finger", "right_finger")]
    assert fingers == [GRIPPER_OPEN_M] * 2


def test_an_arm_gives_its_gripper_back(arm):
    other = _handy()
    other.set_up(Workspace())
    assert other.joint_names == arm.joint_names
    arm.reset(arm.home)
    np.testing.assert_array_equal(other.sense().frame, arm.sense().frame)


def test_things_lie_where_they_were_put(handy):
    ground_truth = handy.ground_truth()
    np.testing.assert_allclose(ground_truth.object_m, OBJECT_M)
    assert ground_truth.object_uprightness == 1
    assert ground_truth.gripper_m == GRIPPER_OPEN_M
    assert handy._data.body("other_circle").xpos.tolist() == [0.6, -0.1, 0]
    handy.reset(handy.home)
    assert handy._data.body("other_circle").xpos.tolist() == [0, 0, 0]


def test_what_is_not_on_the_table_is_not_placed(arm, handy):
    with pytest.raises(ValueError, match="positions_m places 'marker'; on the table are circle, other_circle, object"):
        handy.reset(handy.home, {"marker": (0, 0, 0)})
    with pytest.raises(ValueError, match="positions_m places 'object'; on the table are no things"):
        arm.reset(arm.home, {"object": (0, 0, 0)})


def test_circles_are_seen_in_their_size_and_touch_nothing(handy):
    seen = Renderer(Camera((0.5, 0.01, 3.0), (0.5, 0.0, 0.0), 30, 200, 200), handy._model)
    geoms, _ = seen._cast(handy._data, seen._middle_rays)
    pixel_m = 3.0 * 2 * np.tan(np.radians(15)) / 200
    circle = handy._model.body("other_circle").geomadr[0]
    assert (geoms == circle).sum() * pixel_m**2 == pytest.approx(np.pi * CIRCLE_RADIUS_M**2, rel=0.03)
    stand(handy, (0.3, -0.2, 0.02))
    handy.move(handy.sense().joints, 0.1)
    assert handy._data.ncon == 4, "the object on the table and nothing else"


def test_the_gripper_is_sensed_as_it_was_commanded(handy):
    """Fingers that hold the object stand at its width; the command says that they hold."""
    stand(handy, (*OBJECT_M[:2], 0.2))
    go(handy, (*OBJECT_M[:2], 0.08), GRIPPER_OPEN_M, 1.0)
    go(handy, (*OBJECT_M[:2], 0.08), 0.0, 0.8)
    assert handy.sense().joints[4] == 0
    assert handy._data.joint("left_finger").qpos[0] == pytest.approx(OBJECT_RADIUS_M, abs=MILLIMETRE)
    go(handy, (*OBJECT_M[:2], 0.2), 0.0, 1.0)
    assert handy.ground_truth().object_m[2] == pytest.approx(0.17, abs=5 * MILLIMETRE)
    assert handy.ground_truth().object_uprightness > 0.99


def test_what_is_commanded_is_told_from_what_is_reached(arm):
    """The table stops the hand, not its set points."""
    press(arm, x_m=0.4, depth_m=0.05, seconds=0.5)
    ground_truth = arm.ground_truth()
    np.testing.assert_allclose(ground_truth.commanded_m, [0.4, 0.1, -0.05], atol=1e-9)
    assert ground_truth.end_effector_m[2] > -5 * MILLIMETRE
    assert (ground_truth.gripper_m, ground_truth.object_m, ground_truth.object_uprightness) == (0.0, None, None)


def test_the_object_rests_where_it_stands(handy):
    handy.move(handy.home, 2.0)
    np.testing.assert_allclose(handy.ground_truth().object_m, OBJECT_M, atol=0.2 * MILLIMETRE)
    assert handy.ground_truth().object_uprightness > 0.9999


@pytest.mark.parametrize("height_m", [0.03, 0.09])
def test_the_hand_does_not_pass_through_the_object(handy, height_m):
    """A hand that sweeps across the object's place takes it along or throws it over: it never stands there unmoved."""
    x, y, _ = OBJECT_M
    stand(handy, (x, y - 0.2, height_m))
    go(handy, (x, y + 0.1, height_m), GRIPPER_OPEN_M, 1.5)
    assert np.linalg.norm(handy.ground_truth().object_m - OBJECT_M) > 0.03


def test_the_palm_does_not_pass_through_the_object(handy):
    """Lowered over the object with the fingers beside it, the palm stops at its top, which is 10 cm high."""
    x, y, _ = OBJECT_M
    stand(handy, (x, y, 0.2))
    go(handy, (x, y, 0.03), GRIPPER_OPEN_M, 2.0)
    assert handy.end_effector_m[2] > 0.05 or handy.ground_truth().object_uprightness < 0.9


# Workspace


def test_furnish_builds_only_what_changed(arm):
    model = arm._model
    arm.set_up(Workspace())
    assert arm._model is model
    other = Arm()
    other.set_up(Workspace(table_size_m=1.0))
    assert other._model.geom("table").size.tolist() == pytest.approx([0.5, 0.5, 0.02])
    np.testing.assert_array_equal(other.sense().joints, other.home)


@pytest.mark.parametrize("verb", ["reset", "move"])
@pytest.mark.parametrize(
    ("joints", "message"),
    [
        ([0.0] * 5, r"joints has 5 angles, the arm has 4 joints \(joint1, joint2, joint4, joint6\)"),
        (np.zeros((2, 4)), r"joints has shape \(2, 4\), the arm has 4 joints"),
        ([0.0, np.nan, 0.0, 0.0], "joints holds a value that is not finite at joint2"),
        ([0.0, 0.0, 0.0, np.inf], "joints holds a value that is not finite at joint6"),
    ],
)
def test_wrong_joints_are_refused(arm, verb, joints, message):
    with pytest.raises(ValueError, match=message):
        arm.reset(joints) if verb == "reset" else arm.move(joints, seconds=0.1)


def test_a_move_in_no_time_is_refused(arm):
    with pytest.raises(ValueError, match="seconds is 0"):
        arm.move(arm.home, seconds=0)
