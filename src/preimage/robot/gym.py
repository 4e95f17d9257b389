"""The tasks as Gymnasium environments: `import preimage.robot.gym`, then `gymnasium.make("preimage/Reach-v0")`.

An episode is one scene. What is observed is the frame, the joints and the goal frame, the last one of a demonstration that solved the
same scene; an action is the joints to command for the next step, as in a plan (rad; gripper: m). The arm follows within its speed, as in
`robot.execution`. The task's own judge ends the episode, with a reward of 1, once the scene is solved and the end effector is at rest: to
pass through a goal is not to reach it. Until then the reward is 0, and what the judge sees is in `info`.

>>> environment = gymnasium.make("preimage/Reach-v0")
>>> seen, info = environment.reset(seed=0)
>>> sorted(seen), seen["goal"].shape, environment.action_space.shape
(['frame', 'goal', 'joints'], (64, 64, 1), (4,))
>>> seen, reward, terminated, truncated, info = environment.step(seen["joints"])
>>> reward, terminated, info["deviation_m"] > 0.04
(0.0, False, True)
"""

# pyright: reportMissingImports=false
# gymnasium is optional, the extra `gym`.

from typing import Any, final

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict
from jaxtyping import Float, UInt8

from preimage.records import Demonstration
from preimage.robot import TASKS, Arm, record
from preimage.robot.execution import ENCODER_MARGIN, Stage, limits_of
from preimage.robot.limits import Limiter

REST_M = 0.005
"""An end effector that moved less than this since the step before is at rest (m)."""
PATIENCE = 2
"""An episode is cut off after so many times the steps of the longest demonstration that can be."""

Observation = dict[str, np.ndarray]
"""frame and goal (H, W, C) uint8, joints (J,) float64."""


@final
class TaskEnvironment(gymnasium.Env[Any, np.ndarray]):
    """A task of the simulated arm, one scene an episode.

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
        joints = Box(limits.lower - ENCODER_MARGIN, limits.upper + ENCODER_MARGIN, dtype=np.float64)
        self.observation_space = Dict({"frame": pictures, "joints": joints, "goal": pictures})
        self.action_space = Box(limits.lower, limits.upper, dtype=np.float64)
        self._shown: Demonstration | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Lay out a new scene, whose goal is that of a demonstration; it depends on the seed alone."""
        super().reset(seed=seed)
        (self._shown,) = record(self._arm, self._task, count=1, seed=int(self.np_random.integers(2**31)))
        scene = self._shown.scene
        assert scene is not None, "demonstrations of the simulated arm know their scene"
        self._stage = Stage(self._task, self._arm, scene)
        self._limiter = Limiter(limits_of(self._arm), np.array(scene.start_joints), 1 / self._task.rate_hz)
        return self._look(), self._judge()[1]

    def step(self, action: Float[np.ndarray, " J"]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """The arm went on towards the joints that were asked for, as far as its limits allow in one step.

        Raises:
            ValueError: the action has another shape than the joints, or is not finite; or there was no reset.
        """
        if self._shown is None:
            raise ValueError("the environment was not reset: call reset before step")
        wanted = np.asarray(action, np.float64)
        if wanted.shape != self.action_space.shape or not np.isfinite(wanted).all():
            raise ValueError(f"action is {wanted.tolist()}: give {len(self._arm.joint_names)} finite joint angles")
        self._stage.move(self._limiter.follow(wanted), 1 / self._task.rate_hz)
        solved, info = self._judge()
        return self._look(), float(solved), solved, False, info

    def render(self) -> UInt8[np.ndarray, "H W 3"] | None:
        """What the camera sees, in colour; None without a render_mode."""
        return np.repeat(self._frame, 3, axis=-1) if self.render_mode == "rgb_array" else None  # (H, W, 3)

    def _look(self) -> Observation:
        assert self._shown is not None
        percept = self._stage.percept
        assert percept.frame is not None
        assert percept.joints is not None
        self._frame = percept.frame
        return {"frame": percept.frame, "joints": percept.joints, "goal": self._shown.frames[-1].copy()}

    def _judge(self) -> tuple[bool, dict[str, Any]]:
        """Whether the scene is solved by the course so far, and all that the judge saw."""
        judgement = self._stage.judge()
        ends = [moment.end_effector_m for moment in self._stage.course[-2:]]
        solved = bool(judgement.success and len(ends) == 2 and np.linalg.norm(ends[1] - ends[0]) < REST_M)
        return solved, {"deviation_m": judgement.deviation_m, "success": bool(judgement.success), **judgement.details}


def name_of(task: str) -> str:
    """The name of a task's environment.

    >>> name_of("two-points")
    'preimage/TwoPoints-v0'
    """
    return f"preimage/{task.title().replace('-', '')}-v0"


def register() -> None:
    """Every task can be made by its name; nothing happens to those that can already."""
    for name, task in TASKS.items():
        if name_of(name) not in gymnasium.registry:
            entry_point = "preimage.robot.gym:TaskEnvironment"
            longest = PATIENCE * task.num_steps[1]
            gymnasium.register(name_of(name), entry_point=entry_point, kwargs={"task": name}, max_episode_steps=longest)


register()
