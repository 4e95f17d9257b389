"""What the arm is asked to do: sample a scene, lay it out, show the way by hand, judge where the arm ended.

>>> task = Reach()
>>> scene = task.sample(np.random.default_rng(0))
>>> scene.task, sorted(scene.positions_m), len(scene.start_joints)
('reach', ['goal'], 4)
"""

from dataclasses import dataclass, field
from typing import Protocol, final, runtime_checkable

import numpy as np
from jaxtyping import Float

from preimage.records import Scene
from preimage.robot.arm import Arm, Furniture
from preimage.robot.hand import lead_safely
from preimage.robot.kinematics import home_joints, reaching_joints

START_SD = 0.005
"""Standard deviation of the start about home, each joint (rad)."""
MARGIN_M = 0.02
"""Goals keep this far from the edge of the table (m)."""


@dataclass(frozen=True)
class Judgement:
    """How a trial ended."""

    deviation_m: float
    """Distance between what the task brings to the goal and the goal (m)."""
    success: bool


@runtime_checkable
class Task(Protocol):
    """A family of scenes, the hand that shows how they are solved, and the judge of the outcome."""

    @property
    def name(self) -> str:
        """As on the command line and in `Scene.task`."""
        ...

    @property
    def rate_hz(self) -> float:
        """Steps a second."""
        ...

    @property
    def tolerance_m(self) -> float:
        """Success is a deviation below this (m)."""
        ...

    @property
    def furniture(self) -> Furniture: ...

    def sample(self, rng: np.random.Generator) -> Scene:
        """A new scene, solvable and not yet solved."""
        ...

    def lay_out(self, arm: Arm, scene: Scene) -> None:
        """The furniture stands, the things of the scene lie in their places, the arm is at rest at its start."""
        ...

    def hand_path(self, rng: np.random.Generator, scene: Scene) -> Float[np.ndarray, "T J"]:
        """Joint angles (rad), step by step, along which a human hand leads the arm to solve the scene."""
        ...

    def judge(self, arm: Arm, scene: Scene) -> Judgement:
        """How near the arm, as it is now, has brought the scene to its goal."""
        ...


@final
@dataclass(frozen=True)
class Reach:
    """Bring the end effector to a point just above the table (experiment 1 of the paper).

    The end effector starts at home, well above the table, so that no goal is reached before the arm moves.
    """

    name: str = field(default="reach", init=False)
    rate_hz: float = 10.0
    """Steps a second."""
    tolerance_m: float = 0.04
    """Success is an end effector nearer to the goal than this (m)."""
    goal_height_m: float = 0.03
    """Height of the goals above the table (m)."""
    furniture: Furniture = field(default_factory=Furniture)

    def sample(self, rng: np.random.Generator) -> Scene:
        """A scene whose goal lies anywhere on the part of the table that the arm can reach."""
        home = home_joints()
        start = home + rng.normal(scale=START_SD, size=len(home))
        return Scene(self.name, tuple(start.tolist()), {"goal": self._sample_goal(rng)})

    def lay_out(self, arm: Arm, scene: Scene) -> None:
        """The table stands and the arm is at rest at its start; the goal itself cannot be seen."""
        arm.furnish(self.furniture)
        arm.reset(scene.start_joints)

    def hand_path(self, rng: np.random.Generator, scene: Scene) -> Float[np.ndarray, "T J"]:
        """Joint angles (rad), step by step, along which a human hand leads the arm to the goal.

        Raises:
            ValueError: the goal is out of reach.
        """
        goal = reaching_joints(np.array(scene.positions_m["goal"]))
        if np.isnan(goal).any():
            raise ValueError(f"the goal at {scene.positions_m['goal']} m is out of reach: take a scene of Reach.sample")
        return lead_safely(rng, np.array(scene.start_joints), goal, rate_hz=self.rate_hz)

    def judge(self, arm: Arm, scene: Scene) -> Judgement:
        """The distance in space between the end effector and the goal, and whether it is within the tolerance."""
        deviation_m = float(np.linalg.norm(np.subtract(arm.end_effector_m, scene.positions_m["goal"])))
        return Judgement(deviation_m, success=deviation_m < self.tolerance_m)

    def _sample_goal(self, rng: np.random.Generator) -> tuple[float, ...]:
        size_m = self.furniture.table_size_m
        lower, upper = (MARGIN_M, MARGIN_M - size_m / 2), (size_m - MARGIN_M, size_m / 2 - MARGIN_M)
        while True:
            goal = np.array([*rng.uniform(lower, upper), self.goal_height_m])
            if not np.isnan(reaching_joints(goal)).any():
                return tuple(goal.tolist())


TASKS: dict[str, Task] = {"reach": Reach()}
"""The tasks by name."""


def reachable_share(task: Reach, *, cells_a_side: int = 200) -> float:
    """Share of the whole table above which the arm can reach a goal, counted on a grid."""
    middles = (np.arange(cells_a_side) + 0.5) / cells_a_side * task.furniture.table_size_m
    x, y = np.meshgrid(middles, middles - task.furniture.table_size_m / 2)
    goals = np.stack([x, y, np.full_like(x, task.goal_height_m)], axis=-1)
    return float(1 - np.isnan(reaching_joints(goals)).any(axis=-1).mean())
