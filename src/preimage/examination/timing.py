"""Whether pictures and joints were taken at the same moments: no stale picture, no camera that lags, no wait at the start.

What changes in the picture from step to step goes up and down with the speed of the joints. Where it does so one step late, the camera was
read one step late, or its picture took that long to come.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from preimage.examination.findings import Finding, Kind, Severity, at_places, episodes_of, in_episodes, leaving_out
from preimage.examination.seen import Seen, divisors
from preimage.records import number_of

FIRST_STEPS = 3
"""Steps at the start among which pictures of the episode before are looked for: so many are left in a buffer."""
AT_REST = 0.5
"""Share of an episode's top speed that the joints stay below where a picture leaps by itself."""
SNAPS = 0.1
"""Share of a joint's span beyond which it goes no farther in one step: the arm makes a tenth, a gripper that snaps all of it."""
LAGS = range(-2, 7)
"""Steps by which the picture is tried to be late."""
LEAST_LATE_JOINTS = 2
"""Steps by which joints must be late: by one they seem to be where the hand leaves the picture before it rests."""
FOLLOWS = 0.2
"""Correlation that a late picture must reach: what changes in the picture is then the arm, as far as it can be seen."""
BLUNT_S = 0.03
"""Seconds by which the best correlation comes too early or too late in sound recordings, for the same turn changes less of the picture
here and more there: 0.03 s in g1-bottle, 0.02 s in recordings of the simulator and of a drawn arm at 10, 30 and 50 Hz."""
SURE = 4.0
"""Standard errors, over the episodes, by which it must correlate better late than on time."""
LEAST_EPISODES = 4
"""Episodes from which on such an error can be estimated."""
SETS_OUT = 0.05
"""Share of an episode's own way that a joint has gone when the rest at the start is over."""
LEAST_WAY = 0.02
"""Share of its span that a joint must go in an episode for its setting out to count."""
LONG_REST, LONG_REST_S = 0.4, 1.0
"""Share of an episode, and seconds, from which on a rest at the start is long: three times as long as hands need to set out."""


def stale(seen: Sequence[Seen]) -> Iterator[Finding]:
    """First pictures that show another moment: no later step changes the picture as much, and the joints hardly move."""
    scale = divisors(seen)
    places = [(one.index, step) for one in seen if (step := _stale_step(one, scale)) is not None]
    if places:
        what = f"the picture leaps after {at_places(places)} while the joints rest ({in_episodes(episodes_of(places))}): "
        what += "the first picture shows another moment, as where a camera's buffer was not emptied"
        help_ = f"drop the first picture and row of each episode, or {leaving_out(episodes_of(places))}"
        yield Finding(Kind.STALE, Severity.WARNING, what, help_, episodes_of(places), tuple(places))


def _stale_step(one: Seen, scale: Float[np.ndarray, " J"]) -> int | None:
    """The last step of an episode whose picture is stale; None where none is."""
    changes, speeds = one.changes_by_step, speeds_of(one, scale)
    if len(changes) <= FIRST_STEPS or len(speeds) != len(changes) or not speeds.any():
        return None
    step = int(changes[:FIRST_STEPS].argmax())
    leaps = changes[step] > changes[FIRST_STEPS:].max() and speeds[step] <= AT_REST * speeds.max()
    return step if leaps else None


