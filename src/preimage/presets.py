"""The three ways to train and plan, and the only place where ideas are wired into the method.

* `paper`: the paper's method and nothing else. No memory is read.
* `regression`: what the network and the search are worth without memory: a latent intention, Gauss-Newton from several training
  intentions, the goal held. Nothing is corrected.
* `full`: all ideas, the memory of the demonstrations among them.

`PlanOptions` and `TrainOptions` name every idea, so that each can be switched on and off alone.
"""

import time
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, get_args

from preimage.compute.precision import resolve_precision
from preimage.ideas.replan_config import ReplanConfig
from preimage.method.config import PlanConfig, TrainConfig
from preimage.network.config import ModelConfig
from preimage.network.ranges import validate
from preimage.storage.run_files import CALIBRATION, HELD_OUT, MEMORY

if TYPE_CHECKING:
    import torch

    from preimage.compute.processes import ProcessGroup
    from preimage.ideas.calibration import Calibration
    from preimage.ideas.gauss_newton import GaussNewton
    from preimage.ideas.memory import DemonstrationMemory
    from preimage.ideas.replanning import Replanner
    from preimage.ideas.test_time_augmentation import TestTimeAugmentation
    from preimage.ideas.trust import Assessment
    from preimage.ideas.watched import See
    from preimage.method.plan import Recognition
    from preimage.method.seam import Augmentation, Ideas, PlanCorrection, Policy, TermsOf
    from preimage.network.pdvmrnn import PDVMRNN
    from preimage.records import Demonstration, Percept, Plan

Preset = Literal["paper", "regression", "full"]
"""paper: the paper's method alone; regression: network and search without memory; full: all ideas."""
PRESETS: tuple[Preset, ...] = get_args(Preset)
SIZES: dict[str, Callable[[], ModelConfig]] = {"tiny": ModelConfig.tiny, "small": ModelConfig.small, "paper": ModelConfig.table_1}
"""Sizes of the network, with a latent intention."""


