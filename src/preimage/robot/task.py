"""What a task is: a family of scenes, a demonstrator who shows how they are solved, and a judge of the outcome.

A judge looks at the whole course of a trial, one `GroundTruth` per moment, as some tasks are about what happens on the way.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from preimage.records import Scene
from preimage.robot.arm import Arm, GroundTruth, Workspace
from preimage.robot.camera import Camera

START_SD = 0.005
"""Standard deviation of the start about home, each joint of the arm (rad)."""
NEVER_M = 9.0
"""The distance that a judgement's details give where nothing ever came near (m): JSON has no infinity."""

LARGE_TABLE_M = 1.0
"""Side of the table of experiments 2 and 3 (m)."""
LARGE_TABLE_MARGIN_M = 0.14
"""Places on the large table keep this far from its edge, so that its camera sees circle, object and fingers whole (m)."""
LARGE_TABLE_CAMERA = Camera(position_m=(1.7, 0.0, 2.2), target_m=(0.415, 0.0, 0.05), fovy_deg=21.2)
"""Far up and narrow, so that a pixel is nearly as wide at the near as at the far end of what the arm can reach."""


@dataclass(frozen=True)
class Judgement:
    """How a trial went."""

    deviation_m: float
    """Distance between what the task brings to the goal and the goal, at the end (m)."""
    success: bool
    details: Mapping[str, float] = field(default_factory=dict)
    """What else the judge saw: distances (m) and booleans, ready for JSON."""


@runtime_checkable
class Task(Protocol):
    """A family of scenes, a demonstrator who shows how they are solved, and a judge of the outcome."""

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
        """Success needs a deviation below this (m)."""
        ...

    @property
    def workspace(self) -> Workspace: ...

    @property
    def num_steps(self) -> tuple[int, int]:
        """Lengths of the shortest and the longest possible demonstration."""
        ...

    def sample(self, rng: np.random.Generator) -> Scene:
        """A new scene, solvable and not yet solved."""
        ...

    def lay_out(self, arm: Arm, scene: Scene) -> None:
        """Set up the workspace, put the objects of the scene in their places, and bring the arm to rest at its start."""
        ...

    def demonstration_path(self, rng: np.random.Generator, scene: Scene) -> Float[np.ndarray, "T J"]:
        """Joints (rad; gripper: m), step by step, along which a demonstrator guides the arm to solve the scene."""
        ...

    def judge(self, scene: Scene, course: Sequence[GroundTruth]) -> Judgement:
        """How well the scene was solved by what happened from the first moment to the last."""
        ...


AnyTask = TypeVar("AnyTask", bound=Task)


def with_frames(task: AnyTask, size: int) -> AnyTask:
    """The same task seen by the same camera in square frames of another size.

    >>> from preimage.robot.reach import Reach
    >>> with_frames(Reach(), 128).workspace.camera.height
    128
    """
    camera = dataclasses.replace(task.workspace.camera, height=size, width=size)
    workspace = dataclasses.replace(task.workspace, camera=camera)
    return dataclasses.replace(task, workspace=workspace)  # pyright: ignore[reportArgumentType], every task is a dataclass


def lay_out(task: Task, arm: Arm, scene: Scene) -> None:
    """Set up the workspace of a task, put its objects where the scene says, and bring the arm to rest at its start."""
    arm.set_up(task.workspace)
    arm.reset(scene.start_joints, {name: scene.positions_m[name] for name in task.workspace.things})


def sample_place(rng: np.random.Generator, table_size_m: float, margin_m: float) -> Float[np.ndarray, " 2"]:
    """A place anywhere on the table, at least the margin from its edge (m)."""
    lower, upper = (margin_m, margin_m - table_size_m / 2), (table_size_m - margin_m, table_size_m / 2 - margin_m)
    return rng.uniform(lower, upper)


def places_on_grid(table_size_m: float, cells_a_side: int = 200) -> Float[np.ndarray, "places 2"]:
    """The middles of the cells of a grid that covers the table (m)."""
    middles = (np.arange(cells_a_side) + 0.5) / cells_a_side * table_size_m
    x, y = np.meshgrid(middles, middles - table_size_m / 2)
    return np.stack([x.ravel(), y.ravel()], axis=-1)


def is_inside_margin(places_m: Float[np.ndarray, "*batch 2"], table_size_m: float, margin_m: float) -> Bool[np.ndarray, "*batch"]:
    """Whether places keep the margin from the edge of the table."""
    x, y = np.moveaxis(places_m, -1, 0)
    return (x >= margin_m) & (x <= table_size_m - margin_m) & (np.abs(y) <= table_size_m / 2 - margin_m)


def in_reach_at(
    places_m: Float[np.ndarray, "*batch 2"], heights_m: Sequence[float], joints_at: Callable[[np.ndarray], np.ndarray], table_size_m: float
) -> Bool[np.ndarray, "*batch"]:
    """Whether inverse kinematics find joints above these places of the large table at all heights, and they keep its margin."""
    joints = [joints_at(at_height(places_m, height_m)) for height_m in heights_m]
    return ~np.isnan(joints).any(axis=(0, -1)) & is_inside_margin(places_m, table_size_m, LARGE_TABLE_MARGIN_M)


def at_height(places_m: Float[np.ndarray, "*batch 2"], height_m: float) -> Float[np.ndarray, "*batch 3"]:
    """The points above places on the table (m)."""
    return np.concatenate([places_m, np.full_like(places_m[..., :1], height_m)], axis=-1)


def apart_m(one: Sequence[float] | np.ndarray, other: Sequence[float] | np.ndarray) -> float:
    """Horizontal distance between two points (m)."""
    return float(np.linalg.norm(np.subtract(one[:2], other[:2])))
