"""Episodes that were recorded otherwise than the rest: in another unit, with columns in another order, mirrored, or in BGR.

Each of them is a recording like any other, and only beside the others it is seen to be none of theirs. What is compared is what hardly
changes between episodes: how far the joints go, where they start, and what stands in the picture at the start.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from jaxtyping import Float32, UInt8

from preimage.data.view import LONGEST
from preimage.examination.findings import Finding, Kind, Severity, in_episodes, leaving_out
from preimage.examination.seen import Recorded, wide_spans

UNITS = {180 / np.pi: "degrees beside radians", 100.0: "hundredths beside ones", 1000.0: "thousandths beside ones"}
"""How many times as large the same angle or way is in the smaller unit."""
UNIT_WITHIN = 2.0
"""A joint that is as large as another unit makes it is so to this factor, and one that is in the same unit too, medians compared."""
APART = 4.0
"""Times that the smallest of the larger episodes must be larger than the largest of the others: sound ones spread by up to two."""
SAME_START = 0.02
"""Share of a joint's span within which two episodes start at one place."""
OTHER_START = 0.1
"""Share of its span by which a joint must start elsewhere for its column to be another one."""
MOST_ELSEWHERE = 0.1
"""Share of the episodes that may start anywhere else, or a start that happens to have the same numbers could be anybody's."""
UNLIKE, ALL_OVER = 4.0, 1 / 3
"""Grey levels by which a scene must differ from its mirror image, or from itself in other colours, and in which share of its pixels: what
looks alike both ways says nothing, and a thing that lies on the left in one episode and on the right in the next is no mirror."""
FITS = 0.5
"""Share of what a picture differs by as it is, which may be left of it the right way round."""
TWO_PLACES, MOST_COMPARED = 5.0, 20
"""Times the scatter about two places that lie that far apart, and episodes at each of them that are compared."""
AS_ALIKE, NOISE = 1.1, 0.2
"""How many times as much as those of one group, and how many grey levels besides, the pictures of two may differ: a compressor's noise,
averaged over blocks."""
LEAST_EPISODES = 3
"""Of two nobody can say which is the odd one."""


def recorded_otherwise(seen: Sequence[Recorded]) -> Iterator[Finding]:
    """What some episodes have otherwise than the rest."""
    if len(seen) >= LEAST_EPISODES:
        yield from another_unit(seen)
        yield from another_order(seen)
        yield from other_pictures(seen)


def another_unit(seen: Sequence[Recorded]) -> Iterator[Finding]:
    """Most joints of some episodes are as many times as large as another unit makes them, and the others as large as elsewhere."""
    sizes = np.array([np.abs(one.joints).max(0) for one in seen])  # (N, J)
    sizes = sizes[:, (sizes > 0).all(0) & (np.ptp(np.concatenate([one.joints for one in seen]), axis=0) > 0)]
    if not sizes.size:
        return
    size = np.exp(np.log(sizes).mean(1))  # (N,)
    order = np.argsort(size)
    gaps = size[order][1:] / size[order][:-1]
    small, large = np.split(order, [int(gaps.argmax()) + 1])
    ratios = np.median(sizes[large], axis=0) / np.median(sizes[small], axis=0)  # (J,)
    for factor, what in UNITS.items():
        scaled, same = ((ratios > each / UNIT_WITHIN) & (ratios < each * UNIT_WITHIN) for each in (factor, 1.0))
        if scaled.sum() > same.sum() and (scaled | same).all() and gaps.max() > APART ** (scaled.sum() / len(ratios)):
            odd, are = (large, "larger") if len(large) <= len(small) else (small, "smaller")
            episodes = sorted(seen[place].index for place in odd)
            times = np.median(ratios[scaled])
            said = f"the joints of {in_episodes(episodes)} are about {times:.0f} times {are} than those of the others: {what}"
            yield _finding(said, f"convert them to one unit, or {leaving_out(episodes)}", episodes)
            return


