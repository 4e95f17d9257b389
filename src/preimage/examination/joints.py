"""Whether the joints are angles an arm could have had: finite, in range, without glitches, and at rest where the goal is."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float

from preimage.data.joint_range import FULL_TURN_RAD
from preimage.examination.findings import Finding, Kind, Severity, at_places, episodes_of, leaving_out, of_joints
from preimage.examination.seen import Recorded, Seen, divisors, spans, wide_spans
from preimage.records import listed

SPIKE = 0.25
"""Share of a joint's span that it must leave its neighbours in time by: fast hands make a tenth, on a gripper a seventh."""
SPIKE_SPEEDS = 2.0
"""And that many times as far as it goes in one step when it is fast (its fastest hundredth of steps)."""
LEAP = 4.0
"""Times faster than every ordinary step: the fastest steps of a real hand differ from the next by up to two."""
LEAP_SHARE = 0.005
"""Glitches are rare: what happens in more than one of two hundred steps is how this joint moves, a gripper that snaps shut."""
FAR = 0.1
"""Share of a joint's span that it goes at once where a row of zeros begins or ends: the fastest hands go less in a step."""
REST = 0.25
"""Share of an episode's own top speed below which its end counts as rest: what a demonstrator's wobble and a let-go reach."""
STARTS = 0.05
"""Share of a joint's span by which starts may scatter (standard deviation): about the noise that plans have anyway."""


def not_finite(seen: Sequence[Seen]) -> Iterator[Finding]:
    places, joints = [], set()
    empty = _empty(seen)
    if empty.any():
        names = _named(seen, empty)
        what = of_joints(names, "holds no number anywhere; training leaves it out", "hold no number anywhere; training leaves them out")
        yield Finding(Kind.NOT_FINITE, Severity.NOTE, what, joints=names)
    for one in seen:
        steps, which = np.nonzero(~np.isfinite(one.recorded_joints) & ~empty)
        places += [(one.index, int(step)) for step in np.unique(steps)]
        joints |= {one.joint_names[joint] for joint in which}
    if places:
        names = tuple(sorted(joints))
        what = f"{of_joints(names, 'holds', 'hold')} no number at {at_places(places)}"
        episodes = episodes_of(places)
        help_ = leaving_out(episodes) if len(episodes) < len(seen) else "take these rows and their pictures out"
        yield Finding(Kind.NOT_FINITE, Severity.FAULT, what, help_, episodes, tuple(places), names)


def unrecorded(seen: Sequence[Recorded]) -> Iterator[Finding]:
    """Steps at which every joint is zero to the last digit, and left faster than the arm goes: nothing answered the recorder."""
    scale, places = wide_spans(seen), []
    if len(scale) < 2 or not np.isfinite(scale).any():
        return
    for one in seen:
        zero = (one.joints == 0).all(1)
        steps = (np.abs(np.diff(one.joints, axis=0)) / scale).max(1, initial=0)
        borders = zero[1:] != zero[:-1]
        if borders.any() and (steps[borders] > max(FAR, SPIKE_SPEEDS * np.median(steps))).all():
            places += [(one.index, int(step)) for step in np.flatnonzero(zero)]
    if places:
        episodes = episodes_of(places)
        what = f"all joints are zero at {at_places(places)}, far from where they are beside it: the robot did not answer there"
        help_ = f"take these rows and their pictures out, or {leaving_out(episodes)}"
        yield Finding(Kind.UNRECORDED, Severity.FAULT, what, help_, episodes, tuple(places))


def frozen(seen: Sequence[Seen]) -> Iterator[Finding]:
    still = ~np.isfinite(divisors(seen))
    names = _named(seen, still & ~_empty(seen))
    if still.all():
        yield Finding(Kind.FROZEN, Severity.FAULT, "no joint ever moves", "look whether the joints were recorded", joints=names)
    elif names:
        what = of_joints(
            names,
            "hardly moves within an episode; training leaves it out where it is",
            "hardly move within an episode; training leaves them out where they are",
        )
        what += " not named (--view.joints)"
        yield Finding(Kind.FROZEN, Severity.NOTE, what, joints=names)


