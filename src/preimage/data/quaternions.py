"""Quaternions whose sign flips: q and -q are the same attitude of a hand, and a tracker may go from one to the other between two readings.

Four neighbouring columns whose squares add up to one at every step are a quaternion, whatever they are called and whichever part comes
first. All episodes begin on one side, that of a pole, and each reading is on the side of the one before.

>>> half = np.linspace(0.0, 0.6, 13)
>>> way = np.stack([np.sin(half), 0 * half, 0 * half, np.cos(half)], 1)
>>> flipped = np.where(np.arange(13)[:, None] < 6, way, -way)
>>> names = ("qx", "qy", "qz", "qw")
>>> (found,) = find_quaternions([way, flipped, way], names)
>>> found.episodes, bool(np.allclose(found.follow(flipped), way))
((1,), True)
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from preimage.data.angles import by_number
from preimage.data.clocks import words_of

NUM_PARTS = 4
OFF_ONE = 0.01
"""By which the squares may miss one: three digits of each part do. Four joints that are no quaternion miss it within a few steps."""
LEAST_PARTS_THAT_MOVE = 3
"""Of four that are not called a quaternion: cosine and sine of one angle beside two columns of zeros add up to one, too. Where both of
these change their sign at once they are one all the same."""
OPPOSITE = -0.9
"""Cosine of the angle between two readings of which one has the other's sign: no hand turns by so much in a step."""
PARTS = {"w", "x", "y", "z", "qw", "qx", "qy", "qz"}
WORDS = ("quat", "rot", "orientation", "attitude")
"""What the names of a quaternion begin with."""


@dataclass(frozen=True)
class Quaternion:
    """Four columns that are one (`data.attitudes`)."""

    LEAPS: ClassVar[str] = "a quaternion, which changes its sign without turning"
    FOLLOWED: ClassVar[str] = "it is kept on one side"
    columns: tuple[str, ...]
    pole: tuple[float, ...]
    """The first reading of an episode is taken on the side of this one, in the same order."""
    episodes: tuple[int, ...] = field(default=(), compare=False)
    """Those in which a sign is changed by it."""

    def follow(self, readings: Float[np.ndarray, "T 4"]) -> Float[np.ndarray, "T 4"]:
        """The readings, each with the sign by which it is on the side of the one before."""
        return readings * _signs(readings, np.array(self.pole))[:, None]


def find_quaternions(
    recordings: Sequence[Float[np.ndarray, "_T J"]], names: Sequence[str], *, episodes: Sequence[int] | None = None
) -> list[Quaternion]:
    """The quaternions among the columns.

    Args:
        episodes: numbers of the recordings; by default they are counted from 0.
    """
    whole = by_number(recordings, episodes)
    found: list[Quaternion] = []
    begin = 0
    while whole and begin + NUM_PARTS <= len(names):
        columns = slice(begin, begin + NUM_PARTS)
        readings = {number: joints[:, columns] for number, joints in whole.items()}
        if _is_quaternion(list(readings.values()), names[columns]):
            pole = _pole(list(readings.values()))
            changed = [number for number, each in readings.items() if (_signs(each, pole) < 0).any()]
            found.append(Quaternion(tuple(names[columns]), tuple(pole.tolist()), tuple(changed)))
            begin += NUM_PARTS - 1
        begin += 1
    return found


def _is_quaternion(recordings: Sequence[Float[np.ndarray, "_T 4"]], names: Sequence[str]) -> bool:
    readings = np.concatenate(recordings)
    if not np.isfinite(readings).all() or np.abs(np.square(readings).sum(1) - 1).max() > OFF_ONE:
        return False
    words = [words_of(name) for name in names]
    named = all(each and (each[-1] in PARTS or each[0].startswith(WORDS)) for each in words)
    move = int((np.ptp(readings, axis=0) > OFF_ONE).sum())
    flips = any((np.sum(each[1:] * each[:-1], axis=1) < OPPOSITE).any() for each in recordings)
    return named or move >= LEAST_PARTS_THAT_MOVE - flips


def _pole(readings: Sequence[Float[np.ndarray, "_T 4"]]) -> Float[np.ndarray, " 4"]:
    """The direction about which the starts lie, on the side on which most readings stay as they are."""
    starts = np.array([each[0] for each in readings])
    pole = np.linalg.eigh(starts.T @ starts)[1][:, -1]
    kept = sum(float(_signs(each, pole).sum()) for each in readings)
    return pole if kept >= 0 else -pole


def _signs(readings: Float[np.ndarray, "T 4"], pole: Float[np.ndarray, " 4"]) -> Float[np.ndarray, " T"]:
    """By what each reading is multiplied, 1 or -1."""
    follows = np.sum(readings * np.concatenate([pole[None], readings[:-1]]), axis=1)
    return np.cumprod(np.where(follows < 0, -1.0, 1.0))
