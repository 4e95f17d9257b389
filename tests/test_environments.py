"""The tasks as Gymnasium environments: checked by Gymnasium's own checker, solved by the demonstrator, not solved by passing through."""

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402

from preimage.robot import TASKS, Arm, record  # noqa: E402
from preimage.robot.gym import name_of  # noqa: E402

NAMES = [name_of(task) for task in TASKS]


@pytest.fixture(params=NAMES)
def environment(request):
    made = gymnasium.make(request.param)
    yield made
    made.close()


def test_names_are_those_of_the_paper():
    assert sorted(NAMES) == ["preimage/MoveObject-v0", "preimage/Reach-v0", "preimage/TwoCircles-v0", "preimage/TwoPoints-v0"]


@pytest.mark.filterwarnings("ignore:.*symmetric and normalized space:UserWarning")
@pytest.mark.parametrize("name", NAMES)
def test_gymnasium_finds_nothing_wrong(name):
    check_env(gymnasium.make(name, render_mode="rgb_array").unwrapped)


def shown_in(environment):
    """The demonstration from which the environment took its scene and its goal."""
    return environment.unwrapped._shown


def test_the_tutors_joints_solve_the_scene(environment):
    seen, _ = environment.reset(seed=3)
    shown = shown_in(environment)
    np.testing.assert_array_equal(seen["goal"], shown.frames[-1])
    np.testing.assert_array_equal(seen["frame"], shown.frames[0])
    np.testing.assert_allclose(seen["joints"], shown.joints[0])
    rewards, terminated = [], False
    for joints in [*shown.joints[1:], *[shown.joints[-1]] * 10]:
        _, reward, terminated, truncated, info = environment.step(joints)
        rewards.append(reward)
        assert not truncated
        if terminated:
            break
    assert terminated
    assert info["success"]
    assert rewards == [0] * (len(rewards) - 1) + [1]


def test_staying_solves_nothing_and_is_cut_off(environment):
    seen, _ = environment.reset(seed=4)
    outcomes = []
    while not outcomes or not outcomes[-1][-1]:
        outcomes.append(environment.step(seen["joints"])[1:4])
    assert len(outcomes) == environment.spec.max_episode_steps
    assert {outcome[:2] for outcome in outcomes} == {(0, False)}


def test_the_same_seed_gives_the_same_scene_and_another_another(environment):
    first, again, other = (environment.reset(seed=seed)[0]["goal"] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_a_goal_that_is_passed_through_is_not_reached():
    environment = gymnasium.make("preimage/Reach-v0")
    environment.reset(seed=0)
    shown = shown_in(environment)
    aside = np.array([0.6, 0, 0, 0])
    sweep = shown.joints[-1] + np.linspace(1, -1, 25)[:, None] * aside  # 3 cm a step, by turning about the base
    successes = []
    for joints in [*(shown.joints[1:] + aside), *sweep]:
        _, reward, terminated, _, info = environment.step(joints)
        successes.append(info["success"])
        assert (reward, terminated) == (0, False)
    assert any(successes)
    assert not successes[-1]


def test_the_arm_goes_no_faster_than_it_can():
    environment = gymnasium.make("preimage/Reach-v0")
    seen, _ = environment.reset(seed=0)
    arm = Arm()
    after, *_ = environment.step(np.clip(seen["joints"] + 1, environment.action_space.low, environment.action_space.high))
    assert (np.abs(after["joints"] - seen["joints"]) <= arm.velocity_limits / 10 + 0.01).all()


@pytest.mark.parametrize("action", [np.zeros(3), np.full(4, np.nan)])
def test_an_action_that_is_off_is_told(action):
    environment = gymnasium.make("preimage/Reach-v0", disable_env_checker=True)
    environment.reset(seed=0)
    with pytest.raises(ValueError, match=r"action is .*: give 4 finite joint angles"):
        environment.step(action)


def test_what_is_seen_can_be_recorded_and_trained_on(environment):
    """Frames, joints and goal are those of a demonstration of the same task."""
    seen, _ = environment.reset(seed=0)
    name = next(task for task in TASKS if name_of(task) == environment.spec.id)
    (demonstration,) = record(Arm(), TASKS[name], count=1, seed=0)
    assert seen["frame"].shape == seen["goal"].shape == demonstration.frames.shape[1:]
    assert seen["joints"].shape == demonstration.joints.shape[1:]


def test_spaces_are_of_single_precision_and_hold_what_is_seen(environment):
    seen, info = environment.reset(seed=2)
    assert environment.observation_space.contains(seen)
    assert {seen[name].dtype for name in ("joints", "observation", "achieved_goal", "desired_goal")} == {np.dtype(np.float32)}
    assert environment.action_space.dtype == np.float32
    assert info["is_success"] is False


def test_the_reward_can_be_computed_again_for_any_goal(environment):
    """Hindsight experience replay: of the same goal as it was given, of the goal that was achieved a success where the rest is done."""
    environment.reset(seed=3)
    shown = shown_in(environment)
    rows = []
    for joints in [*shown.joints[1:], *[shown.joints[-1]] * 10]:
        seen, reward, terminated, _, info = environment.step(joints)
        rows.append((seen["achieved_goal"], seen["desired_goal"], reward, info))
        assert info["is_success"] == terminated
        if terminated:
            break
    achieved, desired, rewards, infos = (list(each) for each in zip(*rows, strict=True))
    compute_reward = environment.unwrapped.compute_reward
    assert compute_reward(np.stack(achieved), np.stack(desired), infos).tolist() == rewards
    hindsight = [compute_reward(one, one, info) for one, info in zip(achieved, infos, strict=True)]
    assert hindsight == [float(info["conditions_met"]) for info in infos]
    assert hindsight[-1] == 1
    fastest = 1 + np.linalg.norm(np.diff(achieved, axis=0), axis=1).argmax()
    assert hindsight[fastest] == 0  # it moves


def test_what_is_rendered_is_the_frame_in_three_equal_channels():
    environment = gymnasium.make("preimage/Reach-v0", render_mode="rgb_array")
    with pytest.raises(ValueError, match="call reset before render"):
        environment.unwrapped.render()
    seen, _ = environment.reset(seed=0)
    np.testing.assert_array_equal(environment.render(), np.repeat(seen["frame"], 3, axis=-1))