def network_config(size: str, preset: Preset) -> ModelConfig:
    """The network of a size and a preset: by `paper` its intention is free, else latent."""
    if preset != "paper":
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
    least_gain: float = 0.2
    """gauss_newton ends where a step with a fresh Jacobian lowers the error by less than this share of it."""
    drop_above: float = 1.3
    """gauss_newton drops candidates whose error is more than this many times the lowest."""
    finite_difference_step: float = 0.15
    """How far gauss_newton changes each number to see what it does, in standard deviations."""
    test_time_augmentation: float = 0.0
    """Heights of a frame by which the start frame is moved, to eight sides; the way is the mean of what is imagined from all."""
    end_correction: bool = False
    """Whether a plan ends between the joints that are imagined and those that memory expects, or in those that are asked for."""
    gripper_events: bool = False
    """Whether plans arrive after the last gripper event, and are corrected at each."""

    def __post_init__(self) -> None:
        super().__post_init__()
        validate(
            self,
            at_least=dict.fromkeys(("tolerance", "test_time_augmentation"), 0),
            above_zero=("finite_difference_step", "drop_above"),
            shares=("least_gain",),
        )
        for name, known in {"search": ("adam", "gauss_newton"), "guess": ("random", "nearest", "kriged")}.items():
            if getattr(self, name) not in known:
                raise ValueError(f"{name} (--{name}) is {getattr(self, name)}: give {' or '.join(known)}")

    @classmethod
    def regression(cls) -> Self:
        """Network and search without memory."""
        return cls(
            search="gauss_newton", guess="nearest", candidates=4, iterations=40, least_gain=0.005, drop_above=10.0, intention_cost=1e-4,
            dimensions=32, hold_goal=True, earliest_arrival=0,
        )  # fmt: skip

    @classmethod
    def full(cls) -> Self:
        """All ideas. The search begins near the goal, and is done sooner."""
        return replace(
            cls.regression(), guess="kriged", candidates=1, iterations=12, least_gain=0.2, drop_above=1.3, intention_cost=1e-3,
            expected_joints=True, tolerance=0.003, test_time_augmentation=0.03, end_correction=True, gripper_events=True,
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
        return GaussNewton(self.iterations, self.finite_difference_step, tolerance, self.least_gain, self.drop_above, endings)

    def augmentation(self) -> "TestTimeAugmentation | None":
        from preimage.ideas.test_time_augmentation import TestTimeAugmentation

        return TestTimeAugmentation(self.test_time_augmentation) if self.test_time_augmentation else None

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
        return Ideas(guess, search, terms, self.augmentation(), corrections)


class Planner:
    """A trained network, planning by a preset.

    Args:
        model: the network.
        memory: of the demonstrations it was trained on, for the presets that ask it.
        options: how plans are searched for; by default all ideas where there is a memory, else those that need none.
        calibration: what trust in plans is calibrated by; it holds for the options it was made with.
        joint_unit: the unit of the joints, where it is known, for what is refused.

    Raises:
        ValueError: the options need a memory, and there is none.
    """

    def __init__(
        self,
        model: "PDVMRNN",
        memory: "DemonstrationMemory | None" = None,
        options: PlanOptions | None = None,
        calibration: "Calibration | None" = None,
        *,
        joint_unit: str | None = None,
    ) -> None:
        self.model, self.memory, self.calibration, self.joint_unit = model, memory, calibration, joint_unit
        options = options or (PlanOptions.full() if memory else PlanOptions.regression())
        self.options = replace(options, precision=resolve_precision(options.precision, model.home_pixels.device))
        self.ideas = self.options.ideas(memory)

    def plan(self, *, goal: "Percept", start: "Percept | None" = None) -> "Plan":
        """Imagine a way from the start percept to the goal (`method.plan.plan`), and say how far to trust it (`ideas.trust`).

        Raises:
            ValueError: the goal cannot be imagined.
        """
        from preimage.method.plan import plan

        self.validate_goals([goal])
        found = plan(self.model, start=start, goal=goal, config=self.options, ideas=self.ideas)
        return replace(found, trust=self.assessment(found))

    @cached_property
    def assessment(self) -> "Assessment":
        """What says of a plan how far to trust it; by a calibration only where that was made with the same options."""
        from preimage.ideas.trust import Assessment

        known = self.calibration
        fits = known is not None and dict(known.plan) == self.options.calibrated_with()
        otherwise = known is not None and not fits
        return Assessment(self.model, self.memory if self.options.needs_memory else None, known if fits else None, otherwise)

    def watched(self, see: "See") -> "Planner":
        """The same planner, whose searches report every point they evaluate (`ideas.watched`)."""
        planner = copy(self)
        planner.ideas = self.options.ideas(self.memory, see)
        return planner

    def plan_in_turn(self, *, goals: "Sequence[Percept]", start: "Percept | None" = None) -> "list[Plan]":
        """A plan to each of several goals, from where the one before arrives (`ideas.waypoints`)."""
        from preimage.ideas.waypoints import plan_in_turn

        self.validate_goals(goals)  # all of them before the first is planned to
        first, *later = plan_in_turn(self.plan, start=start, goals=goals)
        return [first, *(replace(leg, trust=self.assessment.of_later_leg(leg)) for leg in later)]

    def validate_goals(self, goals: "Sequence[Percept]", *, source: str = "the goal") -> None:
        """Raises ValueError where joints that are looked at lie outside of those demonstrated (`data.joint_range`)."""
        from preimage.data.joint_range import validate_in_range

        for goal in goals if self.options.modalities != "vision" else ():
            validate_in_range(goal, self.model.sensors, unit=self.joint_unit, source=source)

    def imagine_without_goal(self, start: "Percept") -> "Plan":
        """What is imagined when nothing is wanted (`ideas.no_goal`)."""
        from preimage.ideas.no_goal import imagine_without_goal
        from preimage.method.seam import Ideas

        ideas = Ideas(first_draft=self.options.augmentation())
        return imagine_without_goal(self.model, start, config=self.options, ideas=ideas)

    def follow(self, plan: "Plan") -> "Policy":
        """One-step prediction under a plan's intention (`method.one_step.follow`); of several legs, of each up to its arrival."""
        from preimage.ideas.waypoints import follow_in_turn
        from preimage.method.one_step import follow
        from preimage.method.seam import one_look

        if plan.legs:
            return follow_in_turn(self.follow, plan.legs)
        augmentation = self.options.augmentation()
        return follow(self.model, plan, looks=augmentation.looks if augmentation else one_look)

    def replanner(
        self, *, goals: "Sequence[Percept]", settings: ReplanConfig | None = None, found: "Plan | None" = None, **more: Any
    ) -> "Replanner":
        """What plans anew at every step while the robot moves (`ideas.replanning`); looks moved a little are for first plans alone.

        Args:
            found: a plan to the first goal, where there is one already.
            more: as `ideas.replanning.Replanner` takes it.
        """
        from preimage.ideas.last_look import LastLook
        from preimage.ideas.memory import KrigedGuess
        from preimage.ideas.moved_things import MovedThings
        from preimage.ideas.replanning import Replanner

        memory, options = self.memory, replace(self.options, test_time_augmentation=0.0)
        handles = memory is not None and memory.num_events > 0
        looks = memory is not None and options.end_correction and options.modalities == "vision" and not handles
        ideas = options.ideas(memory)
        return Replanner(
            self.model,
            self.plan,
            goals=goals,
            config=options,
            ideas=ideas if isinstance(ideas.initial_guess, KrigedGuess) else replace(ideas, initial_guess=None),
            settings=settings,
            found=found,
            look=LastLook(memory) if memory is not None and looks else None,
            scene=MovedThings(memory) if memory is not None and handles else None,
            gripper=memory.event_joint if memory is not None and handles else None,
            **more,
        )

    def recognise(self, demonstration: "Demonstration") -> "Recognition":
        """The intention of a whole sensed sequence (`method.plan.recognise`)."""
        from preimage.ideas.nearest_training import NearestSequences
        from preimage.method.plan import recognise
        from preimage.method.seam import Ideas

        options = self.options
        if options.search == "adam":
            return recognise(self.model, demonstration, config=options)
        search = options.gauss_newton()
        return recognise(self.model, demonstration, config=options, ideas=Ideas(NearestSequences(options.candidates), search))


def load_planner(name: str | Path, options: PlanOptions | None = None, *, device: "torch.device | None" = None) -> Planner:
    """The network of a run with the memory that lies beside it.

    Args:
        name: a run folder, a bundled name, or `hf:owner/name` of the Hugging Face Hub.
        options: how plans are searched for; by default all ideas.

    Raises:
        ValueError: there is no such run, its files are broken, or the options need a memory and it has none.
    """
    from preimage.storage.runs import find_run, load_model, read_body

    options, name = options or PlanOptions.full(), find_run(name)  # once, so that all parts of a run on the Hub are of one revision
    model = load_model(name)
    if device is not None:
        model = model.to(device)
    memory = load_memory(name, device=model.home_pixels.device) if options.needs_memory else None
    return Planner(model, memory, options, load_calibration(name), joint_unit=read_body(name).joint_unit)


def load_memory(name: str | Path, *, device: "torch.device | None" = None) -> "DemonstrationMemory":
    """The memory of a run's demonstrations.

    Raises:
        ValueError: there is none, or it is broken.
    """
    from preimage.ideas.memory import DemonstrationMemory
    from preimage.storage.runs import find_run, read_tensors

    tensors = read_tensors(find_run(name) / MEMORY)
    try:
        memory = DemonstrationMemory.from_tensors(tensors)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"the memory of {name} is broken or of another version ({error}): train again") from error
    return memory if device is None else memory.to(device)


