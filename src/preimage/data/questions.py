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
NO_POSITIONS = {
    *("vel", "velocity", "velocities", "speed", "qdot", "acc", "acceleration"),
    *("effort", "efforts", "torque", "torques", "force", "current", "load", "temperature", "voltage"),
}
"""Words for what is measured of a joint beside its position."""


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
    moves = dict(zip(names, moving(recordings), strict=True))
    beside = [name for name in others if moves[name] and NO_POSITIONS & set(words_of(name))]
    joints = [name for name in others if name not in beside]
    why = "evenly in every episode, as a clock or a counter does"
    asked = [(rising, ("rises", "rise"), why), (falling, ("falls", "fall"), why)]
    if joints:
        asked.append((beside, ("is no position", "are no positions"), "by name, and what is learned is commanded"))
    return [_question(columns, verbs[len(columns) > 1], why, joints) for columns, verbs, why in asked if columns]


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
