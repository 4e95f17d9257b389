"""Whether the recorder did its work: as many frames as joints, an even clock, episodes that are alike and neither cut off nor endless."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from preimage.data.summary import several_each
from preimage.examination.findings import Finding, Kind, Severity, at_places, episodes_of, in_episodes, leaving_out
from preimage.examination.seen import Seen
from preimage.records import number_of

LEAST_STEPS = 2
"""A start and a goal: fewer steps show no way from one to the other."""
UNUSUAL = 2.5
"""Times shorter or longer than the median episode: hands that do the same thing differ by up to two."""
DROPPED = 1.5
"""Ticks between two samples from which one must be missing: halfway to two."""
JITTER = 0.25
"""Ticks by which a sample may come early or late: the arm then has moved by a quarter of a step, about the noise of a good plan."""
RATE = 0.05
"""Share by which the measured rate may differ from the declared one: plans are executed that much too fast or too slow."""


def alike(seen: Sequence[Seen]) -> tuple[list[Seen], list[Finding]]:
    """The episodes that agree with most others in joints, rate and frame size, and a finding about the rest.

    Where no frame could be read no size is known, and none is held against the episode.
    """
    kinds = {one.index: (one.joint_names, one.rate_hz, one.shape) for one in seen if one.num_frames}
    usual = Counter(kinds.values()).most_common(1)
    others = [index for index, kind in kinds.items() if kind != usual[0][0]]
    if not others:
        return list(seen), []
    what = f"{in_episodes(others, 'differ')} from the others in frame size, rate or joints"
    found = Finding(Kind.UNLIKE, Severity.FAULT, what, f"record all with one setting, or {leaving_out(others)}", tuple(others))
    return [one for one in seen if one.index not in others], [found]


def unreadable(seen: Sequence[Seen]) -> Iterator[Finding]:
    broken = [one for one in seen if one.unreadable]
    if broken:
        count = sum(len(one.unreadable) for one in broken)
        what = f"{in_episodes((one.index for one in broken), 'lack')} {number_of(count, 'part')}, the first: {broken[0].unreadable[0]}"
        episodes = tuple(one.index for one in broken)
        help_ = "mend them" if len(broken) == len(seen) else f"mend them, or {leaving_out(episodes)}"
        yield Finding(Kind.UNREADABLE, Severity.FAULT, what, help_, episodes)


def lengths(seen: Sequence[Seen]) -> Iterator[Finding]:
    """Frames, rows of joints and the length in the index must be one number, where all of them could be read."""
    wrong = [one for one in seen if not one.unreadable and not one.num_frames == one.num_steps == one.declared_length]
    if not wrong:
        return
    worst = max(wrong, key=lambda one: abs(one.num_frames - one.num_steps))
    counts = f"{worst.num_frames} frames, {worst.num_steps} rows of joints, {worst.declared_length} in the index"
    counts += several_each(worst.num_frames, worst.num_steps)
    what = f"{in_episodes(one.index for one in wrong)} (episode {worst.index}: {counts})"
    again = "record these again" + (f" or {leaving_out(one.index for one in wrong)}" if len(wrong) < len(seen) else "")
    help_ = f"{again}: which frame belongs to which joints cannot be known"
    yield Finding(Kind.LENGTHS, Severity.FAULT, what, help_, tuple(one.index for one in wrong))


def durations(seen: Sequence[Seen]) -> Iterator[Finding]:
    few = [one for one in seen if min(one.num_steps, one.num_frames) < LEAST_STEPS]
    empty = [one.index for one in few if not one.unreadable]
    if empty:
        what = f"{in_episodes(empty, 'hold')} fewer than {LEAST_STEPS} steps"
        yield Finding(Kind.DURATION, Severity.FAULT, what, leaving_out(empty), tuple(empty))
    whole = [one for one in seen if one not in few]
    if not whole:
        return
    usual = float(np.median([one.num_steps for one in whole]))
    odd = {one.index: one.num_steps for one in whole if not usual / UNUSUAL <= one.num_steps <= usual * UNUSUAL}
    if odd:
        what = f"{in_episodes(odd, 'last')} {min(odd.values())} to {max(odd.values())} steps, the median is {usual:g}"
        yield Finding(Kind.DURATION, Severity.WARNING, what, "look whether they were cut off or left running", tuple(odd))


def clock(seen: Sequence[Seen]) -> Iterator[Finding]:
    with np.errstate(invalid="ignore", over="ignore"):
        ticks = {one.index: np.diff(one.timestamps_s) for one in seen if one.timestamps_s is not None and one.num_steps >= LEAST_STEPS}
    endless = _where(ticks, lambda gap: ~np.isfinite(gap))
    if endless:
        what = f"from one time stamp to the next is no finite time ({at_places(endless)})"
        yield Finding(
            Kind.CLOCK, Severity.WARNING, what, f"{leaving_out(episodes_of(endless))}, or record again with a clock", *_of(endless)
        )
    ticks = {episode: gaps for episode, gaps in ticks.items() if np.isfinite(gaps).all()}
    if not ticks:
        return
    tick, rate_hz = float(np.median(np.concatenate(list(ticks.values())))), seen[0].rate_hz
    if tick <= 0:
        yield Finding(Kind.CLOCK, Severity.WARNING, "the time stamps do not go on", "record again with a clock", tuple(ticks))
        return
    if abs(tick * rate_hz - 1) > RATE:
        yield Finding(Kind.CLOCK, Severity.WARNING, f"samples come at {1 / tick:.3g} Hz, declared are {rate_hz:g} Hz", "declare what it is")
    rates = {episode: 1 / float(np.median(gaps)) for episode, gaps in ticks.items() if np.median(gaps) > 0}
    others = {episode: rate for episode, rate in rates.items() if abs(rate * tick - 1) > JITTER}
    if others:
        what = f"samples of {in_episodes(others)} come at {' or '.join(sorted({f'{rate:.3g}' for rate in others.values()})[:2])} Hz, "
        what += f"of the others at {1 / tick:.3g} Hz"
        yield Finding(Kind.CLOCK, Severity.WARNING, what, f"{leaving_out(others)}, or record all at one rate", tuple(others))
    ticks = {episode: gaps for episode, gaps in ticks.items() if episode not in others}
    late = _where(ticks, lambda gap: gap > DROPPED * tick)
    if late:
        longest = max(float(gaps.max()) for gaps in ticks.values())
        what = f"{number_of(len(late), 'gap')} of up to {longest:.2g} s where a step takes {tick:.2g} s "
        what += f"({at_places(late)}): samples were dropped"
        yield Finding(Kind.CLOCK, Severity.WARNING, what, f"{leaving_out(episodes_of(late))}, or record with less load", *_of(late))
    uneven = _where(ticks, lambda gap: (np.abs(gap - tick) > JITTER * tick) & (gap <= DROPPED * tick))
    if uneven:
        comes = "sample comes" if len(uneven) == 1 else "samples come"
        what = f"{len(uneven)} {comes} more than {100 * JITTER:.0f} % of a step too early or late ({at_places(uneven)})"
        yield Finding(Kind.CLOCK, Severity.WARNING, what, "let the recorder wait for its clock", *_of(uneven))


Places = list[tuple[int, int]]


def _where(ticks: Mapping[int, Float[np.ndarray, " gaps"]], chosen: Callable[[np.ndarray], np.ndarray]) -> Places:
    """(episode, step) of the samples that come after the chosen gaps."""
    return [(episode, int(gap) + 1) for episode, gaps in ticks.items() for gap in np.flatnonzero(chosen(gaps))]


def _of(places: Places) -> tuple[tuple[int, ...], tuple[tuple[int, int], ...]]:
    return episodes_of(places), tuple(places)
