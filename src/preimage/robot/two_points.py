"""Experiment 2 of the paper: touch a marker on the table, then go on to a goal.

The marker is seen from the start; the goal is known by the last frame alone.

>>> task = ReachTwo()
>>> scene = task.sample(np.random.default_rng(0))
>>> scene.task, sorted(scene.positions_m), len(scene.start_joints)
('two-points', ['goal', 'marker'], 4)
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np
from jaxtyping import Bool, Float

from preimage.records import Scene
from preimage.robot.arm import CIRCLE_RADIUS_M, Arm, GroundTruth, Workspace
from preimage.robot.kinematics import from_polar, home_joints, reaching_joints, to_polar
from preimage.robot.motion import MotionStyle, first_safe, guide_safely, timing
from preimage.robot.task import (
    LARGE_TABLE_CAMERA,
    LARGE_TABLE_M,
    LARGE_TABLE_MARGIN_M,
    NEVER_M,
    START_SD,
    Judgement,
    apart_m,
    at_height,
    in_reach_at,
    lay_out,
    places_on_grid,
    sample_place,
)

TO_MARKER = MotionStyle(steps=(20, 40), rest_steps=2, detour_sd=0.05)
"""How the hand leads to the marker."""
TRANSFER_STEPS = (18, 34)
"""Shortest and longest way from the marker to the goal, pauses and rest included."""
TRANSFER_REST_STEPS = 3
TRANSFER_HEIGHT_M = (0.06, 0.14)
"""How high the hand rises, least and most, between the marker and the goal (m)."""
TOUCH_HEIGHT_M = 0.02
"""Height to which the demonstrator lowers the end effector on the marker (m)."""
LOW_M = 0.04
"""An end effector below this height touches what lies under it (m)."""
MARKER_GREY = 0.05
"""Dark: a light marker would nearly vanish in the shadow of the arm that comes to touch it."""
WORKSPACE = Workspace(LARGE_TABLE_M, LARGE_TABLE_CAMERA, circles=("marker",), circle_grey=MARKER_GREY)
APART_M = 0.15
"""Marker and goal lie at least this far from each other (m)."""


@final
@dataclass(frozen=True)
class ReachTwo:
    """Touch the marker, then bring the end effector to a point just above the table (experiment 2 of the paper).

    The marker is touched when the end effector, at any step, is low and above the marker. The end effector starts at home, well above
    the table, so that neither is reached before the arm moves.
    """

    name: str = field(default="two-points", init=False)
    rate_hz: float = 10.0
    """Steps a second."""
    tolerance_m: float = 0.04
    """Success needs an end effector nearer to the goal than this at the end (m)."""
    goal_height_m: float = 0.03
    """Height of the goals above the table (m)."""
    workspace: Workspace = WORKSPACE

    @property
    def num_steps(self) -> tuple[int, int]:
        """Lengths of the shortest and the longest possible demonstration."""
        return TO_MARKER.steps[0] + TRANSFER_STEPS[0] - 1, TO_MARKER.steps[1] + TRANSFER_STEPS[1] - 1

    def sample(self, rng: np.random.Generator) -> Scene:
        """A scene whose marker and goal lie anywhere on the part of the table that the arm can reach, well apart."""
        home = home_joints()
        start = home + rng.normal(scale=START_SD, size=len(home))
        while True:
            marker, goal = (sample_place(rng, self.workspace.table_size_m, LARGE_TABLE_MARGIN_M) for _ in range(2))
            if apart_m(marker, goal) >= APART_M and self.is_in_reach(np.stack([marker, goal])).all():
                break
        positions_m = {"marker": at_height(marker, 0.0), "goal": at_height(goal, self.goal_height_m)}
        return Scene(self.name, tuple(start.tolist()), {name: tuple(position.tolist()) for name, position in positions_m.items()})

    def is_in_reach(self, places_m: Float[np.ndarray, "*batch 2"]) -> Bool[np.ndarray, "*batch"]:
        """Whether the hand can touch the table at these places and rise above them to the height of the transfer."""
        heights_m = np.linspace(TOUCH_HEIGHT_M, self.goal_height_m + TRANSFER_HEIGHT_M[1], 7).tolist()
        return in_reach_at(places_m, heights_m, reaching_joints, self.workspace.table_size_m)

    def lay_out(self, arm: Arm, scene: Scene) -> None:
        """The marker lies on the table and the arm is at rest at its start; the goal itself cannot be seen."""
        lay_out(self, arm, scene)

    def demonstration_path(self, rng: np.random.Generator, scene: Scene) -> Float[np.ndarray, "T J"]:
        """Joint angles (rad), step by step, along which the arm is guided to the marker and, through the air, to the goal.

        Raises:
            ValueError: marker or goal is out of reach.
        """
        marker = at_height(np.array(scene.positions_m["marker"][:2]), TOUCH_HEIGHT_M)
        goal = np.array(scene.positions_m["goal"])
        for name, place in (("marker", marker), ("goal", goal)):
            if np.isnan(reaching_joints(place)).any():
                raise ValueError(f"the {name} at {scene.positions_m[name]} m is out of reach: take a scene of ReachTwo.sample")
        start, touch = np.array(scene.start_joints), reaching_joints(marker)
        to_marker = guide_safely(rng, start, touch, rate_hz=self.rate_hz, style=TO_MARKER)
        transfer = first_safe(lambda: _transfer(rng, marker, goal), rate_hz=self.rate_hz)
        return np.concatenate([to_marker, transfer[1:]])

    def judge(self, scene: Scene, course: Sequence[GroundTruth]) -> Judgement:
        """Whether the marker was touched on the way, and the distance in space between the end effector, at last, and the goal.

        The details: `touched`, and `marker_error_m`, the smallest horizontal distance to the marker's centre of a low end effector (m).
        """
        deviation_m = float(np.linalg.norm(np.subtract(course[-1].end_effector_m, scene.positions_m["goal"])))
        low = [moment.end_effector_m for moment in course if moment.end_effector_m[2] < LOW_M]
        marker_error_m = min((apart_m(place, scene.positions_m["marker"]) for place in low), default=NEVER_M)
        touched = marker_error_m < CIRCLE_RADIUS_M
        details = {"touched": touched, "marker_error_m": marker_error_m}
        return Judgement(deviation_m, success=touched and deviation_m < self.tolerance_m, details=details)


def reachable_share(task: ReachTwo) -> float:
    """Share of the whole table on which markers and goals are placed, counted on a grid."""
    return float(task.is_in_reach(places_on_grid(task.workspace.table_size_m)).mean())


def _transfer(rng: np.random.Generator, start_m: Float[np.ndarray, " 3"], goal_m: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "T 4"]:
    """Joint angles (rad), step by step, of a hand that turns about the base from one place to another, rising in between."""
    progress = timing(rng, int(rng.integers(*TRANSFER_STEPS, endpoint=True)), rest_steps=TRANSFER_REST_STEPS)[:, None]
    start, goal = to_polar(start_m), to_polar(goal_m)
    polar = start + (goal - start) * progress
    polar[:, 2] += rng.uniform(*TRANSFER_HEIGHT_M) * np.sin(np.pi * progress[:, 0])
    return reaching_joints(from_polar(polar))
