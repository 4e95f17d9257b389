"""Angles that wrap: an encoder that reads 179 degrees, then -179, has turned by 2 degrees and not by 358.

The readings of such a joint lie on a circle. Where the whole set leaves a gap on it, the circle is cut there: all readings then lie within
one turn, and two episodes, or a start alone, agree on where the joint stands. Where it leaves none, the starts may, and from its start each
episode is followed step by step.

>>> way = np.linspace(100.0, 200.0, 21)[:, None]
>>> readings = (way + 180) % 360 - 180
>>> (wrap,) = find_wraps([readings, readings[::-1]], ("wrist",))
>>> readings[-3:, 0].tolist(), unwrapped(readings, ("wrist",), [wrap])[-3:, 0].tolist()
([-170.0, -165.0, -160.0], [190.0, 195.0, 200.0])
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

TURNS = 360.0, 2 * np.pi, 4096.0
"""A full turn in degrees, in radians, and in the ticks of the encoders in most hobby servos."""
OTHER_TURNS = 180.0, np.pi, 1.0, 2.0, 200.0
"""Where wraps are rarer, and grippers that snap are as common: half a turn, as of a line or a symmetric tool; a turn that counts as one; a
turn normalised to -1 to 1, or to -100 to 100. Such a joint wraps if its leaps go against its way: what snaps just goes to the other end."""
ALL_ROUND = 0.75, 1.02
"""Readings that wrap go through this share of a turn and hardly more."""
BOTH_ENDS = 0.85
"""Share of a turn that they go through where no episode crosses the seam: both ends of the turn are then near it."""
APART = 1.5, 2.5
"""Turns that starts, and readings, go through where each episode was unwrapped by itself: those of another unit go farther."""
CROSSING = 0.75
"""Share of a turn by which a reading leaps where it wraps."""
PACES, LEAST_RESIDUAL = 2.0, 0.1
"""What is left of the leap beyond a turn is a step of the joint: at most so many times its fastest other step, or this share of a turn."""
LEAST_WAY = 0.002
"""Share of a turn that a joint goes in a step before it is said to be on its way: what trembles goes less."""
AROUND = 2
"""Steps before and after a leap that show which way a joint goes."""
LEAST_STEPS = 24
"""Steps of all episodes together from which on the way of a joint can be known."""
SMOOTH = 0.08
"""Share of a turn that at least half of the steps stay below: what goes to and fro faster is no way of a joint."""
DOUBTFUL = 0.4
"""Share of a turn in one step from which on nobody can say which way round it went."""
LEAST_GAP = 0.04
"""Share of a turn that must be free of readings for the circle to be cut there, and at least the fastest step."""
LEAST_GAP_OF_STARTS = 0.5
"""Share of a turn that must be free of starts: then each is nearer to the others one way round than the other."""

Readings = Sequence[Float[np.ndarray, " _T"]]


@dataclass(frozen=True)
class Wrap:
    """A joint whose readings wrap, and how they are unwrapped."""

    joint: str
    turn: float
    """A full turn in the unit of the joint."""
    seam: float
    """The first reading of an episode is taken within a turn above this one; those after it follow it."""
    episodes: tuple[int, ...] = field(default=(), compare=False)
    """Those that unwrapping changes."""
    impossible: str = field(default="", compare=False)
    """Why it cannot be unwrapped, as the end of a sentence; empty where it can."""


def find_wraps(
    recordings: Sequence[Float[np.ndarray, "_T J"]], names: Sequence[str], *, episodes: Sequence[int] | None = None
) -> list[Wrap]:
    """The joints whose readings wrap in one of the recordings, or between two.

    Args:
        episodes: numbers of the recordings; by default they are counted from 0.
    """
    whole = by_number(recordings, episodes)
    found = []
    for column, name in enumerate(names if whole else ()):
        readings = [joints[:, column] for joints in whole.values()]
        if (turn := _turn_of(readings)) is not None:
            found.append(_wrap(name, turn, readings, list(whole)))
    return found


def by_number(recordings: Sequence[Float[np.ndarray, "_T J"]], episodes: Sequence[int] | None) -> dict[int, Float[np.ndarray, "_T J"]]:
    """The recordings that hold a step, by the numbers of their episodes; None: they are counted from 0."""
    numbers = range(len(recordings)) if episodes is None else episodes
    return {number: joints for number, joints in zip(numbers, recordings, strict=True) if len(joints)}


def unwrapped(joints: Float[np.ndarray, "T J"], names: Sequence[str], wraps: Sequence[Wrap]) -> Float[np.ndarray, "T J"]:
    """The joints of an episode, or of one step, with those that wrap unwrapped."""
    if not wraps or not len(joints):
        return joints
    joints = joints.copy()
    for wrap in wraps:
        if wrap.joint in names and not wrap.impossible:
            column = list(names).index(wrap.joint)
            joints[:, column] = _follow(joints[:, column], wrap.turn, wrap.seam)
    return joints


def _follow(readings: Float[np.ndarray, " T"], turn: float, seam: float) -> Float[np.ndarray, " T"]:
    """Whole turns are added; no reading is changed by anything else."""
    shifts = turn * np.round((np.unwrap(readings, period=turn) - readings) / turn)
    return readings + shifts - turn * np.floor((readings[0] - seam) / turn)


def _turn_of(readings: Readings) -> float | None:
    """A full turn, if these readings wrap; None if they do not."""
    values = np.concatenate(readings)
    if not np.isfinite(values).all():
        return None
    span = float(np.ptp(values))
    steps = np.abs(np.concatenate([np.diff(each) for each in readings]))
    for turn in (*TURNS, *OTHER_TURNS):
        if len(steps) < LEAST_STEPS or np.median(steps) > SMOOTH * turn or span <= ALL_ROUND[0] * turn:
            continue
        if span <= ALL_ROUND[1] * turn:
            by_size = turn in TURNS and (_wraps_within(steps, turn) or _wraps_between(readings, steps, turn))
            found = by_size or (turn in OTHER_TURNS and _leaps_against_its_way(readings, turn))
        else:
            found = turn in TURNS and span <= APART[1] * turn and _starts_a_turn_apart(readings, steps, turn)
        if found:
            return turn
    return None


def _wraps_within(steps: Float[np.ndarray, " steps"], turn: float) -> bool:
    leaps, others = steps[steps > CROSSING * turn], steps[steps <= turn / 2]
    most = max(PACES * others.max(initial=0), LEAST_RESIDUAL * turn)
    return len(leaps) > 0 and bool((np.abs(turn - leaps) <= most).any())


def _leaps_against_its_way(readings: Readings, turn: float) -> bool:
    """Every leap of nearly a turn stands among steps that go the other way, one of them about as far as what is left of the turn."""
    against = []
    for steps in map(np.diff, readings):
        for place in np.flatnonzero(np.abs(steps) > CROSSING * turn):
            around = np.append(steps[max(place - AROUND, 0) : place], steps[place + 1 : place + 1 + AROUND])
            way, rest = -np.sign(steps[place]) * around, turn - abs(steps[place])
            fastest = way.max(initial=0)
            against.append((way >= 0).all() and fastest >= LEAST_WAY * turn and rest <= PACES * fastest)
    return bool(against) and all(against)


def _wraps_between(readings: Readings, steps: Float[np.ndarray, " steps"], turn: float) -> bool:
    """No episode crosses the seam, and they lie on either side of it: in between is more than half a turn that none is ever at."""
    ordered = np.sort(np.concatenate(readings))
    near = ordered[-1] - ordered[0] > BOTH_ENDS * turn
    return bool(near and np.diff(ordered).max() > turn / 2 and steps.max(initial=0) < turn / 2)


def _starts_a_turn_apart(readings: Readings, steps: Float[np.ndarray, " steps"], turn: float) -> bool:
    """Each episode was unwrapped by itself: their starts are in two places that are one place of the joint."""
    starts = np.sort([each[0] for each in readings])
    if len(starts) < 2 or steps.max(initial=0) > turn / 4 or np.diff(starts).max() < turn / 2 or np.ptp(starts) > APART[0] * turn:
        return False
    gap, _ = _largest_gap(starts, turn)
    return bool(gap > LEAST_GAP_OF_STARTS * turn and turn - gap < np.ptp(starts) / 4)


def _wrap(name: str, turn: float, readings: Readings, numbers: Sequence[int]) -> Wrap:
    steps = np.concatenate([np.diff(np.unwrap(each, period=turn)) for each in readings])
    followed = np.concatenate([np.unwrap(each, period=turn) for each in readings])
    fastest = float(np.abs(steps).max(initial=0))
    impossible = ""
    if fastest > DOUBTFUL * turn:
        place = next(
            (number, int(step) + 1)
            for number, each in zip(numbers, readings, strict=True)
            for step in np.flatnonzero(np.abs(np.diff(np.unwrap(each, period=turn))) > DOUBTFUL * turn)
        )
        impossible = f"goes about half a turn in one step (episode {place[0]} step {place[1]}), and which way round nobody can say"
    gap, middle = _largest_gap(followed, turn)
    if gap < max(LEAST_GAP * turn, fastest):
        gap, middle = _largest_gap(np.array([each[0] for each in readings]), turn)
        if gap < LEAST_GAP_OF_STARTS * turn:
            impossible = impossible or "starts and turns all the way round, so that no reading says which turn it belongs to"
    seam = _that_changes_least(readings, turn, middle)
    changed = [number for number, each in zip(numbers, readings, strict=True) if not np.array_equal(_follow(each, turn, seam), each)]
    return Wrap(name, turn, seam, tuple(changed), impossible)


def _largest_gap(values: Float[np.ndarray, " N"], turn: float) -> tuple[float, float]:
    """Length and middle of the longest arc of the circle that holds none of the values."""
    around = np.sort(values % turn)
    gaps = np.diff(np.append(around, around[0] + turn))
    longest = int(gaps.argmax())
    return float(gaps[longest]), float(around[longest] + gaps[longest] / 2)


def _that_changes_least(readings: Readings, turn: float, middle: float) -> float:
    """Of the seams a turn apart that with which most readings stay as they are."""
    seams = [middle + count * turn for count in (-2, -1, 0, 1)]
    changes = [sum(int((_follow(each, turn, seam) != each).sum()) for each in readings) for seam in seams]
    return float(seams[int(np.argmin(changes))])
