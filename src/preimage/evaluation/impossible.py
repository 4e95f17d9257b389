"""Goals that cannot be met: the test bench of refusals, and other kinds of them to calibrate by.

The bench has twelve kinds, made by the simulator or from the picture of a goal that can be met. Calibration has seven others, so that
what is measured on the bench is how refusals carry over to kinds that were never seen.

>>> sorted(set(BENCH) & set(PRACTICE))
[]
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import UInt8

from preimage.records import Percept, Scene
from preimage.robot import TASKS, Arm, Task
from preimage.robot.rim import aim_of, end_of, joints_above, sample_rim, sense_end

Frame = UInt8[np.ndarray, "H W C"]
OFF_AREA_M = 0.15, 0.3
"""How far beyond the demonstrated area a goal off it lies, least and most (m): half as far again as the rim reaches, and more."""
ALOFT_M = 0.3, 0.45
"""How high a thing hovers that never hovered (m)."""
BELOW_TABLE_M = 0.12
"""How deep in the table a hand is where it cannot be (m)."""
TURNED_RAD = 0.35, 0.8
"""How far about the middle of the table another camera has moved, least and most."""
BACKWARDS_RAD = 2.8
"""Yaw of an arm that points away from the table (rad)."""
FOREIGN = "foreign"
"""Name of a circle that was never in the scene."""
SEEN = 1 / 256
"""Share of the picture that a foreign object has to change: behind the arm there is nothing to be seen of it, and the goal is possible."""
DIFFERENT = 15
"""Grey levels by which a pixel has to change for that."""


@dataclass(frozen=True, eq=False)
class Source:
    """A solvable scene, what is sensed before it is solved and after, and where to make other pictures."""

    arm: Arm
    task: Task
    scene: Scene
    start: Percept
    goal: Frame
    rng: np.random.Generator


def photograph(source: Source, task: Task, joints: np.ndarray, positions_m: dict[str, tuple[float, ...]]) -> Frame:
    """What the task's camera sees of an arm and things that were put in their places."""
    source.arm.set_up(task.workspace)
    source.arm.reset(joints, positions_m)
    frame = source.arm.sense().frame
    assert frame is not None
    return frame


def off_area(source: Source) -> Frame:
    scene = sample_rim(source.task, source.rng, from_m=OFF_AREA_M[0], to_m=OFF_AREA_M[1], name=aim_of(source.task))
    return photograph(source, source.task, *end_of(source.task, scene))


def aloft(source: Source) -> Frame:
    """The hand high in the air; of a task with an object, that without a hand at it."""
    joints, positions_m = end_of(source.task, source.scene)
    height_m = float(source.rng.uniform(*ALOFT_M))
    if source.task.workspace.has_object:
        return photograph(source, source.task, source.arm.home, {**positions_m, "object": (*positions_m["object"][:2], height_m)})
    x, y, _ = source.scene.positions_m["goal"]
    reach = joints_above(source.task, (x, y), height_m)
    return photograph(source, source.task, np.where(np.isfinite(reach), reach, joints - (0, 0.6, 0, 0)), positions_m)


def in_table(source: Source) -> Frame:
    """A hand that goes through the table."""
    joints, positions_m = end_of(source.task, source.scene)
    x, y, _ = source.scene.positions_m[aim_of(source.task)]
    deep = joints_above(source.task, (x, y), -BELOW_TABLE_M)
    return photograph(source, source.task, np.where(np.isfinite(deep), deep, joints + np.eye(len(joints))[1] * 0.4), positions_m)


def other_camera(source: Source) -> Frame:
    """The camera has gone round the table."""
    workspace = source.task.workspace
    turn, (x, y, z) = source.rng.choice((-1, 1)) * source.rng.uniform(*TURNED_RAD), workspace.camera.position_m
    middle_x, middle_y, _ = workspace.camera.target_m
    ahead, aside = x - middle_x, y - middle_y
    moved = middle_x + ahead * np.cos(turn) - aside * np.sin(turn), middle_y + ahead * np.sin(turn) + aside * np.cos(turn), z
    task = replace(source.task, workspace=replace(workspace, camera=replace(workspace.camera, position_m=moved)))  # pyright: ignore[reportArgumentType]
    return photograph(source, task, *end_of(source.task, source.scene))


