"""Whether the camera saw: something, something new when the arm moved, from one place; and how large in the picture that is."""

from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np

from preimage.examination.findings import Finding, Kind, Severity, at_places, episodes_of, in_episodes, leaving_out
from preimage.examination.seen import SIDE, Seen, divisors
from preimage.examination.timing import speeds_of
from preimage.examination.viewpoint import CameraMove, stretches
from preimage.records import number_of

STUCK_TRAVEL = 0.1
"""Share of a joint's span that it moves under frames that stay the same in every bit: more than a resting arm wobbles."""
STUCK_FRAMES = 5
"""Frames in a row that are the same: fewer are a camera that is slower than the recording."""
STANDS, LEAPS = 0.25, 1.2
"""What changes in the picture in a step, in shares of what usually does while the joints go fast: below the first it stands, above the
second it leaps to where the arm is by now. In sound recordings, of which a gripper that snaps makes most, no picture that stood leaps."""
LOST_STEPS = 4
"""Steps that it stands for until it counts: five frames alike."""
FAST, LEAST_WAY = 0.5, 0.03
"""Share of the speed of the fastest twentieth of steps above which joints go fast, and of a joint's span that it must go meanwhile."""
SLOW_CAMERA, LONGER = 0.2, 2.5
"""A camera that is slower than the recording stands again and again, in more than this share of the fast steps; then only what stands so
many times longer than usual is lost."""
DARK = 64
"""What 14 bits of brightness come to in a file of 16; 12 bits come to 16, and 10 to 4."""
LIVELY = 0.02
"""Share of all frames in which a pixel must change to belong to what happens: less is a flicker."""
SMALL_PX = 6.0
"""What is smaller is hard to learn: two steps down the network's ladder leave less than two cells of it."""


def blank(seen: Sequence[Seen]) -> Iterator[Finding]:
    dark = [one for one in seen if one.blank.any()]
    if not dark:
        return
    episodes = tuple(one.index for one in dark)
    places = tuple((one.index, int(step)) for one in dark for step in np.flatnonzero(one.blank))
    if not any(one.sees for one in seen):
        help_ = "look whether the right camera was recorded"
        brightest = max(int(one.first.max()) for one in seen if one.first is not None)
        if 0 < brightest <= DARK:
            help_ += f", and whether it wrote fewer bits than its files have: the brightest pixel is {brightest} of 255"
        yield Finding(Kind.BLANK, Severity.FAULT, "no frame shows anything", help_, episodes, places)
    else:
        what = f"{in_episodes(episodes, 'hold')} {number_of(len(places), 'frame')} of one colour"
        yield Finding(Kind.BLANK, Severity.WARNING, what, leaving_out(episodes), episodes, places)


def stuck(seen: Sequence[Seen]) -> Iterator[Finding]:
    """Frames that stay the same in every bit while a joint moves; blank ones have a finding of their own."""
    scale = divisors(seen)
    places = [place for one in seen if one.sees for place in _stuck_at(one, scale)]
    episodes = episodes_of(places)
    if not places:
        return
    what = f"the frames stay the same while the arm moves, from {at_places(places)} on"
    if len(episodes) == len(seen):
        yield Finding(Kind.STUCK, Severity.FAULT, what, "look whether the camera was recorded at all", episodes, tuple(places))
    else:
        yield Finding(Kind.STUCK, Severity.WARNING, what, leaving_out(episodes), episodes, tuple(places))


def _stuck_at(one: Seen, scale: np.ndarray) -> Iterator[tuple[int, int]]:
    for same, run in groupby(range(len(one.same_as_before)), key=lambda step: bool(one.same_as_before[step])):
        steps = list(run)
        joints = one.joints[steps[0] : steps[-1] + 2]
        if same and len(steps) >= STUCK_FRAMES and len(joints) and (np.ptp(joints, axis=0) / scale).max() > STUCK_TRAVEL:
            yield one.index, steps[0]


