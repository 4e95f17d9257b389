"""What an examination says: findings, each of a kind and a severity, and the words for where they are."""

import enum
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from preimage.records import listed


class Severity(enum.Enum):
    """What a finding means for training."""

    FAULT = "fault"
    """It cannot be trained on as it is."""
    WARNING = "warning"
    """It can be trained on, and the plans will suffer."""
    NOTE = "note"
    """Good to know."""


class Kind(enum.Enum):
    """What is found; the value is its name on the command line and on the page."""

    UNREADABLE = "unreadable parts"
    GAPS = "missing episodes"
    TASKS = "several tasks"
    COUNTER = "columns that are no joints"
    WRAPS = "angles that wrap"
    SIGN = "quaternions that change their sign"
    LEAPS = "rotation vectors that leap"
    UNLIKE = "episodes unlike each other"
    OTHERWISE = "episodes recorded otherwise"
    LENGTHS = "missing or extra frames"
    DURATION = "unusual duration"
    CLOCK = "uneven clock"
    NOT_FINITE = "joints not finite"
    FROZEN = "frozen joints"
    JUMP = "jumps"
    RANGE = "joints out of range"
    WAITS = "long rest at the start"
    UNREST = "no rest at the end"
    STARTS = "starts differ"
    BACKWARDS = "episodes played backwards"
    ZERO = "another zero"
    UNRECORDED = "joints not recorded"
    BLANK = "blank frames"
    STUCK = "camera stuck"
    STALE = "stale first frames"
    LAG = "camera lags"
    MOVED = "camera moved"
    DUPLICATES = "duplicate goals"
    UNTOLD = "joints out of sight"
    GOALS = "goals"
    SCENE = "scene"


@dataclass(frozen=True)
class Finding:
    """One thing that was found, where, and what would help."""

    kind: Kind
    severity: Severity
    what: str
    """One sentence without its full stop, with the numbers in it."""
    help: str = ""
    """What would mend it, an imperative without full stop; empty where nothing needs mending."""
    episodes: tuple[int, ...] = ()
    places: tuple[tuple[int, int], ...] = ()
    """(episode, step) of each single place, where there are such."""
    joints: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.severity.value}: {self.kind.value}: {self.what}{f'; {self.help}' if self.help else ''}"


def in_episodes(episodes: Iterable[int], do: str = "") -> str:
    """The episodes by their numbers, and what they do.

    >>> in_episodes([4]), in_episodes([4, 5], "lack"), in_episodes([4], "lack")
    ('episode 4', 'episodes 4, 5 lack', 'episode 4 lacks')
    """
    chosen = sorted(set(episodes))
    one = len(chosen) == 1
    return f"episode{'' if one else 's'} {listed(chosen)}" + (f" {do}{'s' if one else ''}" if do else "")


def of_joints(names: Sequence[str], one: str, several: str) -> str:
    """The joints by their names, and what one does, or what several do.

    >>> of_joints(["wrist"], "jumps", "jump"), of_joints(["wrist", "gripper"], "jumps", "jump")
    ('wrist jumps', 'wrist, gripper jump')
    """
    return f"{', '.join(names)} {one if len(names) == 1 else several}"


def leaving_out(episodes: Iterable[int], most: int = 12) -> str:
    """How to leave episodes out, ready to be copied.

    >>> leaving_out([5, 4])
    'leave them out (--without-episodes 4 5)'
    """
    chosen = sorted(set(episodes))
    return f"leave {'it' if len(chosen) == 1 else 'them'} out (--without-episodes {' '.join(map(str, chosen[:most]))}" + (
        f" and {len(chosen) - most} more)" if len(chosen) > most else ")"
    )


def episodes_of(places: Iterable[tuple[int, int]]) -> tuple[int, ...]:
    """
    >>> episodes_of([(4, 7), (2, 0), (4, 8)])
    (2, 4)
    """
    return tuple(sorted({episode for episode, _ in places}))


def at_places(places: Iterable[tuple[int, int]], most: int = 4) -> str:
    """
    >>> at_places([(2, 7), (3, 1)])
    'episode 2 step 7, episode 3 step 1'
    """
    chosen = sorted(set(places))
    words = ", ".join(f"episode {episode} step {step}" for episode, step in chosen[:most])
    return words + (f" and {len(chosen) - most} more" if len(chosen) > most else "")
