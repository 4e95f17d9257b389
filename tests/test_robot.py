"""The robot: kinematics, camera, arm, the task of reaching and its tutor."""

import mujoco
import numpy as np
import pytest

from preimage.robot import TASKS, Arm, Camera, Furniture, Reach, forward_kinematics, inverse_kinematics, record, show
from preimage.robot.camera import Renderer
from preimage.robot.hand import MAX_STEPS, MIN_STEPS
from preimage.robot.kinematics import PITCHES_DEG, reaching_joints
from preimage.robot.tasks import MARGIN_M, reachable_share

COUNT = 4
MILLIMETRE = 1e-3


@pytest.fixture(scope="module")
def arm():
    return Arm()


@pytest.fixture(scope="module")
def demonstrations(arm):
    return record(arm, Reach(), count=COUNT, seed=0)


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


def test_constants_agree_with_the_model(arm):
    limits = [arm._model.joint(name).range for name in arm.joint_names]
    np.testing.assert_array_equal(arm.joint_limits, limits)
    assert arm.velocity_limits.shape == (len(arm.joint_names),)


# Camera


def test_frame_depends_on_the_state_alone(arm, demonstrations):
    first, second = demonstrations[0].joints[[0, -1]]
    arm.reset(first)
    before = arm.sense().frame
    arm.reset(second)
    assert not np.array_equal(arm.sense().frame, before)
    arm.reset(first)
    np.testing.assert_array_equal(arm.sense().frame, before)
    np.testing.assert_array_equal(arm.sense().frame, before)


def test_every_ray_meets_what_mujocos_single_ray_meets(arm):
    arm.reset(arm.home)
    camera = Camera(height=32, width=32)
    geoms, _, _ = Renderer(camera, arm._model)._meet(arm._data, np.array(camera.position_m), camera.rays(1)[:, 0])
    met = np.empty(1, np.int32)
    for geom, ray in zip(geoms, camera.rays(1)[:, 0], strict=True):
        mujoco.mj_ray(arm._model, arm._data, np.array(camera.position_m), ray, None, True, -1, met, None)
        assert geom == met[0]
    assert (geoms >= 0).all(), "the floor fills the background"


@pytest.mark.parametrize(("height", "width"), [(48, 80), (128, 128), (1, 1)])
def test_frames_come_in_other_sizes(height, width):
    arm = Arm()
    arm.furnish(Furniture(camera=Camera(height=height, width=width)))
    frame = arm.sense().frame
    assert frame.shape == (height, width, 1)
    assert frame.dtype == np.uint8


def test_a_larger_frame_shows_the_same_scene():
    small, large = Arm(), Arm()
    large.furnish(Furniture(camera=Camera(height=128, width=128)))
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


def test_furnish_builds_only_what_changed(arm):
    model = arm._model
    arm.furnish(Furniture())
    assert arm._model is model
    other = Arm()
    other.furnish(Furniture(table_size_m=1.0))
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


# Task and tutor: the contract every task fulfils


@pytest.fixture(params=sorted(TASKS))
def task(request):
    return TASKS[request.param]


def test_tasks_are_called_by_their_names():
    assert {name: task.name for name, task in TASKS.items()} == {name: name for name in TASKS}


def test_same_seed_same_demonstration_whatever_the_count(arm, task):
    for index, (one, other) in enumerate(zip(record(arm, task, count=1, seed=3), record(Arm(), task, count=2, seed=3), strict=False)):
        np.testing.assert_array_equal(one.frames, other.frames, err_msg=f"demonstration {index}")
        np.testing.assert_array_equal(one.joints, other.joints)
        assert one.scene == other.scene


def test_scenes_differ_within_and_between_seeds(arm, task):
    streams = [np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,))) for seed in (0, 1) for index in (0, 1)]
    assert len({str(task.sample(rng)) for rng in streams}) == 4