def other_scene(source: Source) -> Frame:
    """The end of another task, on another table or with other things on it."""
    other = TASKS["reach" if source.task.name == "two-points" else "two-points"]
    camera = replace(other.workspace.camera, height=source.goal.shape[0], width=source.goal.shape[1])
    filmed = replace(other, workspace=replace(other.workspace, camera=camera))  # pyright: ignore[reportArgumentType]
    goal = sense_end(source.arm, filmed, other.sample(source.rng)).frame
    assert goal is not None
    return goal


def foreign_object(source: Source) -> Frame:
    """The end of the scene with a thing on the table that was not there: a dark cylinder, or a second light circle."""
    workspace = source.task.workspace
    joints, positions_m = end_of(source.task, source.scene)
    without = photograph(source, source.task, joints, positions_m)
    if workspace.has_object:
        workspace, name, height_m = replace(workspace, circles=(*workspace.circles, FOREIGN)), FOREIGN, 0.0
    else:
        workspace, name, height_m = replace(workspace, has_object=True), "object", 0.05
    task = replace(source.task, workspace=workspace)  # pyright: ignore[reportArgumentType]
    while True:
        spot = tuple(source.rng.uniform((0.2, -0.3), (0.65, 0.3)))
        if all(np.hypot(*np.subtract(spot, place[:2])) > 0.2 for place in source.scene.positions_m.values()):
            shown = photograph(source, task, joints, positions_m | {name: (*spot, height_m)})
            if (np.abs(shown.astype(int) - without) > DIFFERENT).any(-1).mean() >= SEEN:
                return shown


def mirrored(source: Source) -> Frame:
    """Left and right changed; of a table with nothing on it, where that shows another reach, top and bottom."""
    return source.goal[:, ::-1] if source.task.workspace.things else source.goal[::-1]


def no_arm(source: Source) -> Frame:
    """The end of the scene with an arm that has turned its back on the table, out of the picture."""
    joints, positions_m = end_of(source.task, source.scene)
    return photograph(source, source.task, np.concatenate([[BACKWARDS_RAD], joints[1:]]), positions_m)


def as_the_start(source: Source) -> Frame:
    assert source.start.frame is not None
    return source.start.frame


BENCH: dict[str, Callable[[Source], Frame]] = {
    "off the area": off_area,
    "aloft": aloft,
    "in the table": in_table,
    "other camera": other_camera,
    "other scene": other_scene,
    "black": lambda source: np.zeros_like(source.goal),
    "noise": lambda source: source.rng.integers(0, 256, source.goal.shape, dtype=np.uint8),
    "mirrored": mirrored,
    "rotated": lambda source: np.rot90(source.goal),
    "foreign object": foreign_object,
    "no arm": no_arm,
    "the start": as_the_start,
}
"""The twelve kinds that refusals are measured by."""


def shuffled(goal: Frame, rng: np.random.Generator) -> Frame:
    """The four quarters in another order."""
    lower, upper = goal[goal.shape[0] // 2 :], goal[: goal.shape[0] // 2]
    turned = (np.roll(half, goal.shape[1] // 2, axis=1) for half in (lower, upper))
    return np.concatenate(list(turned))


def occluded(goal: Frame, rng: np.random.Generator) -> Frame:
    """A grey bar before the picture, an eighth of it wide."""
    frame, width = goal.copy(), goal.shape[1] // 8
    left = int(rng.integers(0, goal.shape[1] - width))
    frame[:, left : left + width] = rng.integers(60, 200)
    return frame


def speck(goal: Frame, rng: np.random.Generator) -> Frame:
    """A small square, light or dark, somewhere."""
    frame, size = goal.copy(), max(1, goal.shape[0] // 12)
    row, column = (int(rng.integers(0, side - size)) for side in frame.shape[:2])
    frame[row : row + size, column : column + size] = rng.choice((10, 245))
    return frame


def zoomed(goal: Frame, rng: np.random.Generator) -> Frame:
    """The middle, larger by half."""
    rows, columns = (np.arange(size) * 2 // 3 + size // 6 for size in goal.shape[:2])
    return goal[rows][:, columns]


PRACTICE: dict[str, Callable[[Frame, np.random.Generator], Frame]] = {
    "negative": lambda goal, rng: 255 - goal,
    "shuffled": shuffled,
    "occluded": occluded,
    "speck": speck,
    "zoomed": zoomed,
    "faded": lambda goal, rng: (goal // 2 + 90).astype(np.uint8),  # half the contrast, lighter
    "shifted": lambda goal, rng: np.roll(goal, goal.shape[1] // 6, axis=1),
}
"""The kinds that are calibrated by, none of them among the twelve."""
