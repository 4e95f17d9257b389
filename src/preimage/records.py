"""The nouns that travel between rooms: what is sensed, recorded, shown, planned, tried and counted.

All of them are frozen and hold NumPy arrays. Lengths are metres, angles radians, times seconds. A frame is `uint8` of shape
(H, W, C); joints are `float64` of shape (J,), in the order of `joint_names`.

>>> import numpy as np
>>> frames, joints = np.zeros((3, 8, 8, 1), np.uint8), np.zeros((3, 2))
>>> demonstration = Demonstration(frames, joints, rate_hz=10.0, joint_names=("yaw", "shoulder"))
>>> len(demonstration), demonstration.last.joints.shape
(3, (2,))
"""

import enum
import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

LOWEST_RATE_HZ, HIGHEST_RATE_HZ = 0.2, 1000.0
"""Steps a second of anything that is recorded, planned or commanded; beyond them a unit is wrong, as milliseconds for seconds."""


@dataclass(frozen=True, eq=False)
class Percept:
    """What is sensed at one step: a frame and the joint angles. A goal may leave one of the two out."""

    frame: UInt8[np.ndarray, "H W C"] | None = None
    joints: Float[np.ndarray, " J"] | None = None


@dataclass(frozen=True)
class Scene:
    """One placement of a task: where the arm starts and where the things of the task lie."""

    task: str
    """Name of the task, as on the command line."""
    start_joints: tuple[float, ...]
    """Joints before the first step (rad; gripper: m)."""
    positions_m: Mapping[str, tuple[float, ...]]
    """Positions by name, in the frame of the table: x away from the robot, y to its left, z up (m)."""


def number_of(number: int, noun: str) -> str:
    """So many of them, in words that agree.

    >>> number_of(1, "episode"), number_of(3, "episode"), number_of(0, "joint")
    ('1 episode', '3 episodes', '0 joints')
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"


def listed(numbers: Iterable[int], most: int = 6) -> str:
    """The numbers in words, neighbours drawn together.

    >>> listed([3, 1, 2, 7]), listed(range(0, 40, 2))
    ('1 to 3, 7', '0, 2, 4, 6, 8, 10 and 14 more')
    """
    ordered = sorted(set(numbers))
    runs = [[number for _, number in run] for _, run in itertools.groupby(enumerate(ordered), lambda pair: pair[1] - pair[0])]
    words = [f"{run[0]} to {run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs]
    left = sum(map(len, runs[most:]))
    return ", ".join(words[:most]) + (f" and {left} more" if left else "")


def scene_of(about: Mapping[str, Any] | None) -> Scene | None:
    """The scene out of JSON, where its tuples have become lists."""
    if about is None:
        return None
    positions_m = {name: tuple(position) for name, position in about["positions_m"].items()}
    return Scene(about["task"], tuple(about["start_joints"]), positions_m)


@dataclass(frozen=True, eq=False)
class Demonstration:
    """One recorded visuo-proprioceptive sequence of T steps.

    Raises:
        ValueError: the number of frames, joints and names do not fit together, or a joint angle is not finite.
    """

    frames: UInt8[np.ndarray, "T H W C"]
    joints: Float[np.ndarray, "T J"]
    rate_hz: float
    joint_names: tuple[str, ...]
    scene: Scene | None = None

    def __post_init__(self) -> None:
        if len(self.frames) != len(self.joints):
            raise ValueError(f"frames has {len(self.frames)} steps and joints {len(self.joints)}: give one of each per step")
        if len(self.frames) < 2:
            raise ValueError(f"a demonstration needs 2 steps or more (a start and a goal), this one has {len(self.frames)}")
        if self.joints.shape[1] != len(self.joint_names):
            raise ValueError(f"joints has {self.joints.shape[1]} angles a step, joint_names names {len(self.joint_names)}")
        if not np.isfinite(self.joints).all():
            step, joint = np.argwhere(~np.isfinite(self.joints))[0]
            raise ValueError(f"joints holds {self.joints[step, joint]} at step {step}, joint {self.joint_names[joint]}")

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, step: int) -> Percept:
        return Percept(self.frames[step], self.joints[step])

    @property
    def first(self) -> Percept:
        return self[0]

    @property
    def last(self) -> Percept:
        return self[-1]


@dataclass(frozen=True)
class Body:
    """All joints that were recorded, of which a model may know fewer."""

    joint_names: tuple[str, ...]
    """In the order of the recordings."""
    held: Mapping[str, float] = field(default_factory=dict)
    """Where the joints that were left out mostly stood (the median) as the demonstrations began."""
    joint_unit: str | None = None
    """The joints' unit, where the data told."""

    def whole(self, joints: Float[np.ndarray, "T _known"], names: tuple[str, ...]) -> Float[np.ndarray, "T _all"]:
        """A way of the named joints as a way of all of them, in which the others are held."""
        known = dict(zip(names, joints.T, strict=True))
        ways = [known[name] if name in known else np.full(len(joints), self.held[name]) for name in self.joint_names]
        return np.stack(ways, axis=-1)  # (T, all)


