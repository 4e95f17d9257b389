"""The tasks as Gymnasium environments: `import preimage.robot.gym`, then `gymnasium.make("preimage/Reach-v0")`.

An episode is one scene. What is observed is the frame, the joints and the goal frame, the last one of a demonstration that solved the
same scene; an action is the joints to command for the next step, as in a plan (rad; gripper: m). The arm follows within its speed, as in
`robot.execution`. The task's own judge ends the episode, with a reward of 1, once the scene is solved and the end effector is at rest:
passing through a goal is not reaching it. Until then the reward is 0, and what the judge sees is in `info`.

>>> environment = gymnasium.make("preimage/Reach-v0")
>>> seen, info = environment.reset(seed=0)
>>> sorted(seen), seen["goal"].shape, environment.action_space.shape
(['achieved_goal', 'desired_goal', 'frame', 'goal', 'joints', 'observation'], (64, 64, 1), (4,))
>>> seen, reward, terminated, truncated, info = environment.step(seen["joints"])
>>> reward, terminated, info["deviation_m"] > 0.04
(0.0, False, True)
"""

# pyright: reportMissingImports=false
# gymnasium is optional, the extra `gym`.

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, final

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict
from jaxtyping import Float, UInt8

from preimage.records import Demonstration, Percept
from preimage.robot import TASKS, Arm, record
from preimage.robot.execution import ENCODER_MARGIN, FARTHEST_M, Stage, limits_of
from preimage.robot.limits import Limiter, Limits

REST_M = 0.005
"""An end effector that moved less than this since the step before is at rest (m)."""
PATIENCE = 2
"""An episode is cut off after so many times the steps of the longest possible demonstration."""

Observation = dict[str, np.ndarray]
"""frame and goal (H, W, 1) uint8; joints, observation, achieved_goal and desired_goal float32."""


