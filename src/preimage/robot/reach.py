"""Experiment 1 of the paper: bring the end effector to a point just above the table.

>>> task = Reach()
>>> scene = task.sample(np.random.default_rng(0))
>>> scene.task, sorted(scene.positions_m), len(scene.start_joints)
('reach', ['goal'], 4)
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np
from jaxtyping import Float

from preimage.records import Scene
from preimage.robot.arm import Arm, GroundTruth, Workspace
from preimage.robot.kinematics import home_joints, reaching_joints
from preimage.robot.motion import MotionStyle, guide_safely
from preimage.robot.task import START_SD, Judgement, at_height, lay_out, places_on_grid, sample_place

MARGIN_M = 0.02
"""Goals keep this far from the edge of the table (m)."""
MOTION = MotionStyle()


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
    workspace: Workspace = field(default_factory=Workspace)

    @property
    def num_steps(self) -> tuple[int, int]:
        """Lengths of the shortest and the longest possible demonstration."""
        return MOTION.steps

    def sample(self, rng: np.random.Generator) -> Scene:
        """A scene whose goal lies anywhere on the part of the table that the arm can reach."""
        home = home_joints()
        start = home + rng.normal(scale=START_SD, size=len(home))
        return Scene(self.name, tuple(start.tolist()), {"goal": self._sample_goal(rng)})

    def lay_out(self, arm: Arm, scene: Scene) -> None:
        """The table stands and the arm is at rest at its start; the goal itself cannot be seen."""
        lay_out(self, arm, scene)

    def demonstration_path(self, rng: np.random.Generator, scene: Scene) -> Float[np.ndarray, "T J"]:
        """Joint angles (rad), step by step, along which a demonstrator guides the arm to the goal.

        Raises:
            ValueError: the goal is out of reach.
        """
        goal = reaching_joints(np.array(scene.positions_m["goal"]))
        if np.isnan(goal).any():
            raise ValueError(f"the goal at {scene.positions_m['goal']} m is out of reach: take a scene of Reach.sample")
        return guide_safely(rng, np.array(scene.start_joints), goal, rate_hz=self.rate_hz, style=MOTION)

    def judge(self, scene: Scene, course: Sequence[GroundTruth]) -> Judgement:
        """The distance in space between the end effector, at last, and the goal, and whether it is within the tolerance."""
        deviation_m = float(np.linalg.norm(np.subtract(course[-1].end_effector_m, scene.positions_m["goal"])))
        return Judgement(deviation_m, success=deviation_m < self.tolerance_m)

    def _sample_goal(self, rng: np.random.Generator) -> tuple[float, ...]:
        while True:
            goal = at_height(sample_place(rng, self.workspace.table_size_m, MARGIN_M), self.goal_height_m)
            if not np.isnan(reaching_joints(goal)).any():
                return tuple(goal.tolist())


def reachable_share(task: Reach) -> float:
    """Share of the whole table above which the arm can reach a goal, counted on a grid."""
    goals = at_height(places_on_grid(task.workspace.table_size_m), task.goal_height_m)
    return float(1 - np.isnan(reaching_joints(goals)).any(axis=-1).mean())
