"""The first of the paper's two phases: a demonstrator guides the arm to a goal, unevenly, with detours, pauses and wobble.

>>> start, goal = np.zeros(4), np.full(4, 0.5)
>>> path = guide(np.random.default_rng(0), start, goal)
>>> bool(25 <= len(path) <= 60), np.allclose(path[0], start), np.allclose(path[-1], goal)
(True, True, True)
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from preimage.robot.kinematics import JOINT_LIMITS, VELOCITY_LIMITS, forward_kinematics

MIN_MOVING_STEPS = 15
"""Pauses are left out where they would leave fewer steps than this to move."""
PAUSE_CHANCES = (0.4, 0.4, 0.2)
"""Probabilities of no, one and two pauses."""
PAUSE_STEPS = (2, 5)
"""Shortest and longest pause."""
SPEED_SD = 0.35
"""Standard deviation of the speed about its mean, as a share of it."""
WOBBLE_SD = 0.006
"""Standard deviation of the slow wobble (rad)."""
STEPS_A_WOBBLE = 5
CLEARANCE_M = 0.015
"""A path that brings the end effector nearer to the table than this is not shown (m)."""
MAX_SPEED_SHARE = 0.95
"""A path that needs more than this share of a joint's largest speed is not shown."""
MAX_TRIES = 1000


@dataclass(frozen=True)
class MotionStyle:
    """How a demonstrator guides the arm to a place."""

    steps: tuple[int, int] = (25, 60)
    """Shortest and longest path, pauses and rest included."""
    rest_steps: int = 3
    """Steps at the goal after arriving."""
    detour_sd: float = 0.07
    """Standard deviation of the bump towards a via-point (rad)."""


def guide_safely(
    rng: np.random.Generator,
    start: Float[np.ndarray, " J"],
    goal: Float[np.ndarray, " J"],
    *,
    rate_hz: float,
    style: MotionStyle = MotionStyle(),
) -> Float[np.ndarray, "T J"]:
    """A demonstrated path (rad) that the arm can follow: inside the joint limits, above the table, nowhere too fast.

    Raises:
        ValueError: none was found, as start or goal are themselves too low or outside the limits.
    """
    return first_safe(lambda: guide(rng, start, goal, style), rate_hz=rate_hz)


def first_safe(make: Callable[[], Float[np.ndarray, "T J"]], *, rate_hz: float) -> Float[np.ndarray, "T J"]:
    """The first of the paths made that the arm can follow: inside the joint limits, above the table, nowhere too fast.

    Args:
        make: draws a path, another one at every call: joint angles (rad), the gripper behind them where there is one; NaN out of reach.

    Raises:
        ValueError: none was found.
    """
    for _ in range(MAX_TRIES):
        path = make()
        arm = path[:, : len(JOINT_LIMITS)]
        if _is_inside_limits(arm) and _is_above_table(arm) and _is_slow_enough(arm, rate_hz):
            return path
    raise ValueError(f"no safe way there in {MAX_TRIES} tries: the start or the goal is too low, or too far")


def guide(
    rng: np.random.Generator,
    start: Float[np.ndarray, " J"],
    goal: Float[np.ndarray, " J"],
    style: MotionStyle = MotionStyle(),
) -> Float[np.ndarray, "T J"]:
    """Joint angles (rad), step by step, of an arm that is guided from start to goal and rests there."""
    num_steps = int(rng.integers(*style.steps, endpoint=True))
    progress = timing(rng, num_steps, rest_steps=style.rest_steps)[:, None]
    still_at_ends = np.sin(np.pi * progress)
    straight = start + (goal - start) * progress
    return straight + still_at_ends * (_detour(rng, progress, len(goal)) * style.detour_sd + _wobble(rng, num_steps, len(goal)))


def timing(rng: np.random.Generator, num_steps: int, *, rest_steps: int) -> Float[np.ndarray, " T"]:
    """Share of the way done at each step, from 0 to 1: minimum jerk in a clock that runs unevenly and stops now and then."""
    pauses = _pauses(rng, num_steps - rest_steps)
    progress = minimum_jerk(_uneven_clock(rng, num_steps - rest_steps - sum(pauses)))
    for pause in pauses:
        at = int(rng.integers(3, len(progress) - 3))
        progress = np.insert(progress, at, np.full(pause, progress[at]))
    return np.concatenate([progress, np.ones(rest_steps)])


def minimum_jerk(time: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
    """The smoothest way from 0 to 1: 10 t^3 - 15 t^4 + 6 t^5 (Flash and Hogan 1985)."""
    return 10 * time**3 - 15 * time**4 + 6 * time**5


def _is_inside_limits(path: Float[np.ndarray, "T J"]) -> bool:
    lower, upper = JOINT_LIMITS.T
    return bool(((path >= lower) & (path <= upper)).all())


def _is_above_table(path: Float[np.ndarray, "T J"]) -> bool:
    return bool((forward_kinematics(path)[:, 2] > CLEARANCE_M).all())


def _is_slow_enough(path: Float[np.ndarray, "T J"], rate_hz: float) -> bool:
    speeds = np.abs(np.diff(path, axis=0)) * rate_hz
    return bool((speeds <= MAX_SPEED_SHARE * VELOCITY_LIMITS).all())


def _pauses(rng: np.random.Generator, num_steps: int) -> list[int]:
    """Lengths of the pauses, in steps."""
    num_pauses = int(rng.choice(len(PAUSE_CHANCES), p=PAUSE_CHANCES))
    pauses = rng.integers(*PAUSE_STEPS, size=num_pauses, endpoint=True).tolist()
    while num_steps - sum(pauses) < MIN_MOVING_STEPS:
        pauses.pop()
    return pauses


def _uneven_clock(rng: np.random.Generator, num_steps: int) -> Float[np.ndarray, " T"]:
    """Time from 0 to 1 at each step, running faster and slower."""
    speed = np.clip(1 + SPEED_SD * _smooth_noise(rng, num_steps, num_knots=5), 0.3, 2)
    time = np.concatenate([[0.0], np.cumsum(speed[:-1])])
    return time / time[-1]


def _detour(rng: np.random.Generator, progress: Float[np.ndarray, "T 1"], num_joints: int) -> Float[np.ndarray, "T J"]:
    """One bump, somewhere along the way, towards a via-point, in standard deviations of it."""
    middle, width = rng.uniform(0.3, 0.7), rng.uniform(0.18, 0.3)
    return rng.normal(size=num_joints) * np.exp(-(((progress - middle) / width) ** 2))


def _wobble(rng: np.random.Generator, num_steps: int, num_joints: int) -> Float[np.ndarray, "T J"]:
    """The unsteadiness of the demonstrator (rad)."""
    num_knots = max(4, num_steps // STEPS_A_WOBBLE)
    return WOBBLE_SD * np.stack([_smooth_noise(rng, num_steps, num_knots) for _ in range(num_joints)], axis=1)


def _smooth_noise(rng: np.random.Generator, num_steps: int, num_knots: int) -> Float[np.ndarray, " T"]:
    """Normal deviates at evenly spaced knots, joined by straight lines."""
    return np.interp(np.linspace(0, 1, num_steps), np.linspace(0, 1, num_knots), rng.normal(size=num_knots))
