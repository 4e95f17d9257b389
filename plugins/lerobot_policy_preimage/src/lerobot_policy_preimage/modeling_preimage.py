"""The policy: at the first observation it imagines the way to the goal, and goes it, one action a call, with eyes open.

Every so many calls it looks: what is sensed then is explained, and the rest of the way planned anew (`preimage.Replanner`). In between it
goes straight from each imagined step to the next.
"""

import logging
from dataclasses import dataclass, field, replace
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
from preimage.records import GoalRefused, Percept, Plan
from preimage.robot.limits import Limiter, limits_seen
from preimage.storage.runs import find_run, read_body, read_shown, read_view

Batch = dict[str, Any]


@dataclass
class Going:
    """A plan that is gone, and the actions up to the next look."""

    goal: np.ndarray
    """Frame (H, W, C) that was planned to."""
    replanner: Any
    limiter: Limiter
    """Of the joints that the run moves, at the rate of the calls."""
    wanted: np.ndarray
    """Joints (J) to be in when the actions are used up."""
    actions: list[np.ndarray] = field(default_factory=list)
    """Joints (J), one row a call."""
    num_steps: int = 0
    """Of the model, to the next look."""
    is_over: bool = False
    """Whether it looks no more."""


def options_of(config: PreimageConfig) -> PlanOptions:
    """The preset, with what was asked for in place of its own."""
    asked = {"iterations": config.iterations, "precision": config.precision}
    return replace(PlanOptions.of(config.preset), **{name: value for name, value in asked.items() if value is not None})