def lag(seen: Sequence[Seen]) -> Iterator[Finding]:
    """A camera that is late in the whole set, or joints that are, by steps of the recording."""
    scale = divisors(seen)
    rows = []
    for one in (one for one in seen if one.sees):
        step = _stale_step(one, scale)
        begin = 0 if step is None else step + 1  # a stale first picture is no lag
        changes, speeds = one.changes_at_pace[begin:], speeds_of(one, scale, one.pace)[begin:]
        if _comparable(changes, speeds):
            rows.append([_correlation(changes, speeds, late) for late in LAGS])
    if len(rows) < LEAST_EPISODES:
        return
    by_lag = np.array(rows)  # (N, lags)
    best = int(by_lag.mean(0).argmax())
    late, gain = LAGS[best], by_lag[:, best] - by_lag[:, LAGS.index(0)]
    error = gain.std() / np.sqrt(len(gain))
    least, most = _bounds(by_lag.mean(0), best, BLUNT_S * seen[0].rate_hz)
    if (late >= 1 or late <= -LEAST_LATE_JOINTS) and least > 0 and by_lag[:, best].mean() >= FOLLOWS and gain.mean() > SURE * error:
        of_camera, of_joints = ("picture lags the joints", "pictures", "later"), ("joints lag the picture", "joints", "earlier")
        first, second, when = of_camera if late > 0 else of_joints
        steps = number_of(most, "step") if least == most else f"{least} to {most} steps"
        milliseconds = " to ".join(dict.fromkeys(f"{1000 * each / seen[0].rate_hz:.0f}" for each in (least, most)))
        what = f"the {first} by {steps} ({milliseconds} ms): what changes in the picture follows the joints' speed best so much {when} "
        what += f"(correlation {by_lag[:, best].mean():.2f}, on time {by_lag[:, LAGS.index(0)].mean():.2f})"
        help_ = f"shift the {second} forward by {steps}, or read the camera when the joints are read"
        yield Finding(Kind.LAG, Severity.WARNING, what, help_)


def _bounds(correlations: Float[np.ndarray, " lags"], best: int, blunt_steps: float) -> tuple[int, int]:
    """The least and the most whole steps, without sign, that the top of a parabola through the best three can mean; 0: none."""
    top = float(LAGS[best])
    if 0 < best < len(LAGS) - 1:
        before, at, after = correlations[best - 1 : best + 2].tolist()
        top += (before - after) / (2 * (before - 2 * at + after))
    least, most = math.ceil(abs(top) - blunt_steps), math.floor(abs(top) + blunt_steps)
    if abs(top) <= blunt_steps:
        return 0, 0
    return (max(1, least), max(1, most)) if least <= most else (round(abs(top)), round(abs(top)))


def waits(seen: Sequence[Seen]) -> Iterator[Finding]:
    scale = divisors(seen)
    rests = {one.index: _rest_steps(one, scale) for one in seen}
    long = [one for one in seen if rests[one.index] >= max(LONG_REST * one.num_steps, LONG_REST_S * one.rate_hz)]
    if long:
        steps = int(np.median([rests[one.index] for one in long]))
        what = f"{in_episodes((one.index for one in long), 'begin')} with a long rest: {steps} of "
        what += f"{np.median([one.num_steps for one in long]):.0f} steps ({steps / seen[0].rate_hz:.1f} s, median) before a joint moves"
        help_ = "cut it off, for a plan learns to wait as long"
        yield Finding(Kind.WAITS, Severity.WARNING, what, help_, tuple(one.index for one in long))


def speeds_of(one: Seen, scale: Float[np.ndarray, " J"], pace: int = 1) -> Float[np.ndarray, " steps"]:
    """How far all joints go in `pace` steps from each step on, in spans, root mean square; a gripper that snaps counts as a fast joint."""
    return np.sqrt(np.square(np.minimum(np.abs(one.joints[pace:] - one.joints[:-pace]) / scale, SNAPS)).mean(1))


def _rest_steps(one: Seen, scale: Float[np.ndarray, " J"]) -> int:
    """Steps until one of the joints that go anywhere has left its place; 0 where none does."""
    ways = np.ptp(one.joints, axis=0)
    away = np.abs(one.joints - one.joints[0]) > SETS_OUT * ways
    return int((away & (ways > LEAST_WAY * scale)).any(1).argmax())


def _comparable(changes: Float[np.ndarray, " a"], speeds: Float[np.ndarray, " b"]) -> bool:
    return len(changes) == len(speeds) >= 2 * len(LAGS) and bool(changes.std() > 0 and speeds.std() > 0)


def _correlation(changes: Float[np.ndarray, " steps"], speeds: Float[np.ndarray, " steps"], late: int) -> float:
    """Of the joints' speed with what changes in the picture so many steps later."""
    count = len(changes)
    changes, speeds = changes[max(late, 0) : count + min(late, 0)], speeds[max(-late, 0) : count + min(-late, 0)]
    changes, speeds = changes - changes.mean(), speeds - speeds.mean()
    norm = np.sqrt(np.square(changes).sum() * np.square(speeds).sum())
    return float((changes * speeds).sum() / norm) if norm > 0 else 0.0