def lost(seen: Sequence[Seen]) -> Iterator[Finding]:
    """A picture that stands for some frames while the arm moves, and then leaps to where it is."""
    scale = divisors(seen)
    changes, speeds = np.concatenate([one.changes_by_step for one in seen]), np.concatenate([speeds_of(one, scale) for one in seen])
    if len(changes) != len(speeds) or not speeds.any():
        return
    fast = speeds > FAST * np.quantile(speeds, 0.95)
    stood = [place for one in seen for place in _stood_and_leapt(one, scale, float(changes[fast].mean()))]
    steps = [count for *_, count in stood]
    least = max(LOST_STEPS, LONGER * np.median(steps)) if sum(steps) > SLOW_CAMERA * fast.sum() else LOST_STEPS
    told = {place for one in seen for place in _stuck_at(one, scale)}
    if places := [(episode, step) for episode, step, count in stood if count >= least and (episode, step) not in told]:
        longest, episodes = max(steps) + 1, episodes_of(places)
        what = f"the picture stands for up to {longest} frames while the arm moves, then leaps to where it is, from {at_places(places)} on"
        yield Finding(Kind.STUCK, Severity.WARNING, what, f"{leaving_out(episodes)}, or record with less load", episodes, tuple(places))


def _stood_and_leapt(one: Seen, scale: np.ndarray, usual: float) -> Iterator[tuple[int, int, int]]:
    """The episode, the step from which on its picture stands, and for how many steps."""
    changes = one.changes_by_step
    for still, run in groupby(range(len(changes)), key=lambda step: bool(changes[step] < STANDS * usual)):
        begin, *rest = run
        end = rest[-1] + 1 if rest else begin + 1
        goes = (np.ptp(one.joints[begin : end + 1], axis=0) / scale).max() > LEAST_WAY
        if still and goes and end < len(changes) and changes[end] > LEAPS * usual:
            yield one.index, begin, end - begin


def moved(seen: Sequence[Seen], moves: Sequence[CameraMove]) -> Iterator[Finding]:
    if not moves:
        return
    shared = max(stretches(seen, moves), key=len)
    between = ", ".join(f"{move.before} and {move.after}" for move in moves[:6])
    what = f"between episodes {between}{f' and {len(moves) - 6} more times' if len(moves) > 6 else ''}"
    what += f"; {len(shared)} of {len(seen)} episodes in a row share a viewpoint ({in_episodes(shared)})"
    help_ = "clamp the camera, and train on the episodes that share a viewpoint (--episodes)"
    yield Finding(Kind.MOVED, Severity.WARNING, what, help_, tuple(move.after for move in moves))


def scene(seen: Sequence[Seen]) -> Iterator[Finding]:
    """How much of the frame ever changes and how large what moves is, at the size a network sees."""
    seeing = [one for one in seen if one.sees]
    if not seeing:
        return
    lively = np.average([one.changes for one in seeing], axis=0, weights=[one.num_frames for one in seeing]) > LIVELY
    size_px = float(np.median([one.moving_px for one in seeing]))
    if not lively.any() or size_px == 0:
        yield Finding(Kind.SCENE, Severity.WARNING, "nothing in the picture ever changes", "look where the camera points")
        return
    rows, columns = np.flatnonzero(lively.any(1))[[0, -1]] + (0, 1), np.flatnonzero(lively.any(0))[[0, -1]] + (0, 1)
    height, width = lively.shape
    gain = max(height, width) / max(np.ptp(rows), np.ptp(columns))
    what = f"at {width} x {height} pixels {100 * lively.mean():.0f} % of the frame ever changes and what moves is {size_px:.0f} pixels wide"
    if gain > 1.1:
        (top, bottom), (left, right) = 100 * rows / height, 100 * columns / width
        what += f"; cropped to {top:.0f} to {bottom:.0f} % of the height and {left:.0f} to {right:.0f} % of the width it would be "
        what += f"{size_px * gain:.0f}"
    help_ = f"crop, move the camera closer, or train with more than {SIDE} pixels" if size_px < SMALL_PX else ""
    yield Finding(Kind.SCENE, Severity.NOTE, what, help_)
