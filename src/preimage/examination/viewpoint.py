"""Whether the camera stood where it stood in the episode before.

Objects and arms move from episode to episode and the camera must not. So only the background is compared, where a pixel was steady in
both episodes, and one of two things must be true of a moved camera: the backgrounds fit clearly better once one of them is shifted a
little; or so much of the background is another one that no object that was put elsewhere explains it.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int

from preimage.examination.seen import CHANGE, Seen

STEADY = 10.0
"""Grey levels by which the middle half of a background pixel's values may spread: the noise of a camera, with room."""
LEAST_STEADY = 0.07
"""Share of the picture that must be steady in both episodes, or nothing can be said: a twelfth or so still holds edges to compare."""
SHIFTED_PX = 2.0
"""Pixels (of at most 64) by which a view must move: a steady camera, compared in this way, seems to move by up to one."""
REACH = 6
"""Pixels by which shifts are tried: a view that moved farther is another background altogether."""
EDGE = 6.0
"""Grey levels a pixel by which brightness must change to make an edge: what lies flat says nothing about shifts."""
MISFIT = 5.0
"""Grey levels by which edges in a part of the picture must differ from what is there later, on average: most of the weakest edge."""
EXPLAINED = 0.75
"""A shift speaks for a part of the picture if it leaves at most this share of the difference there."""
PARTS = 4
"""The picture has so many parts along each side: an object seldom spans more than two."""
LEAST_PARTS = 3
"""Parts that a shift must speak for; and twice as many as it speaks against, where the view fits worse with it."""
LEAST_EDGES = 6
"""Pixels of edges that a part needs to have a vote."""
ANOTHER = 4.0
"""Mean difference of the backgrounds in grey levels, each pixel counted up to `CHANGE`, from which they can be different backgrounds: a
fifth of the steady picture has changed."""
ALL_OVER = 0.7
"""And share of the parts in which edges must misfit for it: arms and objects that rest elsewhere reached 0.7 once in 480 pairs."""


@dataclass(frozen=True)
class CameraMove:
    """The camera moved between two neighbouring episodes."""

    before: int
    after: int
    difference: float
    """Mean difference of the backgrounds (grey levels)."""
    shift: tuple[int, int] | None
    """By how many pixels the view moved down and right, in a picture of at most 64; None where no shift explains the difference."""


def camera_moves(seen: Sequence[Seen]) -> list[CameraMove]:
    """Every place in the order of recording at which the camera no longer stands where it stood."""
    seeing = [one for one in seen if one.sees]
    moves = [_compare(before, after) for before, after in itertools.pairwise(seeing)]
    return [move for move in moves if move is not None]


def stretches(seen: Sequence[Seen], moves: Sequence[CameraMove]) -> list[list[int]]:
    """The episodes that share a viewpoint, by their numbers, in the order of recording."""
    begun, found = {move.after for move in moves}, [[]]
    for one in seen:
        if one.index in begun:
            found.append([])
        found[-1].append(one.index)
    return found


def _compare(before: Seen, after: Seen) -> CameraMove | None:
    steady = (before.unsteady < STEADY) & (after.unsteady < STEADY)
    if min(steady.shape) < 2 or steady.mean() < LEAST_STEADY:  # in a row of pixels nothing has an edge
        return None
    difference = _difference(after.background - before.background, steady)
    shift = find_shift(before.background, after.background, steady)
    another = difference >= ANOTHER and misfitting(before.background, after.background, steady) >= ALL_OVER
    return CameraMove(before.index, after.index, difference, shift) if shift or another else None


def _difference(residual: Float32[np.ndarray, "*shape"], mask: Bool[np.ndarray, "*shape"]) -> float:
    """Mean of what differs beyond a change of brightness, each pixel counted up to `CHANGE`."""
    inside = residual[mask]
    return float(np.minimum(np.abs(inside - np.median(inside)), CHANGE).mean()) if inside.size else 0.0


def misfitting(one: Float32[np.ndarray, "h w"], other: Float32[np.ndarray, "h w"], steady: Bool[np.ndarray, "h w"]) -> float:
    """The share of the parts with edges, of either picture, in which the other one shows something else."""
    rows, columns = np.nonzero(steady & (np.maximum(_slope(one), _slope(other)) >= EDGE))
    residual = (other - one)[rows, columns]
    apart = np.minimum(np.abs(residual - np.median((other - one)[steady])), CHANGE)
    part = _part(rows, columns, one.shape)
    count, total = np.bincount(part, minlength=PARTS**2), np.bincount(part, apart, PARTS**2)
    judged = count >= LEAST_EDGES
    return float((total[judged] >= MISFIT * count[judged]).mean()) if judged.any() else 0.0


def _slope(picture: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    return np.hypot(*np.gradient(picture))


def _part(rows: Int[np.ndarray, " N"], columns: Int[np.ndarray, " N"], shape: tuple[int, ...]) -> Int[np.ndarray, " N"]:
    return rows * PARTS // shape[0] * PARTS + columns * PARTS // shape[1]


def find_shift(
    one: Float32[np.ndarray, "h w"], other: Float32[np.ndarray, "h w"], steady: Bool[np.ndarray, "h w"]
) -> tuple[int, int] | None:
    """By how many pixels (down, right) all that is steady in `one` lies elsewhere in `other`; None where nothing says that it does.

    Only edges are compared, for a bare table looks the same wherever it is shifted to, and every part of the picture has one vote, for
    an object that was put elsewhere moves edges in its own part and a camera moves them in all. (Phase correlation, which weighs the
    whole picture, follows the largest object.)
    """
    rows, columns = np.nonzero(steady & (_slope(one) >= EDGE))
    part = _part(rows, columns, one.shape)
    other = other - np.median((other - one)[steady])  # another brightness is no other place
    around, known = np.pad(other, REACH), np.pad(steady, REACH)
    misfit = np.minimum(np.abs(other - one), CHANGE)[rows, columns]
    best, most, votes = None, 0.0, (0, 0)
    for down, right in itertools.product(range(-REACH, REACH + 1), repeat=2):
        there = rows + REACH + down, columns + REACH + right
        weights = known[there].astype(np.float64)  # the same pixels are compared with and without the shift
        left = np.minimum(np.abs(around[there] - one[rows, columns]), CHANGE)
        count = np.bincount(part, weights, PARTS**2)
        judged = count >= LEAST_EDGES
        before = np.bincount(part, weights * misfit, PARTS**2)[judged] / count[judged]
        after = np.bincount(part, weights * left, PARTS**2)[judged] / count[judged]
        if (gain := float((before - after).sum())) > most:
            best, most = (down, right), gain
            votes = int(((before >= MISFIT) & (after <= EXPLAINED * before)).sum()), int((after > before + 1).sum())
    return best if best and votes[0] >= LEAST_PARTS and votes[0] > 2 * votes[1] and np.hypot(*best) >= SHIFTED_PX else None
