"""What whoever looks on does while the arm moves: the hand is pushed, the object is moved, or another goal is wanted."""

import threading
from http import HTTPStatus

import numpy as np
from jaxtyping import Float

from preimage.records import Percept
from preimage.robot.arm import OBJECT, OBJECT_HEIGHT_M, Arm
from preimage.robot.disturbances import change_goal, lead, shift_object
from preimage.robot.execution import Stage
from preimage.robot.kinematics import ACTIVE_JOINTS, forward_kinematics, inverse_kinematics
from preimage.robot.move_object import HALF_OPEN_M
from preimage.robot.task import is_inside_margin
from preimage.studio.problems import Refusal
from preimage.studio.table import Table, Touch

Seen = tuple[float, float]
"""A place on the picture: shares of its width from the left and of its height from the top."""


class Touches:
    """What was done since the last step ended; of each kind the last counts.

    Args:
        possible: what can be done on the table.
    """

    def __init__(self, possible: tuple[Touch, ...]) -> None:
        self._possible, self._lock = possible, threading.Lock()
        self._waiting: dict[Touch, Seen] = {}

    def add(self, kind: Touch, seen: Seen) -> None:
        """Something is to happen when the running step ends; Refusal where nothing of the kind can be done on this table."""
        if kind not in self._possible:
            raise Refusal(HTTPStatus.CONFLICT, f"on this table {kind} is nothing that can be done: choose {' or '.join(self._possible)}")
        with self._lock:
            self._waiting[kind] = seen

    def taken(self) -> list[tuple[Touch, Seen]]:
        """What waits, which is let go of."""
        with self._lock:
            waiting, self._waiting = self._waiting, {}
        return list(waiting.items())


def push(table: Table, arm: Arm, stage: Stage, seen: Seen) -> str:
    """The hand is led at its height to where the camera sees that place, tilted as it is; what happened, in words.

    Raises:
        ValueError: the arm does not get there.
    """
    joints = stage.true_joints.copy()
    _, shoulder, elbow, wrist = joints[: len(ACTIVE_JOINTS)]
    hand = forward_kinematics(joints[: len(ACTIVE_JOINTS)])
    place = place_of(table, seen, hand[2])
    led = inverse_kinematics(place, wrist - shoulder + elbow)
    if np.isnan(led).any():
        raise ValueError("the arm does not get there: push it less far")
    joints[: len(ACTIVE_JOINTS)] = led
    lead(arm, stage, joints)
    return f"the hand was pushed {100 * np.linalg.norm(place - hand):.0f} cm aside"


def move_object(table: Table, arm: Arm, stage: Stage, seen: Seen) -> str:
    """The object stands where the camera sees that place of the table; what happened, in words.

    Raises:
        ValueError: it is beside the table, or the hand holds the object.
    """
    truth = arm.ground_truth()
    assert truth.object_m is not None, "only tasks with an object offer to move it"
    if truth.gripper_m < HALF_OPEN_M:
        raise ValueError("the hand holds the object: move it before it is grasped")
    place = place_of(table, seen, OBJECT_HEIGHT_M / 2)
    by_m = (place - truth.object_m)[:2]
    shift_object(arm, stage, by_m)
    return f"the {OBJECT} was moved by {100 * np.linalg.norm(by_m):.0f} cm"


def want(table: Table, stage: Stage, seen: Seen) -> tuple[Percept, str]:
    """Another goal for the judge; what would be sensed there, and what happened, in words.

    Raises:
        ValueError: the arm does not get there.
    """
    there = table.with_goal_at(stage.scene, seen)
    change_goal(stage, there.positions_m[table.goal_name])
    return Percept(table.goal(there).frame), "another goal is wanted"


def place_of(table: Table, seen: Seen, height_m: float) -> Float[np.ndarray, " 3"]:
    """The place at a height (m) that is seen there; ValueError where that is beside the table."""
    place = table.camera.place_at(np.array(seen), height_m)
    if place is None or not is_inside_margin(place[:2], table.task.workspace.table_size_m, 0.0):
        raise ValueError("that is beside the table")
    return place
