"""Where the hand is for given joints, and which joints bring the hand to a place: both in closed form.

With joints 3, 5 and 7 held, joint 1 turns a plane about the base and joints 2, 4 and 6 are a planar arm in it. Joints to hand is a
sum of four rotated links; hand to joints is a triangle of shoulder, elbow and wrist once the tilt ("pitch") of the hand is chosen.

>>> joints = reaching_joints(np.array([0.4, 0.1, 0.03]))
>>> forward_kinematics(joints).round(6)
array([0.4 , 0.1 , 0.03])
>>> bool(np.isnan(reaching_joints(np.array([2.0, 0.0, 0.03]))).all())
True
"""

import numpy as np
from jaxtyping import Bool, Float

ACTIVE_JOINTS = ("joint1", "joint2", "joint4", "joint6")
"""The joints that move: yaw, shoulder, elbow, wrist."""
HELD_JOINTS = {"joint3": 0.0, "joint5": 0.0, "joint7": np.pi / 4}
"""The joints that stay, and where (rad)."""
JOINT_LIMITS = np.array([(-2.8973, 2.8973), (-1.7628, 1.7628), (-3.0718, -0.0698), (-0.0175, 3.7525)])
"""Smallest and largest angle of each moving joint (rad), as published for the Panda."""
VELOCITY_LIMITS = np.array([2.175, 2.175, 2.175, 2.61])
"""Largest speed of each moving joint (rad/s), as published for the Panda."""

HOME_M = np.array([0.2, 0.0, 0.3])
"""Where the end effector waits, pointing down, before a task (m)."""
BASE_M = np.array([-0.1, 0.0, 0.0])
"""The foot of the arm in the frame of the table (m)."""
SHOULDER_HEIGHT_M = 0.333
UPPER_ARM_M = 0.316
ELBOW_OFFSET_M = 0.0825
FOREARM_M = 0.384
WRIST_OFFSET_M = 0.088
HAND_M = 0.107 + 0.1034
"""From the wrist's flange axis down to the point between the finger tips (m)."""

LIMIT_MARGIN = 0.02
"""Inverse kinematics stays this far from the joint limits (rad)."""
PITCH_DISTANCES_M = (0.18, 0.20, 0.25, 0.30, 0.40, 0.60, 0.70, 0.75, 0.80, 0.85, 0.90)
PITCHES_DEG = (-36, -30, -16, -6, 0, 10, 20, 26, 34, 46, 50)
"""How the hand tilts outwards with the distance of its target from the base: chosen so that it reaches nearly all of the table."""
GRASP_PITCH_RAD = np.radians(15.0)
"""Tilt of the hand that grasps (rad): the same everywhere, so that fingers always meet the object alike."""

Numbers = float | np.ndarray
"""One number, or a batch of them."""


def forward_kinematics(joints: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 3"]:
    """The position of the end effector (m, frame of the table) at joint angles (rad)."""
    yaw, shoulder, elbow, wrist = np.moveaxis(joints, -1, 0)
    forearm = shoulder - elbow
    pitch = wrist - forearm
    radius, height = (
        _along(shoulder, UPPER_ARM_M, ELBOW_OFFSET_M)
        + _along(forearm, FOREARM_M, -ELBOW_OFFSET_M)
        + _along(np.pi - pitch, HAND_M, -WRIST_OFFSET_M)
    )
    return BASE_M + np.stack([radius * np.cos(yaw), radius * np.sin(yaw), SHOULDER_HEIGHT_M + height], axis=-1)


def inverse_kinematics(
    position_m: Float[np.ndarray, "*batch 3"],
    pitch_rad: float | Float[np.ndarray, "*batch"],
) -> Float[np.ndarray, "*batch 4"]:
    """The joint angles (rad), elbow up, that put the end effector there; NaN where the arm cannot.

    Args:
        position_m: where the end effector is to be, in the frame of the table (m).
        pitch_rad: tilt of the hand: 0 points straight down, positive outwards, away from the base (rad).
    """
    yaw, radius, height = _cylindrical(position_m)
    hand_radius, hand_height = _along(np.pi - pitch_rad, HAND_M, -WRIST_OFFSET_M)
    shoulder, elbow = _solve_triangle(radius - hand_radius, height - SHOULDER_HEIGHT_M - hand_height)
    joints = np.stack([yaw, shoulder, elbow, pitch_rad + shoulder - elbow], axis=-1)
    return np.where(_inside_limits(joints), joints, np.nan)


def reaching_joints(position_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 4"]:
    """The joint angles (rad) of a natural reach to a place (m), the hand tilting with its distance; NaN out of reach."""
    _, radius, _ = _cylindrical(position_m)
    return inverse_kinematics(position_m, np.radians(np.interp(radius, PITCH_DISTANCES_M, PITCHES_DEG)))


def grasping_joints(position_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 4"]:
    """The joint angles (rad) that bring the hand to a place (m) tilted as for a grasp; NaN out of reach."""
    return inverse_kinematics(position_m, GRASP_PITCH_RAD)


def to_polar(position_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Radius (m) and yaw (rad) as seen from the base, and height (m)."""
    yaw, radius, height = _cylindrical(position_m)
    return np.stack([radius, yaw, height], axis=-1)


def from_polar(polar: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """The position (m) at a radius (m) and yaw (rad) as seen from the base, and a height (m)."""
    radius, yaw, height = np.moveaxis(polar, -1, 0)
    return BASE_M + np.stack([radius * np.cos(yaw), radius * np.sin(yaw), height], axis=-1)


def home_joints() -> Float[np.ndarray, " 4"]:
    """The joint angles (rad) in which the arm waits before a task."""
    return inverse_kinematics(HOME_M, 0.0)


def _along(angle: Numbers, length_m: float, offset_m: float) -> np.ndarray:
    """(radius, height) of a link at an angle from upright, and of the offset that follows it at a right angle."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.stack([length_m * sine + offset_m * cosine, length_m * cosine - offset_m * sine])


def _cylindrical(position_m: np.ndarray) -> tuple[Numbers, Numbers, Numbers]:
    """Yaw (rad), radius and height (m) of a place as seen from the base."""
    x, y, z = np.moveaxis(position_m - BASE_M, -1, 0)
    return np.arctan2(y, x), np.hypot(x, y), z


def _solve_triangle(radius: Numbers, height: Numbers) -> tuple[Numbers, Numbers]:
    """Shoulder and elbow angles (rad) that put the wrist there, seen from the shoulder (m); NaN beyond the arm's length."""
    upper, fore = np.hypot(UPPER_ARM_M, ELBOW_OFFSET_M), np.hypot(FOREARM_M, ELBOW_OFFSET_M)
    bend_upper, bend_fore = np.arctan2(ELBOW_OFFSET_M, UPPER_ARM_M), np.arctan2(ELBOW_OFFSET_M, FOREARM_M)
    reach = np.hypot(radius, height)
    with np.errstate(invalid="ignore", divide="ignore"):
        elbow = np.arccos((upper**2 + fore**2 - reach**2) / (2 * upper * fore))
        lift = np.arccos((upper**2 + reach**2 - fore**2) / (2 * upper * reach))
    return np.arctan2(radius, height) - lift - bend_upper, elbow - np.pi - bend_upper - bend_fore


def _inside_limits(joints: Float[np.ndarray, "*batch 4"]) -> Bool[np.ndarray, "*batch 1"]:
    lower, upper = JOINT_LIMITS.T
    return ((joints >= lower + LIMIT_MARGIN) & (joints <= upper - LIMIT_MARGIN)).all(axis=-1, keepdims=True)
