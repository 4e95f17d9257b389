"""The simulated table: a place on its picture becomes a goal, as the camera would see it, and plans are executed on it.

>>> from preimage.robot import TASKS
>>> table = Table(TASKS["reach"], pixels=64)
>>> scene = table.with_goal_at(table.scene(seed=0), (0.5, 0.5))
>>> table.start(scene).frame.shape, table.goal(scene).frame.shape
((64, 64, 1), (64, 64, 1))
"""

import threading
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, UInt8

from preimage.records import Percept, Plan, Scene, Trial
from preimage.robot import Arm, Task, forward_kinematics, with_frames
from preimage.robot.execution import execute
from preimage.robot.kinematics import ACTIVE_JOINTS, reaching_joints
from preimage.robot.move_object import APART_M as OBJECT_APART_M
from preimage.robot.move_object import MoveObject
from preimage.robot.reach import MARGIN_M, Reach
from preimage.robot.rim import aim_of, sense_end
from preimage.robot.task import apart_m, is_inside_margin
from preimage.robot.two_points import APART_M as GOAL_APART_M
from preimage.robot.two_points import ReachTwo

LARGE_PIXELS = 320
"""Height and width of the picture that people click on: the network's own is too small for it."""
Touch = Literal["push", "object", "goal"]
"""The hand is pushed, the object moved, another goal wanted."""
MOST_SCENES = 16
"""Starts whose pictures are kept, each of 0.1 MB: a click on the table does not have it drawn again."""
GRID = 48
"""Cells along a side of the picture at which it is looked up whether the arm gets there."""


Beginning = tuple[tuple[float, ...], tuple[tuple[str, tuple[float, ...]], ...]]
"""All that a picture of a start depends on: the joints, and where each thing lies."""


class Table:
    """A task with its arm, of which there is one: whoever uses it waits for the others.

    Args:
        pixels: height and width of the frames that the network sees.
    """

    def __init__(self, task: Task, pixels: int) -> None:
        self.task = with_frames(task, pixels)
        self.large_camera = replace(task.workspace.camera, height=LARGE_PIXELS, width=LARGE_PIXELS)
        self._arm, self._lock = Arm(), threading.Lock()
        self._arm.set_up(self.task.workspace)
        self.units = self._arm.joint_units
        self._start, self._large = lru_cache(MOST_SCENES)(self._sensed_at), lru_cache(MOST_SCENES)(self._large_at)

    @property
    def camera(self):
        return self.task.workspace.camera

    @property
    def goal_name(self) -> str:
        """What of a scene lies where a person clicked."""
        return aim_of(self.task)

    @property
    def goal_height_m(self) -> float:
        return 0.0 if isinstance(self.task, MoveObject) else self.task.goal_height_m  # pyright: ignore[reportAttributeAccessIssue]

    def described(self) -> dict[str, Any]:
        """What the page has to know of it."""
        asks = "Click where the object should go" if self.goal_name == "circle" else "Click where the hand should go"
        return {
            "task": self.task.name,
            "asks": asks,
            "tolerance_cm": 100 * self.task.tolerance_m,
            "things": list(self.task.workspace.things),
            "touches": list(self.touches),
        }

    @property
    def touches(self) -> tuple[Touch, ...]:
        """What a person may do while the arm moves; of two places to be reached neither can be changed alone."""
        movable: tuple[Touch, ...] = ("object",) if self.task.workspace.has_object else ()
        return ("push", *movable, *(("goal",) if isinstance(self.task, Reach) else ()))

    def scene(self, seed: int) -> Scene:
        """What lies on the table by a seed; the arm waits exactly at home."""
        with self._lock:
            self._arm.set_up(self.task.workspace)
            home = tuple(self._arm.home.tolist())
        return replace(self.task.sample(np.random.default_rng(seed)), start_joints=home)

    def with_goal_at(self, scene: Scene, seen: tuple[float, float]) -> Scene:
        """The scene whose goal lies where the camera sees it there.

        Args:
            seen: shares of the picture's width from the left and of its height from the top.

        Raises:
            ValueError: the arm does not get there, or something lies in the way.
        """
        place = self.camera.place_at(np.array(seen), self.goal_height_m)
        table_m = self.task.workspace.table_size_m
        if place is None or not is_inside_margin(place[:2], table_m, 0.0):
            raise ValueError("that is beside the table: click a place on it")
        where = f"{100 * place[0]:.0f} cm from the near edge and {100 * abs(place[1]):.0f} cm to the {'left' if place[1] > 0 else 'right'}"
        if not self._reaches(place):
            raise ValueError(f"the arm does not get there ({where}): click within the line")
        for name, position in scene.positions_m.items():
            if name != self.goal_name and apart_m(place, position) < self._apart_m:
                raise ValueError(
                    f"that is too near to the {name.replace('_', ' ')}: click {100 * self._apart_m:.0f} cm or more away from it"
                )
        return replace(scene, positions_m={**scene.positions_m, self.goal_name: tuple(place.tolist())})

    def start(self, scene: Scene) -> Percept:
        """What is sensed before anything moves."""
        return self._start(self._beginning(scene))

    def goal(self, scene: Scene) -> Percept:
        """What would be sensed if the scene were solved."""
        with self._lock:
            return sense_end(self._arm, self.task, scene)

    def large(self, scene: Scene) -> UInt8[np.ndarray, "H W 1"]:
        """The start, large enough for people."""
        return self._large(self._beginning(scene))

    def execute(self, plan: Plan, scene: Scene) -> Trial:
        """Let the arm execute a plan, and judge where it ends."""
        with self._lock:
            return execute(plan, self._arm, scene, task=self.task)

    def way(self, joints: Float[np.ndarray, "T J"]) -> Float[np.ndarray, "T 2"]:
        """Where on the picture the hand is on its way."""
        return self.camera.project(forward_kinematics(joints[:, : len(ACTIVE_JOINTS)]))

    @cached_property
    def reachable(self) -> list[str]:
        """Rows of a grid over the picture: 1 where the arm gets to what is seen there."""
        middles = (np.arange(GRID) + 0.5) / GRID
        rows = [[self.camera.place_at(np.array([across, down]), self.goal_height_m) for across in middles] for down in middles]
        return ["".join("1" if place is not None and self._reaches(place) else "0" for place in row) for row in rows]

    def _beginning(self, scene: Scene) -> Beginning:
        return scene.start_joints, tuple((name, scene.positions_m[name]) for name in self.task.workspace.things)

    def _sensed_at(self, beginning: Beginning) -> Percept:
        with self._lock:
            self._lay_out(beginning)
            return self._arm.sense()

    def _large_at(self, beginning: Beginning) -> UInt8[np.ndarray, "H W 1"]:
        with self._lock:
            self._lay_out(beginning)
            return self._arm.seen_by(self.large_camera)

    def _lay_out(self, beginning: Beginning) -> None:
        joints, positions_m = beginning
        self.task.lay_out(self._arm, Scene(self.task.name, joints, dict(positions_m)))

    @property
    def _apart_m(self) -> float:
        return OBJECT_APART_M if isinstance(self.task, MoveObject) else GOAL_APART_M

    def _reaches(self, place: Float[np.ndarray, " 3"]) -> bool:
        if isinstance(self.task, Reach):
            inside = is_inside_margin(place[:2], self.task.workspace.table_size_m, MARGIN_M)
            return bool(inside and not np.isnan(reaching_joints(place)).any())
        assert isinstance(self.task, ReachTwo | MoveObject)
        return bool(self.task.is_in_reach(place[:2]))
