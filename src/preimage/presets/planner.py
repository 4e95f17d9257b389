"""A trained network that plans by a preset, and how it is read from a run."""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from preimage.compute.precision import resolve_precision
from preimage.ideas.replan_config import ReplanConfig
from preimage.presets.options import PlanOptions
from preimage.storage.run_files import CALIBRATION, MEMORY

if TYPE_CHECKING:
    import torch

    from preimage.ideas.calibration import Calibration
    from preimage.ideas.memory import DemonstrationMemory
    from preimage.ideas.replanning import Replanner
    from preimage.ideas.trust import Assessment
    from preimage.ideas.watched import See
    from preimage.method.plan import Recognition
    from preimage.method.seam import Policy
    from preimage.network.pdvmrnn import PDVMRNN
    from preimage.records import Demonstration, Percept, Plan


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

        return imagine_without_goal(self.model, start, config=self.options)

    def follow(self, plan: "Plan") -> "Policy":
        """One-step prediction under a plan's intention (`method.one_step.follow`); of several legs, of each up to its arrival."""
        from preimage.ideas.waypoints import follow_in_turn
        from preimage.method.one_step import follow

        if plan.legs:
            return follow_in_turn(self.follow, plan.legs)
        return follow(self.model, plan)

    def replanner(
        self, *, goals: "Sequence[Percept]", settings: ReplanConfig | None = None, found: "Plan | None" = None, **more: Any
    ) -> "Replanner":
        """What plans anew at every step while the robot moves (`ideas.replanning`).

        Args:
            found: a plan to the first goal, where there is one already.
            more: as `ideas.replanning.Replanner` takes it.
        """
        from preimage.ideas.last_look import LastLook
        from preimage.ideas.memory import KrigedGuess
        from preimage.ideas.moved_things import MovedThings
        from preimage.ideas.replanning import Replanner

        memory, options = self.memory, self.options
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
        guess = None if options.guess == "random" else NearestSequences(options.candidates)
        search = None if options.search == "adam" else options.gauss_newton()
        return recognise(self.model, demonstration, config=options, ideas=Ideas(guess, search))


def load_planner(name: str | Path, options: PlanOptions | None = None, *, device: "torch.device | None" = None) -> Planner:
    """The network of a run with the memory that lies beside it.

    Args:
        name: a run folder, a bundled name, or `hf:owner/name` of the Hugging Face Hub.
        options: how plans are searched for; by default all ideas.

    Raises:
        ValueError: there is no such run, its files are broken, or the options need a memory and it has none.
    """
    from preimage.storage.networks import load_model
    from preimage.storage.runs import find_run, read_body

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
    from preimage.storage.networks import read_tensors
    from preimage.storage.runs import find_run

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
