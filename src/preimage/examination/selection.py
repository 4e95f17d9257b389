"""What is to be learned, and from which episodes: one task, joints that are no clocks, and angles that were unwrapped."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from preimage.data.attitudes import is_followed
from preimage.data.clocks import is_clock
from preimage.data.quaternions import Quaternion
from preimage.data.questions import questions_about
from preimage.data.summary import cannot_unwrap, reads_past
from preimage.data.view import made_continuous, moving
from preimage.examination.findings import Finding, Kind, Severity, in_episodes, of_joints
from preimage.examination.seen import Seen
from preimage.records import listed, number_of

MOST_TASKS, MOST_ABSENT = 4, 1000
"""Tasks, and missing episodes, that are named."""


def clocks(seen: Sequence[Seen], *, chosen: bool) -> Iterator[Finding]:
    """Columns that are no joints; where the user has named the joints, they know."""
    names = seen[0].joint_names
    if chosen:
        return
    for question in questions_about(names, [one.joints for one in seen]):
        yield Finding(Kind.COUNTER, Severity.FAULT, question.what, question.help, joints=question.columns)
    if known := tuple(name for name in names if is_clock(name)):
        what = of_joints(known, "is a clock and no joint; training leaves it out", "are clocks and no joints; training leaves them out")
        yield Finding(Kind.COUNTER, Severity.NOTE, what, joints=known)


def unwrap(seen: Sequence[Seen], *, chosen: bool) -> tuple[list[Seen], list[Finding]]:
    """The episodes as training reads their joints (`made_continuous`), and a finding about each column that is read otherwise.

    A joint that cannot be unwrapped is a fault only where it is learned.

    Args:
        chosen: the user has named the joints: all of them are learned.
    """
    names, findings = seen[0].joint_names, []
    joints, attitudes, wraps = made_continuous([one.joints for one in seen], names, episodes=[one.index for one in seen])
    for each in (each for each in attitudes if each.episodes):
        kind = Kind.SIGN if isinstance(each, Quaternion) else Kind.LEAPS
        what = f"{is_followed(each, len(seen))}, in training too"
        findings.append(Finding(kind, Severity.NOTE, what, episodes=each.episodes, joints=each.columns))
    learned = {name for name, moves in zip(names, moving(joints, names), strict=True) if chosen or (moves and not is_clock(name))}
    for wrap in (wrap for wrap in wraps if wrap.joint in learned):
        if wrap.impossible:
            what, help_ = cannot_unwrap(wrap, [name for name in names if name != wrap.joint])
            findings.append(Finding(Kind.WRAPS, Severity.FAULT, what, help_, joints=(wrap.joint,)))
        elif wrap.episodes:
            what = f"{reads_past(wrap, len(seen))}, in training too"
            findings.append(Finding(Kind.WRAPS, Severity.NOTE, what, episodes=wrap.episodes, joints=(wrap.joint,)))
    return [replace(one, joints=read) for one, read in zip(seen, joints, strict=True)], findings


def tasks(seen: Sequence[Seen]) -> Iterator[Finding]:
    """More tasks than one in a set: a goal picture does not say which is meant."""
    by_task: dict[str, list[int]] = {}
    for one in seen:
        if one.task:
            by_task.setdefault(one.task, []).append(one.index)
    if len(by_task) < 2:
        return
    named = [f"{task!r} ({in_episodes(episodes)})" for task, episodes in list(by_task.items())[:MOST_TASKS]]
    more = f" and {len(by_task) - MOST_TASKS} more" if len(by_task) > MOST_TASKS else ""
    what = f"the set holds {number_of(len(by_task), 'task')}: {', '.join(named)}{more}"
    first = " ".join(map(str, next(iter(by_task.values()))[:3]))
    yield Finding(Kind.TASKS, Severity.WARNING, what, f"train on one of them at a time, by its episodes (--episodes {first} ...)")


def gaps(seen: Sequence[Seen]) -> Iterator[Finding]:
    """Numbers that the index passes over: episodes that somebody took out, or that were not copied."""
    there = {one.index for one in seen}
    if (count := max(there) + 1 - len(there)) > MOST_ABSENT:
        yield Finding(Kind.GAPS, Severity.NOTE, f"the numbers of {count} episodes are passed over ({listed(there)} are there)")
    elif absent := sorted(set(range(max(there) + 1)) - there):
        what = f"{in_episodes(absent)} {'is' if len(absent) == 1 else 'are'} not among them ({listed(there)})"
        yield Finding(Kind.GAPS, Severity.NOTE, what)
