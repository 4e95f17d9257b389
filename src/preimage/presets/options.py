"""How a network learns and how plans are searched for, with every idea named, so that each can be switched on and off alone.

Torch is imported where it is needed alone, so that the command line can name these options at once.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Self, get_args

from preimage.method.config import PlanConfig, TrainConfig
from preimage.network.config import ModelConfig
from preimage.network.ranges import validate

if TYPE_CHECKING:
    from preimage.ideas.gauss_newton import GaussNewton
    from preimage.ideas.memory import DemonstrationMemory
    from preimage.ideas.watched import See
    from preimage.method.seam import Augmentation, Ideas, PlanCorrection, TermsOf

Preset = Literal["paper", "regression", "full"]
"""paper: the paper's method alone; regression: its network and its search, begun near the goal and to stay there; full: all ideas."""
PRESETS: tuple[Preset, ...] = get_args(Preset)
SIZES: dict[str, Callable[[], ModelConfig]] = {"tiny": ModelConfig.tiny, "small": ModelConfig.small, "paper": ModelConfig.table_1}
"""Sizes of the network, with a latent intention."""


def network_config(size: str, preset: Preset) -> ModelConfig:
    """The network of a size and a preset: by `full` its intention is latent, else free."""
    if preset == "full":
        return SIZES[size]()
    return ModelConfig.paper() if size == "paper" else SIZES[size]().as_paper()


