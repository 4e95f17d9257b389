"""The policy as LeRobot calls it: found by its name, in inference mode, in batches. Runs where lerobot can be installed."""

import numpy as np
import pytest
import torch

pytest.importorskip("lerobot")

from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.utils.constants import OBS_STATE
from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_policy_preimage import PreimageConfig, PreimagePolicy
from lerobot_policy_preimage.modeling_preimage import options_of
from preimage.ideas.replanning import Replanner
from preimage.ideas.trust import Assessment
from preimage.network.inputs import home
from preimage.presets import Planner, PlanOptions
from preimage.records import Percept, Trust
from preimage.storage.networks import load_model
from preimage.storage.runs import find_run, read_shown

CAMERA, GOAL = "observation.images.camera", "observation.images.goal"


def settings(**more) -> PreimageConfig:
    """Two calls a step of the run; the robots of these tests do not move, so that most of them had better not look."""
    return PreimageConfig(run="reach", device="cpu", fps=5.0, iterations=1, **{"n_action_steps": 0} | more)


def pictures(frames) -> torch.Tensor:
    """As LeRobot has them: (B, C, H, W), 0 to 1."""
    return torch.from_numpy(np.stack(frames)).permute(0, 3, 1, 2).float() / 255


@pytest.fixture(scope="module")
def goals() -> list[np.ndarray]:
    return [shown.last_frame for shown in read_shown(find_run("reach"))[:2]]


@pytest.fixture
def observation(goals) -> dict:
    """Two robots at home, each with a goal of its own."""
    start = home(load_model("reach"))
    states = torch.from_numpy(np.stack([start.joints, start.joints]))
    return {OBS_STATE: states, CAMERA: pictures([start.frame, start.frame]), GOAL: pictures(goals)}


@pytest.fixture
def planned(monkeypatch) -> list[Percept]:
    """The goals that were planned to, one for every plan."""
    seen: list[Percept] = []

    def plan(planner, **asked):
        seen.append(asked["goal"])
        return original(planner, **asked)

    original = Planner.plan
    monkeypatch.setattr(Planner, "plan", plan)
    return seen


def act(policy: PreimagePolicy, observation: dict) -> torch.Tensor:
    with torch.inference_mode():
        return policy.select_action(observation)


def test_lerobot_finds_the_policy_and_its_processors_by_name(observation):
    register_third_party_plugins()
    assert get_policy_class("preimage") is PreimagePolicy
    assert PreTrainedConfig.get_choice_class("preimage") is PreimageConfig
    before, after = make_pre_post_processors(settings())
    assert torch.equal(before(observation)[CAMERA], observation[CAMERA])
    assert torch.equal(after(torch.ones(2, 4)), torch.ones(2, 4))


def test_a_way_is_planned_once_and_played_to_its_end(observation, planned):
    policy = PreimagePolicy(settings())
    ways = policy.predict_action_chunk(observation)
    assert len(planned) == 2
    actions = torch.stack([act(policy, observation) for _ in range(ways.shape[1] + 3)], dim=1)
    assert len(planned) == 4
    torch.testing.assert_close(actions[:, : ways.shape[1]], ways)
    torch.testing.assert_close(actions[:, -1], ways[:, -1])  # then it stays
    assert (actions[:, 0] - observation[OBS_STATE]).abs().max() < (actions[:, -1] - observation[OBS_STATE]).abs().max()
    assert not torch.allclose(actions[0, -1], actions[1, -1])  # two goals, two ends


@pytest.mark.parametrize("anyway", [False, True])
def test_the_arm_is_held_where_the_goal_is_refused(observation, monkeypatch, caplog, anyway):
    refused = Trust(0.01, True, ("the goal is off what was demonstrated",), "calibrated by 60 goals")
    monkeypatch.setattr(Assessment, "__call__", lambda self, plan: refused)
    policy = PreimagePolicy(settings(anyway=anyway))
    way = policy.predict_action_chunk(observation)
    assert (way.shape[1] == 1) != anyway
    assert torch.equal(way[:, -1], observation[OBS_STATE].float()) != anyway
    assert ("the goal is refused: the goal is off what was demonstrated" in caplog.text) != anyway