def another_order(seen: Sequence[Recorded]) -> Iterator[Finding]:
    """Some episodes start with the very numbers that the others start with, in other columns."""
    span = wide_spans(seen)
    starts = np.array([one.joints[0] for one in seen])  # (N, J)
    apart = np.abs(starts[:, None] - starts[None]) / span  # (N, N, J)
    alike = np.all(apart < SAME_START, axis=-1)
    usual = int(alike.sum(1).argmax())
    widest = span[np.isfinite(span)].max(initial=0)
    permuted = np.all(np.abs(np.sort(starts) - np.sort(starts[usual])) < SAME_START * widest, axis=-1)
    odd = permuted & ~alike[usual] & (apart[usual].max(-1) > OTHER_START)
    if odd.any() and odd.sum() < alike[usual].sum() and (~odd & ~alike[usual]).mean() <= MOST_ELSEWHERE:
        episodes = [seen[place].index for place in np.flatnonzero(odd).tolist()]
        names = seen[0].joint_names
        moved = [names[column] for column in np.flatnonzero((apart[usual][odd] > OTHER_START).any(0))]
        said = f"{in_episodes(episodes, 'start')} with the numbers of the others in other columns "
        yield _finding(said + f"({', '.join(moved)})", f"put the columns in one order, or {leaving_out(episodes)}", episodes)


def backwards(seen: Sequence[Recorded]) -> Iterator[Finding]:
    """Some episodes end where all others start, and start elsewhere: a recording was turned round.

    No fault, for they may show the way back.
    """
    span = wide_spans(seen)
    starts, ends = (np.array([one.joints[place] for one in seen]) for place in (0, -1))
    alike = np.all(np.abs(starts[:, None] - starts[None]) < SAME_START * span, axis=-1)
    usual = int(alike.sum(1).argmax())
    ends_there = np.all(np.abs(ends - starts[usual]) < SAME_START * span, axis=-1)
    odd = ends_there & (np.abs(starts - starts[usual]) > OTHER_START * span).any(1)
    if odd.any() and alike[usual].sum() >= LEAST_EPISODES and not (ends_there & alike[usual]).any():
        episodes = [seen[place].index for place in np.flatnonzero(odd).tolist()]
        what = f"{in_episodes(episodes, 'end')} where the others start, and start elsewhere, as if played backwards"
        help_ = f"turn their pictures and rows round, or {leaving_out(episodes)}"
        yield Finding(Kind.BACKWARDS, Severity.WARNING, what, help_, tuple(episodes))


def another_zero(seen: Sequence[Recorded]) -> Iterator[Finding]:
    """Some episodes start with one joint at another number, and the picture is the same: the arm was calibrated anew in between.

    No fault, for the joint may be one that the picture does not show.
    """
    if len(seen) < LEAST_EPISODES:
        return
    names, starts = seen[0].joint_names, np.array([one.joints[0] for one in seen])  # (N, J)
    span = wide_spans(seen)
    for joint, name in enumerate(names):
        order = np.argsort(starts[:, joint])
        gaps = np.diff(starts[order, joint])
        split = int(gaps.argmax()) + 1
        groups = order[:split], order[split:]
        scatter = max(float(np.ptp(starts[group], axis=0)[joint]) for group in groups)
        others = np.abs(np.diff([np.median(starts[group], axis=0) for group in groups], axis=0)[0]) / span
        others[joint] = 0
        clear = gaps.max() > max(OTHER_START * span[joint], TWO_PLACES * scatter) and others.max() < SAME_START
        if clear and _look_alike(seen, *groups):
            odd, rest = sorted(groups, key=len)
            episodes = sorted(seen[place].index for place in odd)
            at, usual = (float(np.median(starts[group, joint])) for group in (odd, rest))
            what = (
                f"{in_episodes(episodes, 'start')} with {name} at {at:.3g} where the others have {usual:.3g}, and the picture is the same"
            )
            help_ = f"look whether it was calibrated anew in between; where it was, {leaving_out(episodes)}"
            yield Finding(Kind.ZERO, Severity.WARNING, what, help_, tuple(episodes), joints=(name,))


