"""Rotation vectors that leap: r, and r less a full turn along itself, are the same attitude, and near half a turn a robot goes over.

The rx, ry, rz of UR arms are an axis times the angle about it, between 0 and half a turn; a tool that points down is always near half a
turn. Each reading is taken as the equal one that is nearest to the one before, the first of an episode nearest to a pole.

>>> turned = np.linspace(2.9, 3.4, 11)[:, None] * np.array([[0.8, 0.6, 0.0]])
>>> leapt = np.where(np.linalg.norm(turned, axis=1, keepdims=True) > np.pi, turned - 2 * np.pi * np.array([[0.8, 0.6, 0.0]]), turned)
>>> names = ("rx", "ry", "rz")
>>> (found,) = find_rotation_vectors([leapt, turned[:4]], names)
>>> found.episodes, bool(np.allclose(found.follow(leapt), turned))
((0,), True)
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from preimage.data.angles import LEAST_RESIDUAL, by_number
from preimage.data.clocks import words_of

NUM_PARTS = 3
TURNS = 2 * np.pi, 360.0
"""A full turn in radians and in degrees."""
BEYOND_HALF = 1.01
"""Half turns that no reading exceeds: the digits of a recorder."""
AS_WELL = 0.5
"""Share of what is left of a leap if angles wrap one by one, below which a rotation vector explains it better; one called so need not."""
OTHER_SIDE = 0.25
"""Share of a turn that two starts, more than half a turn apart as recorded, are apart at most once both are taken on one side."""
PARTS = {"rx", "ry", "rz"}
WORDS = ("rotvec", "rotation", "axisangle")
"""What the names of a rotation vector end, or begin, with."""

Vector = Float[np.ndarray, "3"]


@dataclass(frozen=True)
class RotationVector:
    """Three columns that are one (`data.attitudes`)."""

    LEAPS: ClassVar[str] = "a rotation vector, which leaps near half a turn without turning"
    FOLLOWED: ClassVar[str] = "it is followed"
    columns: tuple[str, ...]
    turn: float
    """A full turn in its unit."""
    pole: tuple[float, ...]
    """The first reading of an episode is taken as the equal one that is nearest to this one."""
    episodes: tuple[int, ...] = field(default=(), compare=False)
    """Those in which a reading is changed by it."""

    def follow(self, readings: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3"]:
        """The readings, each as the equal one that is nearest to the one before."""
        return _follow(readings, self.turn, np.array(self.pole))


def find_rotation_vectors(
    recordings: Sequence[Float[np.ndarray, "_T J"]], names: Sequence[str], *, episodes: Sequence[int] | None = None
) -> list[RotationVector]:
    """The rotation vectors that leap, within an episode or, where they are called so, between two.

    Args:
        episodes: numbers of the recordings; by default they are counted from 0.
    """
    whole = by_number(recordings, episodes)
    found: list[RotationVector] = []
    for begin, turn in _places(list(whole.values()), names) if whole else ():
        columns = slice(begin, begin + NUM_PARTS)
        readings = {number: joints[:, columns] for number, joints in whole.items()}
        pole = _pole(list(readings.values()), turn)
        changed = [number for number, each in readings.items() if not np.array_equal(_follow(each, turn, pole), each)]
        found.append(RotationVector(tuple(names[columns]), turn, tuple(pole.tolist()), tuple(changed)))
    return found


def _places(recordings: Sequence[Float[np.ndarray, "_T J"]], names: Sequence[str]) -> list[tuple[int, float]]:
    """The first column of each rotation vector, and a full turn; of two that overlap that which leaves less of the leaps."""
    candidates = []
    for begin in range(len(names) - NUM_PARTS + 1):
        readings = [joints[:, begin : begin + NUM_PARTS] for joints in recordings]
        turn = next((turn for turn in TURNS if _leaps(readings, turn, names[begin : begin + NUM_PARTS])), None)
        if turn is not None:
            candidates.append((_left_around(recordings, begin, turn), begin, turn))
    chosen: list[tuple[int, float]] = []
    for _, begin, turn in sorted(candidates):
        if all(abs(begin - other) >= NUM_PARTS for other, _ in chosen):
            chosen.append((begin, turn))
    return sorted(chosen)


def _left_around(recordings: Sequence[Float[np.ndarray, "_T J"]], begin: int, turn: float) -> float:
    """What is left of the leaps of a rotation vector, in its columns and in those that overlapping ones would have, on average."""
    around = slice(max(0, begin - NUM_PARTS + 1), begin + 2 * NUM_PARTS - 1)
    columns = slice(begin - around.start, begin - around.start + NUM_PARTS)
    left = []
    for joints in recordings:
        near = joints[:, around]
        for step in _leaping_steps(near[:, columns], turn):
            before, after = near[step], near[step + 1].copy()
            after[columns] = _nearest(after[columns], before[columns], turn)
            left.append(float(np.linalg.norm(after - before)))
    return float(np.mean(left)) if left else 0.0


def _leaps(readings: Sequence[Float[np.ndarray, "_T 3"]], turn: float, names: Sequence[str]) -> bool:
    """Whether these are rotation vectors and leap: each leap leads to where a small turn leads too."""
    joined = np.concatenate(readings)
    if not np.isfinite(joined).all() or not turn / 4 < np.linalg.norm(joined, axis=1).max() <= BEYOND_HALF * turn / 2:
        return False
    words = [words_of(name) for name in names]
    called_so = [bool(each) and (each[-1] in PARTS or "".join(each).startswith(WORDS)) for each in words]
    if any(called_so) and not all(called_so):
        return False
    named = all(called_so)
    leaps = [*_far_apart(readings, turn)]
    left = np.array([np.linalg.norm(_nearest(after, before, turn) - before) for before, after in leaps])
    if not (left <= LEAST_RESIDUAL * turn).all():
        return False
    if named:
        return bool(leaps) or _starts_on_both_sides(readings, turn)
    steps = np.array([after - before for before, after in leaps]).reshape(-1, NUM_PARTS)
    if_angles = np.linalg.norm(steps - turn * np.round(steps / turn), axis=1)
    return bool((left < AS_WELL * if_angles).any())


def _far_apart(readings: Sequence[Float[np.ndarray, "_T 3"]], turn: float) -> Iterator[tuple[Vector, Vector]]:
    for each in readings:
        for step in _leaping_steps(each, turn):
            yield each[step], each[step + 1]


def _leaping_steps(readings: Float[np.ndarray, "T 3"], turn: float) -> Int[np.ndarray, " _"]:
    """The steps from which it is more than half a turn to the next."""
    return np.flatnonzero(np.linalg.norm(np.diff(readings, axis=0), axis=1) > turn / 2)


def _starts_on_both_sides(readings: Sequence[Float[np.ndarray, "_T 3"]], turn: float) -> bool:
    starts = np.array([each[0] for each in readings])
    others = starts[np.linalg.norm(starts - starts[0], axis=1) > turn / 2]
    return any(np.linalg.norm(_nearest(other, starts[0], turn) - starts[0]) <= OTHER_SIDE * turn for other in others)


def _nearest(reading: Vector, other: Vector, turn: float) -> Vector:
    """Of the vectors that mean the same attitude that which is nearest to another one."""
    angle = float(np.linalg.norm(reading))
    if angle == 0:
        return reading
    axis = reading / angle
    turns = np.round(float((other - reading) @ axis) / turn)
    return reading + turns * turn * axis if turns else reading


def _follow(readings: Float[np.ndarray, "T 3"], turn: float, pole: Vector) -> Float[np.ndarray, "T 3"]:
    way, before = np.empty_like(readings), pole
    for step, reading in enumerate(readings):
        way[step] = before = _nearest(reading, before, turn)
    return way


def _pole(readings: Sequence[Float[np.ndarray, "_T 3"]], turn: float) -> Vector:
    """The median start, on the side of half a turn on which most readings stay as they are."""
    starts = np.array([each[0] for each in readings])
    main = np.linalg.eigh(starts.T @ starts)[1][:, -1] * turn / 2
    poles = [np.median([_nearest(start, side, turn) for start in starts], axis=0) for side in (main, -main)]
    changes = [sum(int((_follow(each, turn, pole) != each).any(1).sum()) for each in readings) for pole in poles]
    return poles[int(np.argmin(changes))]