@pytest.mark.parametrize(("n_action_steps", "calls_a_look"), [(1, 2), (2, 2), (4, 4), (0, 99)])
def test_it_looks_as_often_as_is_said_and_not_between_steps(observation, monkeypatch, n_action_steps, calls_a_look):
    looks, original = [], Replanner.__call__
    monkeypatch.setattr(Replanner, "__call__", lambda self, percept, **how: looks.append(1) or original(self, percept, **how))
    policy = PreimagePolicy(settings(n_action_steps=n_action_steps))
    for call in range(5):
        act(policy, observation)
        assert len(looks) == 2 * (1 + call // calls_a_look)  # two robots


def test_an_arm_that_sees_what_it_does_not_believe_is_held(observation, caplog):
    policy = PreimagePolicy(settings(n_action_steps=1))
    first = act(policy, observation)
    assert (first - observation[OBS_STATE]).abs().max() > 0
    elsewhere = observation | {CAMERA: 1 - observation[CAMERA]}
    actions = [act(policy, elsewhere) for _ in range(12)]
    assert "what is sensed is not what is imagined" in caplog.text
    torch.testing.assert_close(actions[-1], observation[OBS_STATE].float())


def test_a_refused_goal_holds_the_arm_from_the_first_action_on(observation, monkeypatch, caplog):
    refused = Trust(0.01, True, ("the goal is off what was demonstrated",), "calibrated by 60 goals")
    monkeypatch.setattr(Assessment, "__call__", lambda self, plan: refused)
    policy = PreimagePolicy(settings(n_action_steps=1))
    for _ in range(5):
        torch.testing.assert_close(act(policy, observation), observation[OBS_STATE].float())
    assert "the goal is refused: the goal is off what was demonstrated" in caplog.text


def test_it_plans_again_after_a_reset_and_for_another_goal(observation, planned, goals):
    policy = PreimagePolicy(settings())
    for _ in range(2):
        act(policy, observation)
    assert len(planned) == 2
    act(policy, observation | {GOAL: pictures([goals[0], goals[0]])})
    assert len(planned) == 3  # the first robot's goal is what it was
    policy.reset()
    act(policy, observation)
    assert len(planned) == 5


def test_the_imagined_video_is_left_where_lerobot_looks(observation):
    policy = PreimagePolicy(settings())
    act(policy, observation)
    latents = policy.last_predicted_latents
    assert latents is not None
    film = policy.decode_predicted_latents(torch.cat([latents, latents], dim=2))
    assert film.dtype == torch.uint8
    assert film.shape[1:] == (64, 64, 3)
    assert len(film) == 2 * latents.shape[2]


def test_the_goal_may_be_a_file(observation, goals, tmp_path, planned):
    from PIL import Image

    Image.fromarray(goals[0][..., 0]).save(tmp_path / "goal.png")
    policy = PreimagePolicy(settings(goal=str(tmp_path / "goal.png")))
    act(policy, {key: value for key, value in observation.items() if key != GOAL})
    assert np.array_equal(planned[0].frame, goals[0])


def test_a_saved_policy_comes_back(observation, tmp_path):
    policy = PreimagePolicy(settings())
    policy.save_pretrained(tmp_path)
    again = PreimagePolicy.from_pretrained(tmp_path)
    torch.testing.assert_close(act(again, observation), act(policy, observation))


@pytest.mark.parametrize(
    ("left_out", "sentence"),
    [(GOAL, "there is no goal: give --policy.goal"), (CAMERA, "has the cameras none: name one by --policy.camera")],
)
def test_what_is_missing_is_named(observation, left_out, sentence):
    with pytest.raises(ValueError, match=sentence):
        act(PreimagePolicy(settings()), {key: value for key, value in observation.items() if key != left_out})


def test_other_joints_are_refused(observation):
    with pytest.raises(ValueError, match="has 3 joints, the run's recordings have 4"):
        act(PreimagePolicy(settings()), observation | {OBS_STATE: observation[OBS_STATE][:, :3]})


def test_without_a_run_nothing_is_planned():
    with pytest.raises(ValueError, match=r"give --policy\.run"):
        PreimagePolicy(PreimageConfig(device="cpu"))


def test_a_precision_that_does_not_exist_is_refused():
    with pytest.raises(ValueError, match=r"--policy\.precision is float8: give auto, bfloat16, float32"):
        PreimagePolicy(settings(precision="float8"))


def test_plans_are_searched_for_as_the_preset_says():
    assert options_of(PreimageConfig(run="reach", device="cpu")) == PlanOptions.full()
    paper = PreimagePolicy(PreimageConfig(run="reach", device="cpu", preset="paper", iterations=0, precision="float32"))
    assert (paper.planner.memory, paper.planner.options) == (None, PlanOptions(iterations=0, precision="float32"))
    with pytest.raises(ValueError, match=r"--policy\.preset is best: give paper, regression, full"):
        PreimagePolicy(settings(preset="best"))