def load_calibration(name: str | Path) -> "Calibration | None":
    """What trust in a run's plans is calibrated by; None where nobody did.

    Raises:
        ValueError: it is broken.
    """
    from preimage.ideas.calibration import Calibration
    from preimage.storage.reading import read_json, record_of
    from preimage.storage.runs import find_run

    path = find_run(name) / CALIBRATION
    if not path.exists():
        return None
    try:
        return record_of(Calibration, read_json(path))
    except ValueError as error:
        raise ValueError(f"{path} cannot be read ({error}): remove it, or write it anew with `preimage calibrate`") from error


def train(
    demonstrations: "Sequence[Demonstration]",
    model_config: ModelConfig | None = None,
    *,
    config: TrainOptions | None = None,
    folder: Path | str | None = None,
    held_out: "Sequence[Demonstration]" = (),
    group: "ProcessGroup | None" = None,
    **more: Any,
) -> "PDVMRNN":
    """Learn weights and intentions that regenerate the demonstrations (`method.train.train`); their memory is kept in the run folder.

    Args:
        config: how the network learns, with the ideas beyond the paper.
        held_out: episodes whose errors are kept in the run folder at every checkpoint; nothing is learned from them.
        more: as `method.train.train` takes it.
    """
    from preimage.compute.processes import ProcessGroup
    from preimage.method.train import train as train_by_the_paper
    from preimage.storage.checkpoints import append_to_log
    from preimage.storage.runs import load_model, write_tensors

    config, group = config or TrainOptions(), group or ProcessGroup()

    def keep_memory(model: "PDVMRNN") -> None:
        if folder is not None and group.first:
            write_tensors(Path(folder) / MEMORY, remember(demonstrations, model).tensors())
            (Path(folder) / CALIBRATION).unlink(missing_ok=True)  # it is of the weights before

    def look_at_held_out(model: "PDVMRNN", update: int) -> None:
        from preimage.ideas.held_out_error import held_out_error

        began = time.perf_counter()
        error = held_out_error(model, held_out, precision=config.precision)
        line = {"update": update} | error | {"seconds": time.perf_counter() - began}
        append_to_log(Path(folder or ""), line, name=HELD_OUT)

    more |= {"augmentations": config.augmentations(), "at_checkpoint": look_at_held_out if held_out else None}
    try:
        model = train_by_the_paper(demonstrations, model_config, config=config, folder=folder, group=group, **more)
    except KeyboardInterrupt:
        if folder is not None:
            keep_memory(load_model(folder))
        raise
    keep_memory(model)
    return model


def remember(demonstrations: "Sequence[Demonstration]", model: "PDVMRNN") -> "DemonstrationMemory":
    """The memory of the demonstrations that a network was trained on, for `Planner`."""
    from preimage.data.sequences import pad
    from preimage.ideas.memory import DemonstrationMemory

    return DemonstrationMemory.of(pad(demonstrations, rate_hz=model.config.rate_hz), model.coding)
