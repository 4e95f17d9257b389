"""Scenes beyond what is demonstrated, and how a solved scene looks: for goals that may be missed, and goals that cannot be met.

>>> from preimage.robot.reach import Reach
>>> scene = sample_rim(Reach(), np.random.default_rng(0))
>>> beyond_area_m(Reach(), scene.positions_m["goal"]) > 0
True
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from preimage.records import Percept, Scene
from preimage.robot.arm import GRIPPER_OPEN_M, OBJECT, OBJECT_HEIGHT_M, Arm
from preimage.robot.kinematics import grasping_joints, reaching_joints
from preimage.robot.move_object import CARRY_M, CIRCLES
from preimage.robot.reach import MARGIN_M
from preimage.robot.task import LARGE_TABLE_MARGIN_M, Task, apart_m, at_height

RIM_M = 0.1
"""How far beyond the area of the demonstrations the rim reaches (m)."""
APART_M = 0.15
"""Things of a scene lie at least this far from each other (m)."""


def sample_rim(task: Task, rng: np.random.Generator, *, from_m: float = 0.0, to_m: float = RIM_M, name: str | None = None) -> Scene:
    """A scene one of whose places, any or the one named, lies so far beyond the area of the demonstrations (m), within the hand's reach."""
    half_m = task.workspace.table_size_m / 2 + to_m
    while True:
        scene = task.sample(rng)
        chosen = name or str(rng.choice(sorted(scene.positions_m)))
        place = rng.uniform((-to_m, -half_m), (2 * half_m - to_m, half_m))
        others = [position for other, position in scene.positions_m.items() if other != chosen]
        if not from_m < beyond_area_m(task, place) <= to_m or min((apart_m(place, other) for other in others), default=1.0) < APART_M:
            continue
        if np.isfinite(joints_above(task, place, hand_height_m(task, scene))).all():
            return replace(scene, positions_m={**scene.positions_m, chosen: (*place.tolist(), scene.positions_m[chosen][2])})


def beyond_area_m(task: Task, place_m: Sequence[float] | Float[np.ndarray, " _"]) -> float:
    """How far a place lies beyond the square of the table in which the task is demonstrated (m); 0 within."""
    side_m = task.workspace.table_size_m
    margin_m = MARGIN_M if task.name == "reach" else LARGE_TABLE_MARGIN_M
    x, y = place_m[:2]
    return float(np.hypot(max(margin_m - x, x - side_m + margin_m, 0.0), max(abs(y) - side_m / 2 + margin_m, 0.0)))


def aim_of(task: Task) -> str:
    """The place at which a solved scene ends."""
    return CIRCLES[0] if task.workspace.has_object else "goal"


def hand_height_m(task: Task, scene: Scene) -> float:
    """How high the hand is above its aim when the scene is solved (m)."""
    return CARRY_M if task.workspace.has_object else scene.positions_m[aim_of(task)][2]


def joints_above(task: Task, place_m: Sequence[float] | Float[np.ndarray, " _"], height_m: float) -> Float[np.ndarray, " J"]:
    """Joints of a hand above a place (rad; gripper, open: m), tilted as the task has it; NaN out of reach."""
    point = at_height(np.array(place_m[:2]), height_m)
    return np.append(grasping_joints(point), GRIPPER_OPEN_M) if task.workspace.has_gripper else reaching_joints(point)


def end_of(task: Task, scene: Scene) -> tuple[Float[np.ndarray, " J"], dict[str, tuple[float, ...]]]:
    """The joints (rad; gripper: m) and the places of the things (m) in which a solved scene ends."""
    things, aim = {name: scene.positions_m[name] for name in task.workspace.things}, scene.positions_m[aim_of(task)]
    if task.workspace.has_object:
        things[OBJECT] = (*aim[:2], OBJECT_HEIGHT_M / 2)
    return joints_above(task, aim, hand_height_m(task, scene)), things


def sense_ends(arm: Arm, task: Task, scene: Scene) -> tuple[Percept, Percept]:
    """What is sensed before a scene is solved and after: the arm is put there, no way leads through."""
    task.lay_out(arm, scene)
    return arm.sense(), sense_end(arm, task, scene)


def sense_end(arm: Arm, task: Task, scene: Scene) -> Percept:
    """What is sensed after a scene is solved: the arm is put there, no way leads through."""
    arm.set_up(task.workspace)
    arm.reset(*end_of(task, scene))
    return arm.sense()
