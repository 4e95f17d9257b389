"""The policy: at the first observation it imagines the way to the goal, then it plays that way, one action a call."""

import logging
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import OBS_STATE
from torch import Tensor

from lerobot_policy_preimage.configuration_preimage import PreimageConfig
from preimage.data.angles import unwrapped
from preimage.data.sources import find_percept
from preimage.data.view import look, unwraps
from preimage.presets import PlanOptions, load_planner
from preimage.records import GoalRefused, Percept
from preimage.robot.limits import commands_of, limits_seen
from preimage.storage.runs import find_run, read_body, read_shown, read_view

Batch = dict[str, Any]


@dataclass
class Playing:
    """A plan, and how much of it has been played."""

    goal: np.ndarray
    """Frame (H, W, C) that was planned to."""
    actions: np.ndarray
    """All joints (S, A), one row a call; the last one holds."""
    imagined: np.ndarray
    """Frames (S, H, W, C) that go with them."""
    played: int = 0

    def next(self) -> np.ndarray:
        self.played += 1
        return self.actions[min(self.played, len(self.actions)) - 1]


def options_of(config: PreimageConfig) -> PlanOptions:
    """The preset, with what was asked for in place of its own."""
    asked = {"iterations": config.iterations, "restarts": config.restarts, "precision": config.precision}
    return replace(PlanOptions.of(config.preset), **{name: value for name, value in asked.items() if value is not None})


class PreimagePolicy(PreTrainedPolicy):
    """Plans by error regression, once for each goal, and again after `reset`.

    Raises:
        ValueError: there is no such run or goal, or an observation does not fit the run.
    """

    config_class = PreimageConfig
    name = "preimage"
    config: PreimageConfig

    def __init__(self, config: PreimageConfig, **_: Any) -> None:
        super().__init__(config)
        config.validate_features()
        folder = find_run(config.run)  # once, so that all parts of a run on the Hub are of one revision
        self.planner, self.view, self.body = load_planner(folder, options_of(config)), read_view(folder), read_body(folder)
        self.model = self.planner.model
        self.limits = limits_seen(self.model.sensors, read_shown(folder), unit=self.body.joint_unit)
        self.known = [self.body.joint_names.index(name) for name in self.model.sensors.joint_names]
        found = find_percept(config.goal, self.model.sensors, view=self.view, default_step=-1) if config.goal else None
        self.goal = found.percept.frame if found else None
        self.reset()

    def reset(self) -> None:
        """Forget the plans: the next observation is a start."""
        self.playing: list[Playing | None] = []
        self.last_predicted_latents: Tensor | None = None

    def select_action(self, batch: Batch, **_: Any) -> Tensor:
        """The next joints (B, A), in the unit of the recordings that the run learned from."""
        state = batch[OBS_STATE]
        if len(self.playing) != len(state):
            self.playing = [None] * len(state)
        for row, former in enumerate(self.playing):
            goal = self.goal_of(batch, row)
            if former is None or not np.array_equal(former.goal, goal):
                self.playing[row] = now = self.imagine(batch, row, goal)
                if row == 0:
                    self.last_predicted_latents = torch.from_numpy(now.imagined).permute(3, 0, 1, 2)[None]  # (1, C, T, H, W)
        return torch.as_tensor(np.stack([one.next() for one in self.playing if one]), dtype=torch.float32, device=state.device)

    def predict_action_chunk(self, batch: Batch, **_: Any) -> Tensor:
        """The whole way (B, S, A) from the present observation, every row planned anew; the shorter ones hold their last joints."""
        ways = [self.imagine(batch, row, self.goal_of(batch, row)).actions for row in range(len(batch[OBS_STATE]))]
        longest = max(map(len, ways))
        padded = [np.concatenate([way, np.repeat(way[-1:], longest - len(way), axis=0)]) for way in ways]
        return torch.as_tensor(np.stack(padded), dtype=torch.float32, device=batch[OBS_STATE].device)

    def decode_predicted_latents(self, latents: Tensor) -> Tensor:
        """The imagined film (T, H, W, 3), 8 bits, as `lerobot-eval` writes it."""
        film = latents[0].permute(1, 2, 3, 0)[..., :3]  # (T, H, W, C)
        return film.expand(*film.shape[:3], 3) if film.shape[-1] == 1 else film

    def imagine(self, batch: Batch, row: int, goal: np.ndarray) -> Playing:
        """Plan from an observation to a goal frame, in actions at the rate of the calls."""
        state = batch[OBS_STATE][row].double().cpu().numpy()
        if len(state) != len(self.body.joint_names):
            names = ", ".join(self.body.joint_names)
            raise ValueError(f"{OBS_STATE} has {len(state)} joints, the run's recordings have {len(self.body.joint_names)}: give {names}")
        joints = unwrapped(state[None, self.known], self.model.sensors.joint_names, unwraps(self.view))[0]
        start = Percept(self.frame_of(batch, self.camera_in(batch), row), joints)
        with torch.inference_mode(False), torch.enable_grad():  # LeRobot calls in inference mode, in which nothing can be regressed
            found = self.planner.plan(start=start, goal=Percept(frame=goal))
        if found.trust and found.trust.refused and not self.config.anyway:
            logging.warning("%s", GoalRefused.by(found.trust, "the arm is held; --policy.anyway moves it all the same"))
            return Playing(goal, state[None], found.start.frame[None])
        commands, _ = commands_of(found, self.limits)
        last = len(commands) - 1
        calls = np.arange(1, int(np.ceil(last * self.config.fps / found.rate_hz)) + 1)
        steps = np.minimum(calls * found.rate_hz / self.config.fps, last) if last else np.zeros(1)
        actions = np.tile(state, (len(steps), 1))  # joints that the run does not move stay where they stand
        actions[:, self.known] = np.stack([np.interp(steps, np.arange(last + 1), way) for way in commands.T], axis=-1)
        frames = found.frames[np.minimum(steps.round().astype(int), found.arrival_step)]
        return Playing(goal, actions, frames)

    def goal_of(self, batch: Batch, row: int) -> np.ndarray:
        if self.goal is not None:
            return self.goal
        if self.config.goal_key not in batch:
            raise ValueError(f"there is no goal: give --policy.goal, or an observation with {self.config.goal_key}")
        return self.frame_of(batch, self.config.goal_key, row)

    def camera_in(self, batch: Batch) -> str:
        if self.config.camera:
            return self.config.camera
        cameras = [key for key in batch if key.startswith("observation.image") and key != self.config.goal_key]
        recorded = self.view.camera
        named = [key for key in cameras if recorded and key in (recorded, f"observation.images.{recorded}")]
        if len(named or cameras) != 1:
            wanted = f", and none is {recorded}, which the run was recorded with" if recorded else ""
            raise ValueError(f"the observation has the cameras {', '.join(cameras) or 'none'}{wanted}: name one by --policy.camera")
        return (named or cameras)[0]

    def frame_of(self, batch: Batch, key: str, row: int) -> np.ndarray:
        """A picture (B, C, H, W) of 0 to 1 as the run sees it: 8 bits (H, W, C), cropped, scaled and in its colours."""
        picture = (255 * batch[key][row].float()).round().clamp(0, 255).to(torch.uint8).permute(1, 2, 0)
        return np.array(look(picture.cpu().numpy(), self.view, key))

    def get_optim_params(self) -> dict[str, Any]:
        return {"params": self.parameters()}

    def forward(self, batch: Batch) -> tuple[Tensor, dict[str, Any] | None]:
        raise NotImplementedError("lerobot-train does not train this policy: train by `preimage train` and give the run by --policy.run")