class PreimagePolicy(PreTrainedPolicy):
    """Plans by error regression, for each goal and after `reset`, and replans on the way.

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
        self.going: list[Going | None] = []
        self.last_predicted_latents: Tensor | None = None

    def select_action(self, batch: Batch, **_: Any) -> Tensor:
        """The next joints (B, A), in the unit of the recordings that the run learned from."""
        state = batch[OBS_STATE]
        if len(self.going) != len(state):
            self.going = [None] * len(state)
        actions = []
        for row, former in enumerate(self.going):
            goal = self.goal_of(batch, row)
            going = former if former is not None and np.array_equal(former.goal, goal) else self.set_out(batch, row, goal)
            self.going[row] = going
            if not going.actions:
                self.look(going, batch, row)
            actions.append(self.with_others(batch, row, going.actions.pop(0)))
        return torch.as_tensor(np.stack(actions), dtype=torch.float32, device=state.device)

    def predict_action_chunk(self, batch: Batch, **_: Any) -> Tensor:
        """The whole way (B, S, A) from the present observation, every row planned anew; the shorter ones hold their last joints."""
        ways = [self.way_of(batch, row, self.goal_of(batch, row)) for row in range(len(batch[OBS_STATE]))]
        longest = max(map(len, ways))
        padded = [np.concatenate([way, np.repeat(way[-1:], longest - len(way), axis=0)]) for way in ways]
        return torch.as_tensor(np.stack(padded), dtype=torch.float32, device=batch[OBS_STATE].device)

    def decode_predicted_latents(self, latents: Tensor) -> Tensor:
        """The imagined film (T, H, W, 3), 8 bits, as `lerobot-eval` writes it."""
        film = latents[0].permute(1, 2, 3, 0)[..., :3]  # (T, H, W, C)
        return film.expand(*film.shape[:3], 3) if film.shape[-1] == 1 else film

    def set_out(self, batch: Batch, row: int, goal: np.ndarray) -> Going:
        """Plan from an observation to a goal frame."""
        start = self.percept_of(batch, row)
        found = self.plan_to(start, goal)
        if row == 0:
            frames = found.frames[: found.arrival_step + 1][self.steps_of_calls(found.arrival_step).round().astype(int)]
            self.last_predicted_latents = torch.from_numpy(frames).permute(3, 0, 1, 2)[None]  # (1, C, T, H, W)
        replanner = self.planner.replanner(goals=[found.goal], found=found, refuse=self.refusal)
        assert start.joints is not None
        return Going(goal, replanner, Limiter(self.limits, start.joints, 1 / self.config.fps), start.joints)

    def look(self, going: Going, batch: Batch, row: int) -> None:
        """Plan the rest of the way anew from what is sensed, and say how to go on up to the next look."""
        if going.is_over:
            going.actions = [going.limiter.catch_up()]
            return
        with torch.inference_mode(False):
            belief = going.replanner(self.percept_of(batch, row), num_steps=max(1, going.num_steps))
        if belief.held:
            logging.warning("%s", belief.held)
        imagined, blind = going.replanner.imagined, self.config.n_action_steps == 0
        asked = belief.steps_left if blind else round(self.config.n_action_steps * self.model.config.rate_hz / self.config.fps)
        going.num_steps = max(1, min(asked, belief.steps_left))
        ahead = imagined.joints[np.minimum(imagined.at + 1 + np.arange(going.num_steps), imagined.arrival)]
        way = np.vstack([going.wanted, ahead + belief.command - ahead[0]])
        if belief.held:
            way = belief.command[None].repeat(2, axis=0)
        going.is_over, going.wanted = belief.done or blind, way[-1]
        going.actions = [going.limiter.follow(joints) for joints in self.at_calls(way)]

    def way_of(self, batch: Batch, row: int, goal: np.ndarray) -> np.ndarray:
        """All actions (S, A) of a plan from an observation, gone blind; the observed joints where the goal is refused."""
        start = self.percept_of(batch, row)
        found = self.plan_to(start, goal)
        assert start.joints is not None
        if refusal := self.refusal(found):
            logging.warning("%s", refusal)
            return self.with_others(batch, row, start.joints)[None]
        limiter = Limiter(self.limits, start.joints, 1 / self.config.fps)
        actions = [limiter.follow(joints) for joints in self.at_calls(np.vstack([start.joints, found.joints[1 : found.arrival_step + 1]]))]
        limiter.validate_added_steps()
        while not limiter.has_arrived:
            actions.append(limiter.catch_up())
        return np.stack([self.with_others(batch, row, joints) for joints in actions])

    def plan_to(self, start: Percept, goal: np.ndarray) -> Plan:
        with torch.inference_mode(False), torch.enable_grad():  # LeRobot calls in inference mode, in which nothing can be regressed
            return self.planner.plan(start=start, goal=Percept(frame=goal))

    def refusal(self, plan: Plan) -> str | None:
        """Why the arm is held before it has moved, if it is."""
        if not (plan.trust and plan.trust.refused) or self.config.anyway:
            return None
        return str(GoalRefused.by(plan.trust, "the arm is held; --policy.anyway moves it all the same"))

    def at_calls(self, way: np.ndarray) -> np.ndarray:
        """Where to be at each call (S, J) along steps of the model (T, J), the first of which is left."""
        calls = self.steps_of_calls(len(way) - 1)
        return np.stack([np.interp(calls, np.arange(len(way)), joints) for joints in way.T], axis=-1)

    def steps_of_calls(self, num_steps: int) -> np.ndarray:
        """At which of the model's steps each call is, one or more, the last of them at the end."""
        num_calls = max(1, int(np.ceil(num_steps * self.config.fps / self.model.config.rate_hz - 1e-9)))
        return np.minimum(np.arange(1, num_calls + 1) * self.model.config.rate_hz / self.config.fps, num_steps)

    def percept_of(self, batch: Batch, row: int) -> Percept:
        """What is sensed, as the run takes it."""
        state = self.state_of(batch, row)
        if len(state) != len(self.body.joint_names):
            names = ", ".join(self.body.joint_names)
            raise ValueError(f"{OBS_STATE} has {len(state)} joints, the run's recordings have {len(self.body.joint_names)}: give {names}")
        joints = unwrapped(state[None, self.known], self.model.sensors.joint_names, unwraps(self.view))[0]
        return Percept(self.frame_of(batch, self.camera_in(batch), row), joints)

    def with_others(self, batch: Batch, row: int, joints: np.ndarray) -> np.ndarray:
        """All joints (A) of an action: those that the run does not move stay where they stand."""
        action = self.state_of(batch, row)
        action[self.known] = joints
        return action

    def state_of(self, batch: Batch, row: int) -> np.ndarray:
        return batch[OBS_STATE][row].double().cpu().numpy().copy()

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
