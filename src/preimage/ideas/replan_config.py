"""How a loop that plans anew while the robot moves goes about it: its numbers, without torch, so that the command line can name them."""

from dataclasses import dataclass
from typing import Literal

from preimage.network.ranges import validate


@dataclass(frozen=True)
class ReplanConfig:
    """How much is recognised and planned anew at each step (`ideas.replanning`).

    Raises:
        ValueError: a number is out of range.
    """

    window: int | Literal["all"] = 5
    """Steps of what was sensed that are explained, the last ones, or all since the start."""
    budget_ms: float = 150.0
    """Time for a step's thinking (ms); when it is up the best so far is commanded."""
    rounds: int = 3
    """Times a step that the intention is moved, at the most."""
    enough: float = 0.02
    """Share of the error of staying at the start: what goal and window leave unexplained up to there, nothing is searched for."""
    disbelief: float = 0.5
    """Share of what would be seen of a robot that never left its start: what is sensed may be that far from what is imagined."""
    patience: int = 3
    """Steps in a row that it may be further before the robot is held; a push is over sooner."""
    looks: int = 1
    """Times that the robot, arrived and at rest, looks how far from the goal's picture it stands, and makes up for it."""

    def __post_init__(self) -> None:
        if self.window != "all" and not (isinstance(self.window, int) and self.window >= 1):
            raise ValueError(f"window (--window) is {self.window}: give 1 or more steps, or all")
        at_least = {"budget_ms": 0, "rounds": 0, "patience": 1, "looks": 0, "enough": 0}
        validate(self, at_least=at_least, above_zero=("disbelief",))