@final
class TaskEnvironment(gymnasium.Env[Any, np.ndarray]):
    """A task of the simulated arm, one scene an episode.

    `frame`, `joints` and `goal` are what a camera and encoders sense. `observation` (the joints again), `achieved_goal` and `desired_goal`
    are there for hindsight experience replay, under the names that it expects: the position (m) of what the task brings to the goal, and
    that of the goal, which only a simulator knows.

    Args:
        task: name of the task.
        render_mode: rgb_array, or None.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, task: str, render_mode: str | None = None) -> None:
        self._task, self._arm = TASKS[task], Arm()
        self._arm.set_up(self._task.workspace)
        self.metadata = {**self.metadata, "render_fps": self._task.rate_hz}
        self.render_mode = render_mode
        camera, limits = self._task.workspace.camera, limits_of(self._arm)
        pictures = Box(0, 255, (camera.height, camera.width, 1), np.uint8)
        lower, upper = (each.astype(np.float32) for each in (limits.lower - ENCODER_MARGIN, limits.upper + ENCODER_MARGIN))
        joints = Box(lower, upper, dtype=np.float32)
        places = Box(-FARTHEST_M, FARTHEST_M, (2 if self._task.workspace.has_object else 3,), np.float32)
        seen = {"frame": pictures, "joints": joints, "goal": pictures}
        self.observation_space = Dict(seen | {"observation": joints, "achieved_goal": places, "desired_goal": places})
        self.action_space = Box(limits.lower.astype(np.float32), limits.upper.astype(np.float32), dtype=np.float32)
        self._shown: Demonstration | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Lay out a new scene, whose goal is that of a demonstration; it depends on the seed alone."""
        super().reset(seed=seed)
        (self._shown,) = record(self._arm, self._task, count=1, seed=int(self.np_random.integers(2**31)))
        scene = self._shown.scene
        assert scene is not None, "demonstrations of the simulated arm know their scene"
        self._scene = scene
        self._stage = Stage(self._task, self._arm, scene)
        self._limiter = Limiter(limits_of(self._arm), np.array(scene.start_joints), 1 / self._task.rate_hz)
        seen = self._look(self._shown)
        return seen, self._judge(seen)[1]

    def step(self, action: Float[np.ndarray, " J"]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move towards the joints that are asked for, as far as the limits allow in one step.

        Raises:
            ValueError: the action has another shape than the joints, or is not finite; or there was no reset.
        """
        if self._shown is None:
            raise ValueError("the environment was not reset: call reset before step")
        wanted = np.asarray(action, np.float64)
        if wanted.shape != self.action_space.shape or not np.isfinite(wanted).all():
            raise ValueError(f"action is {wanted.tolist()}: give {len(self._arm.joint_names)} finite joint angles")
        self._stage.move(self._limiter.follow(wanted), 1 / self._task.rate_hz)
        seen = self._look(self._shown)
        reward, info = self._judge(seen)
        return seen, reward, reward > 0, False, info

    def compute_reward(
        self, achieved_goal: Float[np.ndarray, "*B P"], desired_goal: Float[np.ndarray, "*B P"], info: Mapping[str, Any] | Sequence[Mapping]
    ) -> Any:
        """1 where the achieved goal is within the tolerance of the desired one and the rest of the task is done, else 0.

        Args:
            info: of the step, or of each of the steps; its `conditions_met` says whether the rest is done: the arm is at rest, the marker
                was touched, the object stands where it was brought.
        """
        near = np.linalg.norm(np.subtract(achieved_goal, desired_goal), axis=-1) < self._task.tolerance_m
        met = info["conditions_met"] if isinstance(info, Mapping) else np.array([each["conditions_met"] for each in info])
        rewards = np.asarray(near & met, np.float32)
        return rewards if rewards.ndim else float(rewards)

    def render(self) -> UInt8[np.ndarray, "H W 3"] | None:
        """What the camera sees, grey in three equal channels, at the size of the frames; None without a render_mode."""
        if self.render_mode != "rgb_array":
            return None
        if self._shown is None:
            raise ValueError("the environment was not reset: call reset before render")
        frame = self._stage.percept.frame
        assert frame is not None
        return np.repeat(frame, 3, axis=-1)  # (H, W, 3)

    def _look(self, shown: Demonstration) -> Observation:
        percept = self._stage.percept
        assert percept.frame is not None
        assert percept.joints is not None
        joints = percept.joints.astype(np.float32)
        achieved, desired = (place.astype(np.float32) for place in (self._brought_m, self._goal_m))
        seen = {"frame": percept.frame, "joints": joints, "goal": shown.frames[-1].copy()}
        return seen | {"observation": joints.copy(), "achieved_goal": achieved, "desired_goal": desired}

    def _judge(self, seen: Observation) -> tuple[float, dict[str, Any]]:
        """The reward of the course so far, and all that the judge saw."""
        judgement = self._stage.judge()
        ends = [moment.end_effector_m for moment in self._stage.course[-2:]]
        at_rest = len(ends) == 2 and bool(np.linalg.norm(ends[1] - ends[0]) < REST_M)
        here = {self._goal_name: (*self._brought_m.tolist(), *self._scene.positions_m[self._goal_name][len(self._brought_m) :])}
        there = replace(self._scene, positions_m={**self._scene.positions_m, **here})  # as if the goal were where it was brought
        info: dict[str, Any] = {"conditions_met": at_rest and bool(self._task.judge(there, self._stage.course).success)}
        reward = self.compute_reward(seen["achieved_goal"], seen["desired_goal"], info)
        info |= {"deviation_m": judgement.deviation_m, "success": bool(judgement.success), "is_success": reward > 0}
        return reward, info | dict(judgement.details)

    @property
    def _goal_name(self) -> str:
        """Where the goal of the scene is: a point, or the first of the circles."""
        return "goal" if "goal" in self._scene.positions_m else self._task.workspace.circles[0]

    @property
    def _brought_m(self) -> Float[np.ndarray, " P"]:
        """Where the thing that the task brings to the goal is: the object on the table, or the end effector in space."""
        moment = self._stage.course[-1]
        return moment.end_effector_m if moment.object_m is None else moment.object_m[:2]

    @property
    def _goal_m(self) -> Float[np.ndarray, " P"]:
        return np.array(self._scene.positions_m[self._goal_name])[: len(self._brought_m)]


@final
class EnvironmentRobot:
    """An environment whose actions are joints as a robot that a loop drives (`robot.protocol`).

    What it gives to see is `frame` and `joints`, as here; of another environment, wrap it so that it does. An episode that is over goes on
    to be sensed, and is commanded no more.

    Args:
        environment: the environment, which is reset.
        limits: what may be commanded.
        num_actions: actions for each command, in a straight line to it: 4 where the loop has 2.5 steps a second and the environment 10.
        seed: of the reset.
    """

    def __init__(self, environment: Any, limits: Limits, *, num_actions: int = 1, seed: int | None = None) -> None:
        self._environment, self.limits, self._num_actions = environment, limits, num_actions
        self.seen, self.info = environment.reset(seed=seed)
        self.is_over = False

    def sense(self) -> Percept:
        """Frame and joints of the last observation."""
        return Percept(self.seen["frame"], np.asarray(self.seen["joints"], np.float64))

    def command(self, joints: Float[np.ndarray, " J"]) -> None:
        """Act until the joints are asked for, or the episode is over."""
        begin = np.asarray(self.seen["joints"], np.float64)
        for action in range(1, self._num_actions + 1):
            if self.is_over:
                return
            wanted = begin + (joints - begin) * action / self._num_actions
            self.seen, _, terminated, truncated, self.info = self._environment.step(wanted)
            self.is_over = bool(terminated or truncated)


def name_of(task: str) -> str:
    """The name of a task's environment.

    >>> name_of("two-points")
    'preimage/TwoPoints-v0'
    """
    return f"preimage/{task.title().replace('-', '')}-v0"


def register() -> None:
    """Register every task by its name, unless it is registered already."""
    for name, task in TASKS.items():
        if name_of(name) not in gymnasium.registry:
            entry_point = "preimage.robot.gym:TaskEnvironment"
            longest = PATIENCE * task.num_steps[1]
            gymnasium.register(name_of(name), entry_point=entry_point, kwargs={"task": name}, max_episode_steps=longest)


register()