def out_of_range(seen: Sequence[Seen]) -> Iterator[Finding]:
    """Joints beyond a full turn, where most joints of the set stay within one and so are in radians."""
    farthest = np.max([np.abs(one.joints).max(0) for one in seen], axis=0)
    beyond = farthest > FULL_TURN_RAD
    if beyond.any() and beyond.mean() < 0.5:
        names = _named(seen, beyond)
        what = f"{of_joints(names, 'goes', 'go')} to {farthest.max():.3g} while the others look like radians"
        episodes = tuple(one.index for one in seen if (np.abs(one.joints) > FULL_TURN_RAD).any())
        help_ = "look at the unit, and for an encoder that counts turns"
        yield Finding(Kind.RANGE, Severity.WARNING, what, help_, episodes, joints=names)


def jumps(seen: Sequence[Seen]) -> Iterator[Finding]:
    """Spikes of one step, and leaps far faster than anything else the joint does; both are the sensor and not the arm."""
    smooth = [_without_spikes(one.joints) for one in seen]
    speeds = np.concatenate([np.abs(np.diff(joints, axis=0)) for joints in smooth])
    span, fast = spans(seen), np.percentile(speeds, 99, axis=0)
    least = np.maximum(SPIKE * span, SPIKE_SPEEDS * fast) + 1e-9
    leap = np.maximum(_leap_speed(speeds), SPIKE * span)
    places, joints = [], np.zeros(len(span), bool)
    for one, smoothed in zip(seen, smooth, strict=True):
        strange = np.abs(one.joints - smoothed) > least  # (T, J)
        strange[1:] |= np.abs(np.diff(smoothed, axis=0)) >= leap
        joints |= strange.any(0)
        places += [(one.index, int(step)) for step in np.flatnonzero(strange.any(1))]
    if places:
        names, episodes = _named(seen, joints), episodes_of(places)
        what = f"{of_joints(names, 'jumps', 'jump')} at {at_places(places)}, far faster than anywhere else"
        help_ = f"{leaving_out(episodes)}, or look at the sensor's cable"
        yield Finding(Kind.JUMP, Severity.WARNING, what, help_, episodes, tuple(places), names)


def unrest(seen: Sequence[Seen]) -> Iterator[Finding]:
    scale, moving = divisors(seen), []
    for one in seen:
        speeds = np.linalg.norm(np.diff(one.joints, axis=0) / scale, axis=1)
        top = np.sort(speeds)[-3:].mean()
        if top > 0 and speeds[-2:].mean() > REST * top:
            moving.append(one.index)
    if moving:
        what = f"{len(moving)} of {len(seen)} episodes end while the robot moves ({listed(moving)})"
        help_ = "let the recording run on for a second after the goal is reached"
        yield Finding(Kind.UNREST, Severity.WARNING, what, help_, tuple(moving))


def starts(seen: Sequence[Seen]) -> Iterator[Finding]:
    scatter = np.std([one.joints[0] for one in seen], axis=0) / divisors(seen)
    apart = scatter > STARTS
    if apart.any():
        names = _named(seen, apart)
        what = f"start poses scatter by up to {100 * scatter.max():.0f} % of a joint's span ({_some(names)})"
        help_ = "say where a plan starts (--start): without it, it starts at the mean"
        yield Finding(Kind.STARTS, Severity.NOTE, what, help_, joints=names)


def _empty(seen: Sequence[Seen]) -> Bool[np.ndarray, " J"]:
    """The joints of which nothing was recorded, where there are others."""
    empty = np.all([np.isnan(one.recorded_joints).all(0) for one in seen], axis=0)
    return empty & ~empty.all()


def _without_spikes(joints: Float[np.ndarray, "T J"]) -> Float[np.ndarray, "T J"]:
    """Each value the median of itself and its two neighbours: steps and ramps stay as they are."""
    smooth = joints.copy()
    smooth[1:-1] = np.median([joints[:-2], joints[1:-1], joints[2:]], axis=0)
    return smooth


def _leap_speed(speeds: Float[np.ndarray, "steps J"]) -> Float[np.ndarray, " J"]:
    """The slowest of each joint's few fastest steps that stand `LEAP` times above all others; infinite where there are none."""
    few = max(2, int(LEAP_SHARE * len(speeds)))
    if len(speeds) <= few:
        return np.full(speeds.shape[1], np.inf)
    fastest = np.sort(speeds, axis=0)[::-1][: few + 1]
    stands_out = fastest[:-1] >= LEAP * fastest[1:]
    return np.where(stands_out & (fastest[:-1] > 0), fastest[:-1], np.inf).min(0)


def _named(seen: Sequence[Seen], chosen: np.ndarray) -> tuple[str, ...]:
    return tuple(name for name, here in zip(seen[0].joint_names, chosen, strict=True) if here)


def _some(names: Sequence[str], most: int = 4) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