@dataclass(frozen=True, eq=False)
class Episode:
    """One recording as it lies on disk, before anyone asks whether it is whole: F frames and T steps of joints need not agree."""

    index: int
    frames: UInt8[np.ndarray, "F H W C"]
    """Those that could be read, cropped and scaled."""
    joints: Float[np.ndarray, "T J"]
    """All joints that were recorded, those that never move too, in the unit they were recorded in; NaN where there is no number."""
    joint_names: tuple[str, ...]
    timestamps_s: Float[np.ndarray, " T"] | None
    """When each step was taken, where the recording tells."""
    declared_length: int
    """Steps that its index says it has."""
    rate_hz: float
    task: str | None
    """What is shown, in words, where the recording tells."""
    scene: Scene | None = None
    faults: tuple[str, ...] = ()
    """One sentence for each part that could not be read and is missing here."""


@dataclass(frozen=True)
class Description:
    """What a data set says of itself, before any frame is read."""

    version: str
    """The layout on disk: LeRobotDataset v3.0, LeRobotDataset v2.1 or folder."""
    cameras: Mapping[str, tuple[int, int, int]]
    """Height, width and channels of each camera."""
    joint_names: tuple[str, ...]
    rate_hz: float
    num_episodes: int
    joint_unit: str | None = None
    """The joints' unit, where the data set tells."""


@dataclass(frozen=True, eq=False)
class Shown:
    """What a run keeps of a demonstration it learned from: the way the arm took, and the picture it ended in."""

    last_frame: UInt8[np.ndarray, "H W C"]
    joints: Float[np.ndarray, "T J"]
    rate_hz: float


class Stopped(enum.Enum):
    """Why a regression of the intention ended, and what to try if the plan is poor."""

    ITERATIONS = "all iterations used; more iterations may lower the error further"
    ENOUGH = "the error is small enough; what is left are pixels"
    CONVERGED = "the error no longer falls; more candidates, not more iterations, could find a better plan"


class Verdict(enum.Enum):
    """How far a plan is to be trusted, from the share of its error in that of staying at the start."""

    REACHED = "reached"
    NEAR = "near"
    IN_DOUBT = "in doubt"


REACHED_BELOW, NEAR_BELOW = 0.05, 0.25
"""Shares of the error of staying at the start, below which a plan has reached its goal, or is near it."""


def verdict_of(unexplained: float | None) -> Verdict | None:
    """The word for a share of the error of staying at the start; None where the share is not known.

    >>> verdict_of(0.01), verdict_of(0.97), verdict_of(None)
    (<Verdict.REACHED: 'reached'>, <Verdict.IN_DOUBT: 'in doubt'>, None)
    """
    if unexplained is None:
        return None
    if unexplained < REACHED_BELOW:
        return Verdict.REACHED
    return Verdict.NEAR if unexplained < NEAR_BELOW else Verdict.IN_DOUBT


