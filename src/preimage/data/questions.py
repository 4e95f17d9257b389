"""What only the user knows of the columns: whether one that counts evenly is a joint, and whether velocities are to be commanded.

A joint that turns at one pace looks as a counter does, and some robots are commanded velocities: there the user is asked, and has answered
as soon as joints are named.

>>> count, joint = np.arange(20.0), np.sin(np.arange(20.0))
>>> (question,) = questions_about(("row", "elbow"), [np.stack([count, joint], 1)] * 3)
>>> print(question)
row rises evenly in every episode, as a clock or a counter does: leave it out by --view.joints elbow, or name all joints there to keep it
"""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from preimage.data.clocks import is_clock, words_of
from preimage.data.view import moving

LEAST_STEPS = 10
"""Steps of the median episode from which on an even rise says something: shorter ways are often straight."""
EVEN = 0.5
"""Share of a column's median step by which nine of ten of its steps may differ, and the median steps of two episodes: clocks jitter."""
AS_SPEED, BEHIND = 0.9, 3.0
"""Correlation with another column's step from which on a column is its speed, and steps by which a column may be before or behind another
that it repeats (root mean square); all of a half have to, for one joint alone may go as fast as another one stands far."""
LEAST_HALF = 2
NO_POSITIONS = {
    *("vel", "velocity", "velocities", "speed", "qdot", "acc", "acceleration"),
    *("effort", "efforts", "torque", "torques", "force", "current", "load", "temperature", "voltage"),
    *("reward", "rewards", "done", "success", "terminal", "terminated", "truncated"),
}
"""Words for what is measured of a joint beside its position, and for what an environment says of a step."""


@dataclass(frozen=True)
class Question:
    """Columns that may be no joints, and how to answer."""

    columns: tuple[str, ...]
    what: str
    """Why they may be none."""
    help: str

    def __str__(self) -> str:
        return f"{self.what}: {self.help}"


def questions_about(names: Sequence[str], recordings: Sequence[Float[np.ndarray, "_T J"]]) -> list[Question]:
    """What is to be asked where nobody has named the joints to learn.

    Args:
        recordings: the joints of each episode as they were recorded: an angle that wraps does not count on, and is no counter.
    """
    free = {name: count for name, count in zip(names, evenly_counting(recordings), strict=True) if not is_clock(name)}
    rising, falling, others = ([name for name, count in free.items() if count == sign] for sign in (1, -1, 0))
    moves = dict(zip(names, moving(recordings, names), strict=True))
    called_so = [name for name in others if NO_POSITIONS & set(words_of(name))]
    beside = [name for name in called_so if moves[name]]
    joints = [name for name in others if name not in (called_so if beside else [])]
    why = "evenly in every episode, as a clock or a counter does"
    asked = [(rising, ("rises", "rise"), why), (falling, ("falls", "fall"), why)]
    if joints:
        asked.append((beside, ("is no position", "are no positions"), "by name, and what is learned is commanded"))
        repeated, those = said_again(joints, [each[:, [name in joints for name in names]] for each in recordings])
        asked.append((repeated, ("goes", "go"), f"as {those} do, and what is learned is commanded"))
        joints = [name for name in joints if name not in repeated]
    return [_question(columns, verbs[len(columns) > 1], why, joints) for columns, verbs, why in asked if columns]


def said_again(names: Sequence[str], recordings: Sequence[Float[np.ndarray, "_T J"]]) -> tuple[list[str], str]:
    """The half of the columns that are the speeds of the other half, or repeat it, as commands and the readings of the step before do.

    Returns:
        Their names, none where there is no such half; and the others, in words.

    >>> way = np.cumsum(np.sin(np.arange(40.0)[:, None] / (3, 5)), axis=0)
    >>> said_again(("a", "b", "c", "d"), [np.concatenate([way, np.gradient(way, axis=0)], 1)])
    (['c', 'd'], 'the speeds of a, b')
    """
    half = len(names) // 2
    if half < LEAST_HALF or len(names) % 2 or any(len(each) < LEAST_STEPS for each in recordings):
        return [], ""
    joined = np.concatenate(recordings)
    speeds = np.concatenate([np.gradient(each, axis=0) for each in recordings])
    if not (np.ptp(joined, axis=0) > 0).all():
        return [], ""
    for first, second in ((slice(half), slice(half, None)), (slice(0, None, 2), slice(1, None, 2))):
        others = ", ".join(names[first])
        if all(np.corrcoef(one, other)[0, 1] > AS_SPEED for one, other in zip(speeds[:, first].T, joined[:, second].T, strict=True)):
            return list(names[second]), f"the speeds of {others}"
        missed, step = np.square(joined[:, second] - joined[:, first]).mean(0), np.square(speeds[:, first]).mean(0)
        if (missed < BEHIND**2 * step).all():
            return list(names[second]), others
    return [], ""


def _question(columns: list[str], verb: str, why: str, joints: list[str]) -> Question:
    it = "it" if len(columns) == 1 else "them"
    choice = f"leave {it} out by {naming(joints)}, or " if joints else ""
    return Question(tuple(columns), f"{', '.join(columns)} {verb} {why}", f"{choice}name all joints there to keep {it}")


def evenly_counting(recordings: Sequence[Float[np.ndarray, "_T J"]]) -> Int[np.ndarray, " J"]:
    """Which columns rise (1) or fall (-1) at every step of every episode by about the same, as counters do and joints hardly ever; 0: none.

    >>> count, joint = np.arange(20.0), np.sin(np.arange(20.0))
    >>> evenly_counting([np.stack([count, joint, -count], 1)] * 3).tolist()
    [1, 0, -1]
    """
    if np.median([len(joints) for joints in recordings]) < LEAST_STEPS:
        return np.zeros(recordings[0].shape[1], int)
    ticks = [np.diff(joints, axis=0) for joints in recordings if len(joints) > 1]
    paces = np.array([np.median(each, axis=0) for each in ticks])  # (N, J)
    usual = np.median(paces, axis=0)
    sign = np.sign(usual).astype(int)
    counts = np.all([(sign * each > 0).all(0) for each in ticks], axis=0)
    uneven = np.array([np.quantile(np.abs(each - pace), 0.9, axis=0) for each, pace in zip(ticks, paces, strict=True)])  # (N, J)
    alike = (uneven <= EVEN * np.abs(paces)).all(0) & (np.abs(paces - usual) <= EVEN * np.abs(usual)).all(0)
    return sign * (counts & alike)


def naming(joints: Sequence[str]) -> str:
    """The option that names joints, ready to be copied.

    >>> naming(["elbow", "joint (2)"])
    "--view.joints elbow 'joint (2)'"
    """
    return f"--view.joints {shlex.join(joints)}"
