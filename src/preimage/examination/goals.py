"""Where the episodes end: how far the goals lie apart says how much of the room they cover.

On a table of side 1, n goals strewn at random lie about 0.47 / sqrt(n) from their nearest neighbour and 0.51 from each other, in the
median. So the ratio of the two distances, whatever their unit, says how many goals on a table would lie as densely: 100 recordings of
reaching come out near 100, and a set that comes out below its number has wider gaps to bridge.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from preimage.examination.findings import Finding, Kind, Severity, in_episodes
from preimage.examination.seen import Seen, divisors
from preimage.examination.viewpoint import CameraMove, stretches
from preimage.records import number_of

SAME_JOINTS = 0.01
"""Share of a joint's span within which two goals are one: a tenth of the way between neighbours among a hundred."""
SAME_FRAME = 2.0
"""Grey levels (root mean square) within which two frames are one: less than the noise of most cameras."""

TOLD = 2 / 3
"""Share of the usual distance at which the joints of two alike goals must lie: a hundred goals on a table come to a fifth, 25 to a half."""
LEAST_TO_TELL = 20
"""Goals from one viewpoint, from which on it can be said: of fewer, the most alike are too unlike to tell anything."""


@dataclass(frozen=True)
class Spacing:
    """Distances between goals."""

    joints: Float[np.ndarray, "N N"]
    """Of the joint that differs most, in spans of that joint."""
    all_joints: Float[np.ndarray, "N N"]
    """Over all joints that move, root mean square, in spans."""
    frames: Float[np.ndarray, "N N"]
    """Root mean square of grey levels."""


def spacing(seen: Sequence[Seen]) -> Spacing:
    goals = np.stack([one.joints[-1] for one in seen]) / divisors(seen)  # (N, J)
    apart = np.abs(goals[:, None] - goals[None])  # (N, N, J)
    frames = np.stack([one.goal.ravel() for one in seen]).astype(np.float64)
    squares = (frames**2).mean(1)
    frames_apart = np.sqrt(np.maximum(squares[:, None] + squares[None] - 2 * frames @ frames.T / frames.shape[1], 0))
    return Spacing(apart.max(-1), np.sqrt((apart**2).mean(-1)), frames_apart)


def duplicates(seen: Sequence[Seen], apart: Spacing) -> Iterator[Finding]:
    same = np.triu((apart.joints < SAME_JOINTS) & (apart.frames < SAME_FRAME), 1)
    repeated = [seen[later].index for later in np.flatnonzero(same.any(0)).tolist()]
    if not repeated:
        return
    pairs = [f"{seen[a].index} and {seen[b].index}" for a, b in np.argwhere(same)[:4]]
    what = f"{in_episodes(repeated, 'end')} where an earlier one ends ({', '.join(pairs)}): "
    what += number_of(len(seen) - len(repeated), "different goal")
    yield Finding(Kind.DUPLICATES, Severity.WARNING, what, "spread the goals over the whole room", tuple(repeated))


def untold(seen: Sequence[Seen], moves: Sequence[CameraMove]) -> Iterator[Finding]:
    """Where the joints cannot be read from the last frames: those of the frame that is most alike are hardly nearer than any others."""
    shared = set(max(stretches(seen, moves), key=len))
    from_one_place = [one for one in seen if one.index in shared and one.sees]
    if len(from_one_place) < LEAST_TO_TELL:
        return
    apart, others = spacing(from_one_place), ~np.eye(len(from_one_place), dtype=bool)
    most_alike = np.where(others, apart.frames, np.inf).argmin(1)
    of_alike, of_any = apart.all_joints[np.arange(len(others)), most_alike].mean(), apart.all_joints[others].mean()
    if of_alike <= TOLD * of_any:
        return
    what = f"where two last frames are most alike, the joints lie {100 * of_alike / of_any:.0f} % as far apart as in any two (mean)"
    help_ = "let the last frame show the whole arm and nothing that changes by itself: what it does not show a plan has to guess"
    yield Finding(Kind.UNTOLD, Severity.WARNING, what, help_)


def coverage(seen: Sequence[Seen], apart: Spacing) -> Iterator[Finding]:
    if len(seen) < 3:
        return
    nearest, typical = nearest_and_typical(apart.all_joints)
    in_frames, _ = nearest_and_typical(apart.frames)
    if nearest <= 0 or typical <= 0:
        return
    as_dense = (0.47 / 0.51 * typical / nearest) ** 2
    what = f"the next goal lies {100 * nearest:.0f} % of the joints' span and {in_frames:.0f} grey levels away (median); "
    what += f"{len(seen)} goals lie as densely as {as_dense:.0f} strewn over a table"
    help_ = "more goals in between would help more than longer training" if as_dense < 25 else ""
    yield Finding(Kind.GOALS, Severity.NOTE, what, help_)


def nearest_and_typical(distances: Float[np.ndarray, "N N"]) -> tuple[float, float]:
    """The median distance to the nearest other, and the median distance of two."""
    others = np.where(np.eye(len(distances), dtype=bool), np.inf, distances)
    return float(np.median(others.min(1))), float(np.median(distances[np.triu_indices(len(distances), 1)]))