@dataclass(frozen=True)
class Trust:
    """How far a plan is to be trusted, said before anything moves.

    >>> Trust(0.98).sentence
    'trust: 98 % likely to succeed'
    """

    probability: float | None = None
    """Of success, where the run was calibrated for such plans (`preimage calibrate`)."""
    refused: bool = False
    """Whether the goal looks further from those that were reached than refusals are bounded at."""
    reasons: tuple[str, ...] = ()
    """What speaks against the plan, in words, the strongest first."""
    note: str = ""
    """By how many goals it was calibrated and what that promises; or that it was not."""
    strangeness: float = 0.0
    """How far the plan's evidence is from that of plans that reached their goals; for ranking, the larger the worse."""
    evidence: Mapping[str, float] = field(default_factory=dict)
    """What was looked at (`ideas.trust`), by name, the larger the worse."""

    def __post_init__(self) -> None:
        if self.probability is not None and not 0 <= self.probability <= 1:
            raise ValueError(f"probability is {self.probability:g}: give 0 to 1")

    @property
    def sentence(self) -> str:
        """The trust in one line."""
        likely = "not calibrated, no probability" if self.probability is None else f"{100 * self.probability:.0f} % likely to succeed"
        return f"trust: {likely}" + (f" ({'; '.join(self.reasons)})" if self.reasons else "")


class GoalRefused(Exception):
    """A goal was refused, before anything moved."""

    @classmethod
    def by(cls, trust: Trust, otherwise: str) -> "GoalRefused":
        """Why, and what would do."""
        return cls(f"the goal is refused: {'; '.join(trust.reasons)} ({trust.note}); {otherwise}")


@dataclass(frozen=True, eq=False)
class Plan:
    """An imagined way to a goal: T steps of frames and joints, of which the one at `arrival_step` shows the goal."""

    frames: UInt8[np.ndarray, "T H W C"]
    joints: Float[np.ndarray, "T J"]
    arrival_step: int
    """The step (0-based) whose imagined percept is nearest to the goal: T-hat of the paper. Execution ends there."""
    rate_hz: float
    joint_names: tuple[str, ...]
    start: Percept
    goal: Percept
    error: float
    """The prediction error of this very plan: start and goal, both modalities as far as given (equation 2)."""
    errors: Float[np.ndarray, " iterations"]
    """The lowest prediction error among the candidates, iteration by iteration."""
    stopped: Stopped
    seconds: float
    """Wall time from the request to the plan."""
    intention: Float[np.ndarray, " D"]
    """What the sequence is generated from: `IntentionState.flatten` of it, for one-step prediction under the same intention."""
    unexplained: float | None = None
    """The error as a share of that of staying at the start."""
    imagined_joints: Float[np.ndarray, "T J"] | None = None
    """The joints as the network imagines them, before anything was corrected."""
    expected_joints: Float[np.ndarray, "M J"] | None = None
    """The joints that memory alone expects at gripper events and, last, at the goal, where it was asked."""
    trust: Trust | None = None
    """How far it is to be trusted; None where nobody asked."""
    legs: tuple["Plan", ...] = ()
    """The plans of which this is made, where it leads to several goals in a row."""

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def verdict(self) -> Verdict | None:
        """How far to trust the plan; None where that is not known."""
        return verdict_of(self.unexplained)


@dataclass(frozen=True, eq=False)
class Trial:
    """One execution: what the robot sensed step by step, and how the task judged the course of it."""

    frames: UInt8[np.ndarray, "F H W C"]
    """One a step, as the joints; none where it was not filmed."""
    joints: Float[np.ndarray, "T J"]
    end_effector_m: Float[np.ndarray, "T 3"]
    deviation_m: float
    """Distance between what the task brings to the goal (the end effector, the object) and the goal after the last step."""
    success: bool
    scene: Scene
    limited: tuple[str, ...] = field(default=())
    """One sentence for every limit that changed the commanded joints."""
    details: Mapping[str, float] = field(default_factory=dict)
    """What else the judge saw: distances (m) and truths by name, ready for JSON. Each task says which."""