@dataclass(frozen=True)
class TrainOptions(TrainConfig):
    """How a network learns, with the ideas beyond the paper; by default none."""

    later_starts: float = 0.0
    """Share of an update's sequences that begin at a later step of their demonstration, under the same intention."""
    mixup: float = 0.0
    """Share of an update's sequences that are weighted sums of alike demonstrations; less than 1."""
    mixup_arity: int = 3
    """Demonstrations in a sum."""
    mixup_extrapolation: float = 1.3
    """How far sums reach, in sizes of what their demonstrations span; beyond 1 some lie outside of it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        validate(self, at_least={"mixup_arity": 2}, above_zero=("mixup_extrapolation",), shares=("later_starts", "mixup"))
        if self.mixup == 1:
            raise ValueError("mixup (--mixup) is 1: give less, so that some demonstrations are shown as they are")

    @classmethod
    def of(cls, preset: str) -> Self:
        """The options of a preset: none augments batches unless asked to; `evaluation.recipes` says which tasks gain from it."""
        return cls()

    def augmentations(self) -> "list[Augmentation]":
        """What is made of every batch."""
        from preimage.ideas.later_starts import LaterStarts
        from preimage.ideas.mixup import Mixup

        mixup = [Mixup(self.mixup, self.mixup_arity, self.mixup_extrapolation)] if self.mixup else []
        return [*mixup, *([LaterStarts(self.later_starts)] if self.later_starts else [])]


@dataclass(frozen=True)
class PlanOptions(PlanConfig):
    """How a plan is searched for, with the ideas beyond the paper; by default none."""

    search: Literal["adam", "gauss_newton"] = "adam"
    """adam: the gradient through time, the paper's; gauss_newton: for intentions of few numbers."""
    guess: Literal["random", "nearest", "kriged"] = "random"
    """Where a search begins: at random, at the nearest training intentions, or at the one that memory blends of them for the goal."""
    hold_goal: bool = False
    """Whether the goal is to be stayed in, not passed through."""
    expected_joints: bool = False
    """Whether a goal given as a picture is charged for joints that do not go with such pictures in the memory."""
    tolerance: float = 0.0
    """Share of the error of staying at the start at which a search by gauss_newton ends."""
    finite_difference_step: float = 0.15
    """How far gauss_newton changes each number to see what it does, in standard deviations."""
    end_correction: bool = False
    """Whether a plan ends between the joints that are imagined and those that memory expects, or in those that are asked for."""
    gripper_events: bool = False
    """Whether plans arrive after the last gripper event, and are corrected at each."""

    def __post_init__(self) -> None:
        super().__post_init__()
        validate(
            self,
            at_least={"tolerance": 0},
            above_zero=("finite_difference_step",),
        )
        for name, known in {"search": ("adam", "gauss_newton"), "guess": ("random", "nearest", "kriged")}.items():
            if getattr(self, name) not in known:
                raise ValueError(f"{name} (--{name}) is {getattr(self, name)}: give {' or '.join(known)}")

    @classmethod
    def regression(cls) -> Self:
        """The paper's search, begun at the training intentions that come nearest to the goal, which is to be stayed in."""
        return cls(guess="nearest", hold_goal=True, earliest_arrival=0)

    @classmethod
    def full(cls) -> Self:
        """All ideas. The search begins beside the goal, in intentions of few numbers, and is done sooner."""
        return replace(
            cls.regression(), search="gauss_newton", guess="kriged", candidates=1, iterations=12, dimensions=32, expected_joints=True,
            tolerance=0.003, end_correction=True, gripper_events=True,
        )  # fmt: skip

    @classmethod
    def of(cls, preset: str) -> Self:
        """The options of a preset.

        Raises:
            ValueError: there is no such preset.
        """
        if preset not in PRESETS:
            raise ValueError(f"{preset} is no preset: give paper, regression or full")
        return getattr(cls, preset)()

    @property
    def needs_memory(self) -> bool:
        return self.guess == "kriged" or self.expected_joints or self.end_correction or self.gripper_events

    def calibrated_with(self) -> dict[str, Any]:
        """What a calibration of such plans is known by: all but the precision, which follows the machine."""
        return asdict(self) | {"precision": None}

    def gauss_newton(self, tolerance: float = 0.0, memory: "DemonstrationMemory | None" = None) -> "GaussNewton":
        """The search.

        Args:
            memory: tells it in which directions of the intention sequences end differently.
        """
        from preimage.ideas.gauss_newton import GaussNewton

        endings = None if memory is None else lambda problem: memory.about(problem).last_percepts
        return GaussNewton(self.iterations, self.finite_difference_step, tolerance, endings)

    def ideas(self, memory: "DemonstrationMemory | None", see: "See | None" = None) -> "Ideas":
        """What `method.plan` is given.

        Args:
            see: called with every point that the search evaluates.

        Raises:
            ValueError: an idea needs a memory of the demonstrations, and there is none.
        """
        from preimage.ideas.end_correction import EndCorrection
        from preimage.ideas.expected_joints import ExpectJoints
        from preimage.ideas.gripper_events import ArriveAfterEvents
        from preimage.ideas.hold_goal import hold_goal, rest_at_goal
        from preimage.ideas.memory import KrigedGuess
        from preimage.ideas.nearest_training import NearestToGoal
        from preimage.ideas.watched import Watched
        from preimage.method.error_regression import adam
        from preimage.method.plan import random_guesses
        from preimage.method.seam import Ideas

        if self.needs_memory and memory is None:
            raise ValueError("these plans need a memory of the demonstrations: give one, or plan as paper or regression")
        guess = NearestToGoal(self.candidates) if self.guess == "nearest" else random_guesses
        tolerance = self.tolerance if self.expected_joints and self.modalities == "vision" else 0.0
        search = adam if self.search == "adam" else self.gauss_newton(tolerance, memory)
        if see:
            search = Watched(search, see)
        terms: list[TermsOf] = [hold_goal] if self.hold_goal else []
        corrections: list[PlanCorrection] = [rest_at_goal] if self.hold_goal else []
        if memory is not None:
            guess = KrigedGuess(memory) if self.guess == "kriged" else guess
            if self.expected_joints:
                terms.insert(0, ExpectJoints(memory))
            if self.gripper_events:
                terms.append(ArriveAfterEvents(memory.event_joint, memory.num_events))
            if self.end_correction or self.gripper_events:
                corrections.append(EndCorrection(memory, at_goal=self.end_correction, at_events=self.gripper_events))
        return Ideas(guess, search, terms, corrections)