def _look_alike(seen: Sequence[Recorded], some: np.ndarray, others: np.ndarray) -> bool:
    """Whether the first pictures of two groups differ no more from one another than within the larger group."""
    larger, smaller = (list(group[:MOST_COMPARED]) for group in sorted((some, others), key=len, reverse=True))
    first = {place: seen[place].first for place in (*larger, *smaller)}
    small = {place: _small(picture) for place, picture in first.items() if picture is not None}
    if len(small) < len(first) or len({each.shape for each in small.values()}) > 1 or len(larger) < LEAST_EPISODES:
        return False
    within = np.median([_unlike(small[a], small[b]) for a, b in itertools.combinations(larger, 2)])
    return bool(np.median([_unlike(small[a], small[b]) for a in larger for b in smaller]) <= AS_ALIKE * within + NOISE)


Turned = Callable[[Float32[np.ndarray, "h w c"]], Float32[np.ndarray, "h w c"]]

TURNS: dict[str, Turned] = {
    "mirrored": lambda picture: picture[:, ::-1],
    "upside down": lambda picture: picture[::-1, ::-1],
    "mirrored from top to bottom": lambda picture: picture[::-1],
    "with red and blue exchanged": lambda picture: picture[..., ::-1],
}
"""What is done to the pictures of a camera, or of a recorder, that was set otherwise."""


def other_pictures(seen: Sequence[Recorded]) -> Iterator[Finding]:
    """The first pictures of some episodes show what those of the others show, once they are turned."""
    seeing = [one for one in seen if one.first is not None]
    if len(seeing) < LEAST_EPISODES or len({one.first.shape for one in seeing if one.first is not None}) > 1:
        return
    firsts = np.array([_small(one.first) for one in seeing if one.first is not None])  # (N, h, w, c)
    for name, turn in TURNS.items():
        if name == "with red and blue exchanged" and firsts.shape[-1] != 3:
            continue
        turned = _turned_of(firsts, turn)
        if turned.any():
            odd = turned if turned.mean() <= 0.5 else ~turned
            episodes = [seeing[place].index for place in np.flatnonzero(odd)]
            said = f"the pictures of {in_episodes(episodes)} are {name} beside those of the others"
            yield _finding(said, f"turn them back, or {leaving_out(episodes)}", episodes)
            return


def _turned_of(firsts: Float32[np.ndarray, "N h w c"], turn: Turned) -> np.ndarray:
    """Which of the pictures are turned beside the first of them; none where a scene looks alike both ways.

    What lies elsewhere in each episode is left out of the scene by the median over the episodes.
    """
    back = np.array([turn(each) for each in firsts])
    nearer = np.array([_unlike(each, firsts[0]) for each in back]) < np.array([_unlike(each, firsts[0]) for each in firsts])
    scene = np.median(np.where(nearer[:, None, None, None], back, firsts), axis=0)
    left = np.array([_unlike(each, scene) for each in back])
    as_is = np.array([_unlike(each, scene) for each in firsts])
    turned, upright = left < FITS * as_is, as_is < FITS * left
    tells = (_apart(turn(scene), scene).mean(-1) > UNLIKE).mean() >= ALL_OVER
    sure = tells and (turned | upright).mean() >= 1 - MOST_ELSEWHERE and upright.any()
    return turned if sure else np.zeros(len(firsts), bool)


def _unlike(picture: Float32[np.ndarray, "h w c"], other: Float32[np.ndarray, "h w c"]) -> float:
    return float(_apart(picture, other).mean())


def _apart(picture: Float32[np.ndarray, "h w c"], other: Float32[np.ndarray, "h w c"]) -> Float32[np.ndarray, "h w c"]:
    """Difference in grey levels, beyond another light and another white balance: a gain of each channel."""
    gain = np.median(other, axis=(0, 1)) / np.maximum(np.median(picture, axis=(0, 1)), 1)
    return np.abs(gain * picture - other)


def _small(frame: UInt8[np.ndarray, "H W C"]) -> Float32[np.ndarray, "h w c"]:
    """The frame without depth, at most `LONGEST` pixels along its longer side, each the mean of a block."""
    block = max(1, -(-max(frame.shape[:2]) // LONGEST))
    height, width = (side // block for side in frame.shape[:2])
    colours = frame[: height * block, : width * block, :3]
    return colours.reshape(height, block, width, block, -1).mean((1, 3), dtype=np.float32)  # (h, w, c)


def _finding(what: str, help_: str, episodes: Sequence[int]) -> Finding:
    return Finding(Kind.OTHERWISE, Severity.FAULT, what, help_, tuple(episodes))