def test_demonstrations_are_finite_whole_and_unshared(arm, demonstrations):
    for demonstration in demonstrations:
        assert MIN_STEPS <= len(demonstration) <= MAX_STEPS
        assert demonstration.frames.dtype == np.uint8
        assert demonstration.joints.dtype == np.float64
        assert np.isfinite(demonstration.joints).all()
        assert demonstration.frames[0].std() > 0
    percepts = [arm.sense(), arm.sense()]
    untouched = percepts[1].frame.copy()
    percepts[0].frame[:] = 0
    percepts[0].joints[:] = 0
    np.testing.assert_array_equal(percepts[1].frame, untouched)
    assert np.abs(percepts[1].joints).max() > 0
    assert np.abs(arm.sense().joints).max() > 0


def test_the_tutor_succeeds_and_so_does_who_repeats_its_joints(arm, task, demonstrations):
    for demonstration in demonstrations:
        task.lay_out(arm, demonstration.scene)
        assert not task.judge(arm, demonstration.scene).success, "solved before it began"
        for joints in demonstration.joints[1:]:
            arm.move(joints, seconds=1 / task.rate_hz)
        judgement = task.judge(arm, demonstration.scene)
        assert judgement.success
        assert judgement.deviation_m < 0.1 * MILLIMETRE


def test_the_tutor_stays_within_every_limit_and_touches_nothing(arm, demonstrations):
    lower, upper = arm.joint_limits.T
    for demonstration in demonstrations:
        assert ((demonstration.joints >= lower) & (demonstration.joints <= upper)).all()
        speeds = np.abs(np.diff(demonstration.joints, axis=0)) * demonstration.rate_hz
        assert (speeds <= arm.velocity_limits).all()
        for joints in demonstration.joints:
            arm.reset(joints)
            assert arm._data.ncon == 0


def test_show_starts_where_the_scene_says(arm, task):
    rng = np.random.default_rng(5)
    scene = task.sample(rng)
    demonstration = show(arm, task, scene, rng)
    np.testing.assert_array_equal(demonstration.joints[0], scene.start_joints)
    assert demonstration.scene is scene
    assert demonstration.joint_names == arm.joint_names
    assert demonstration.rate_hz == task.rate_hz


def test_record_tells_its_progress(arm):
    told = []
    record(arm, Reach(), count=2, seed=0, progress=lambda done, count: told.append((done, count)))
    assert told == [(1, 2), (2, 2)]


@pytest.mark.parametrize(("count", "seed", "message"), [(0, 0, "count is 0"), (1, -1, "seed is -1")])
def test_record_refuses_too_small_numbers(arm, count, seed, message):
    with pytest.raises(ValueError, match=message):
        record(arm, Reach(), count=count, seed=seed)


# Reaching


def test_goals_lie_on_the_table_and_not_where_the_arm_already_is():
    rng, task = np.random.default_rng(0), Reach()
    scenes = [task.sample(rng) for _ in range(300)]
    goals = np.array([scene.positions_m["goal"] for scene in scenes])
    starts = forward_kinematics(np.array([scene.start_joints for scene in scenes]))
    assert (np.linalg.norm(goals - starts, axis=1) > 0.1).all()
    assert (np.abs(goals - [0.37, 0, 0.03]) <= [0.37 - MARGIN_M, 0.37 - MARGIN_M, 0]).all()
    assert np.ptp(goals[:, 0]) > 0.65
    assert np.ptp(goals[:, 1]) > 0.65


def test_nearly_the_whole_table_is_in_reach():
    assert reachable_share(Reach()) == pytest.approx(0.989, abs=0.002)


def test_a_goal_out_of_reach_is_refused(arm):
    scene = Reach().sample(np.random.default_rng(0))
    far = type(scene)(scene.task, scene.start_joints, {"goal": (2.0, 0.0, 0.03)})
    with pytest.raises(ValueError, match=r"goal at \(2.0, 0.0, 0.03\) m is out of reach"):
        Reach().hand_path(np.random.default_rng(0), far)


def test_golden_demonstration(demonstrations):
    """Numbers that move when anything in the making of demonstrations does; print them to renew them."""
    first = demonstrations[0]
    assert len(first) == 59
    assert first.joints.mean() == pytest.approx(-0.0292781, abs=1e-6)
    assert first.frames.mean() == pytest.approx(104.045, abs=1e-2)
