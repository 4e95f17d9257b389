"""What a robot has to be able to do to be driven by a loop that looks: sense, be commanded, and say what it may be commanded.

Ten lines make one of your own robot:

>>> class Mine:
...     limits = Limits(("yaw",), ("rad",), np.array([-1.0]), np.array([1.0]), velocity=np.array([2.0]))
...     at = np.zeros(1)
...
...     def sense(self):
...         return Percept(np.zeros((8, 8, 1), np.uint8), self.at)
...
...     def command(self, joints):
...         self.at = joints

and whatever decides, given what is sensed, drives it:

>>> @dataclass
... class Decision:
...     command: np.ndarray
...     done: bool
>>> robot = Mine()
>>> len(drive(robot, lambda percept: Decision(np.array([0.3]), done=percept.joints[0] > 0.2), period_s=0.1, most_steps=9).decisions)
3
>>> robot.at.round(3).tolist()
[0.3]
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float

from preimage.records import Percept
from preimage.robot.limits import Limiter, Limits


class Robot(Protocol):
    """What senses, and is commanded joints, once a period."""

    @property
    def limits(self) -> Limits:
        """What it may be commanded."""
        ...

    def sense(self) -> Percept:
        """What is sensed now: the joints, and the frame, or None for it where none has come since the last period."""
        ...

    def command(self, joints: Float[np.ndarray, " J"]) -> None:
        """Go to the joints (their units) within a period, and return when it is over."""
        ...


class Decision(Protocol):
    """What is decided at one step."""

    @property
    def command(self) -> Float[np.ndarray, " J"]:
        """The joints to be in at the next step, in their units."""
        ...

    @property
    def done(self) -> bool:
        """Whether this was the last command."""
        ...


@dataclass(frozen=True, eq=False)
class Drive:
    """What became of a robot that was driven."""

    decisions: list[Any]
    commands: Float[np.ndarray, "S J"]
    """What was commanded, within the limits."""
    limited: tuple[str, ...]
    """One sentence for every limit that changed a command."""


def drive(robot: Robot, decide: Callable[[Percept], Decision], *, period_s: float, most_steps: int) -> Drive:
    """Sense, decide and command, step by step, until it is decided that it is done, within the robot's limits.

    Args:
        decide: from what is sensed to what to command, or to that it is done.
        period_s: time from one command to the next (s).
        most_steps: it ends after so many in any case.

    Raises:
        ValueError: most_steps is below 1, the robot senses no joints at the start, or other joints are commanded than it has.
    """
    if most_steps < 1:
        raise ValueError(f"most_steps is {most_steps}: give 1 or more")
    percept, limits = robot.sense(), robot.limits
    if percept.joints is None:
        raise ValueError("the robot senses no joints at its start: there is no telling where it stands")
    limiter = Limiter(limits, np.asarray(percept.joints, float), period_s)
    decisions, commands = [], []
    for step in range(most_steps):
        decision = decide(percept if step == 0 else robot.sense())
        wanted = np.asarray(decision.command, float)
        if wanted.shape != limits.lower.shape or not np.isfinite(wanted).all():
            raise ValueError(f"{wanted.tolist()} is commanded: the robot has {', '.join(limits.joint_names)}")
        decisions.append(decision)
        commands.append(limiter.follow(wanted))
        robot.command(commands[-1])
        if decision.done:
            break
    limiter.validate_added_steps()
    while not limiter.has_arrived:
        commands.append(limiter.catch_up())
        robot.command(commands[-1])
    return Drive(decisions, np.stack(commands), limiter.sentences())
