"""Planning and recognition: find the intention whose imagined future contains the goal (sections II-C and II-D).

Recognition compares every step of a sequence that was sensed. Planning knows the two ends alone: what is sensed now and what is wanted.
When the goal is reached is open, so each iteration looks for the step that shows it best, the arrival step. The search begins at the
intention that is recalled for the goal (`ideas.memory`; `method.error_regression` goes on from there).
"""

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from preimage.data.sequences import at_rate
from preimage.ideas.end_correction import End, bent_to
from preimage.ideas.gripper_events import changes_side
from preimage.ideas.image_features import BLUR, arrived, blurred
from preimage.ideas.memory import Library, begins_as_shown, expected_at_switches, expected_joints, first_guesses
from preimage.ideas.test_time_augmentation import glances
from preimage.method.error_regression import Regression, RegressionConfig, regress_intention
from preimage.method.prediction_error import Modalities, ToGoal, ToSequence
from preimage.network.coding import to_frames, to_pixels
from preimage.network.intention import IntentionState
from preimage.network.pdvmrnn import PDVMRNN, Generated, Sensed
from preimage.records import Demonstration, Percept, Plan, Stopped, number_of


@dataclass(frozen=True)
class PlanConfig(RegressionConfig):
    """How a plan is searched for."""

    modalities: Modalities = "vision"
    """The modalities of the goal that are used; the rest of a goal percept is not looked at."""
    guesses: int = 8
    """First guesses, the recalled one before all; as many as `candidates` are regressed, the others if the plan is in doubt then."""
    doubt: float = 0.05
    """A plan is in doubt while its error is above this share of the error of staying at the start, expected joints included."""
    enough: float = 0.003
    """Share of the error of staying at the start at which a search ends, if memory tells the joints: what is left is in single pixels."""
    horizon: int | None = None
    """Steps imagined, T_max; by default as many as the longest demonstration has."""
    delay_penalty: float = 1.01
    """Factor a step on the goal error when the arrival step is chosen (section II-D)."""
    rests: bool = True
    """Whether the goal is to be stayed in; without, it is enough to pass through it, as in the paper."""
    recalls: bool = True
    """Whether a goal given as a picture is held to be reached with joints that go with such pictures in the model's memory."""
    glance: float = 0.03
    """Heights of a frame by which the start frame is moved, to eight sides, to be looked at again: the way is the mean of what is imagined
    from all nine, for what the network makes of one picture is a little off, each time otherwise. 0: one look."""


@dataclass(frozen=True, eq=False)
class Recognition:
    """The intention that explains a sensed sequence, and the sequence it regenerates."""

    intention: IntentionState
    generated: Generated
    error: float
    """Mean prediction error of a step, both modalities (equation 1)."""
    errors: Float[np.ndarray, " iterations"]
    stopped: Stopped


def imagine(model: PDVMRNN, intention: IntentionState, start: Sensed, *, num_steps: int, precision: str) -> Generated:
    """Generate in closed loop from one start percept, at the precision asked for."""
    pixels, codes = (part.expand(len(intention), *part.shape) for part in start)
    return model.generate_closed_loop(intention, (pixels, codes), num_steps=num_steps, dtype=getattr(torch, precision))


def imagine_at_a_glance(model: PDVMRNN, intention: IntentionState, start: Sensed, config: PlanConfig) -> Generated:
    """What one intention generates from the start as it is, first, and as it looks from a little beside."""
    pixels = glances(start[0], config.glance)
    inputs = pixels, start[1].expand(len(pixels), *start[1].shape)
    same = intention[torch.zeros(len(pixels), dtype=torch.long)]
    return model.generate_closed_loop(same, inputs, num_steps=horizon_of(model, config), dtype=getattr(torch, config.precision))


def imagine_library(model: PDVMRNN, start: Percept | None = None, *, config: PlanConfig | None = None) -> Library:
    """What the model imagines for each of its training intentions, from a start percept or from home, and how they end."""
    config = config or PlanConfig()
    library = library_at(model, as_inputs(model, start or home(model), name="start"), config)
    _ = library.imagined  # now, not when it is first needed
    return library


def library_at(model: PDVMRNN, inputs: Sensed, config: PlanConfig) -> Library:
    """The same, imagined when it is needed.

    The endings are those of the demonstrations, as shown, where the start feels like theirs, and as imagined elsewhere.
    """

    @torch.no_grad()
    def from_here() -> Generated:
        table = model.intention_table.intentions()
        return imagine(model, table, inputs, num_steps=horizon_of(model, config), precision=config.precision)

    common = inputs, horizon_of(model, config)
    if begins_as_shown(model, inputs):
        shown = model.shown_arrivals, model.shown_lasts, model.shown_firsts, model.shown_ends
        return Library(*common, from_here, model.background, *shown)
    imagined = from_here()  # for memory is made of it
    lasts, ends = imagined.pixels[:, -1], model.coding.decode(imagined.log_codes[:, -1].exp())
    begun = model.coding.decode(inputs[1]).repeat(len(ends), 1)  # not expanded, of which torch 2.13 takes a wrong median
    arrivals = arrived(inputs[0], lasts, model.background)
    library = Library(*common, lambda: imagined, model.background, arrivals, blurred(lasts, BLUR), begun, ends)
    _ = library.imagined
    return library


def plan(
    model: PDVMRNN,
    *,
    start: Percept | None = None,
    goal: Percept,
    config: PlanConfig | None = None,
    library: Library | None = None,
) -> Plan:
    """Imagine a way from the start percept to the goal (section II-D).

    Args:
        model: a trained network.
        start: what is sensed now, frame and joints; by default the mean first percept of the demonstrations.
        goal: what is wanted; of it only the modalities that `config.modalities` names are looked at.
        library: imagined training sequences (`imagine_library`), used where they begin and look ahead as the plan does; else they are
            imagined anew.

    Returns:
        a plan, always; its error and its reason to have stopped say how far to trust it.

    Raises:
        ValueError: a frame or joints do not fit the model, are missing where they are needed, or are not finite.
    """
    began = time.perf_counter()
    config = config or PlanConfig()
    start = start or home(model)
    wanted = goal_inputs(model, goal, config.modalities)
    objective = ToGoal(as_inputs(model, start, name="start"), wanted, config.modalities, config.delay_penalty, config.rests)
    if library is None or not library.serves(objective.start, horizon_of(model, config)):
        library = library_at(model, objective.start, config)
    if config.recalls and config.modalities == "vision":
        objective = replace(objective, expected=expected_joints(library, objective, model.coding))
    to_explain = objective.start_to_goal

    def from_start(intention: IntentionState, num_steps: int | None = None) -> Generated:
        return imagine(model, intention, objective.start, num_steps=num_steps or horizon_of(model, config), precision=config.precision)

    space = model.intention_table.space(config.dimensions)
    enough = config.enough * to_explain if objective.expected else 0.0
    tried: list[Regression] = []
    for begun, count in itertools.pairwise((0, config.candidates, max(config.guesses, config.candidates))):
        if tried and tried[-1].error.min() < config.doubt * to_explain:
            break
        guesses = first_guesses(library, objective, model.coding, space.training, count=count)[begun:]
        if not len(guesses):
            break
        tried.append(regress_intention(space, guesses, from_start, objective, config=config, library=library.at_hand, enough=enough))
    found = min(tried, key=lambda one: float(one.error.min()))
    with torch.no_grad():
        imagined = imagine_at_a_glance(model, found.best, objective.start, config)
        if len(steps := switch_steps(model, mean_joints(model, imagined.log_codes))) == int(model.switching[1]):
            objective = replace(objective, earliest=max(steps, default=0))  # what was gripped has to be let go first
        error, arrival = (each[0].item() for each in objective.errors(imagined))
    searched = {"errors": found.errors.double().cpu().numpy(), "stopped": found.stopped, "seconds": time.perf_counter() - began}
    known = {"start": start, "goal": goal, "error": error} | searched
    ends: list[End] = []
    if objective.expected:
        at_switches = expected_at_switches(model, objective) if begins_as_shown(model, objective.start) else []
        expected = [*at_switches, objective.expected]
        known["recalled"] = torch.stack([each.mean for each in expected]).double().cpu().numpy()
        ends = [End.expected(each, unexplained=error / max(to_explain, 1e-9)) for each in expected]
    elif config.modalities != "vision":
        assert goal.joints is not None
        ends = [End.certain(goal.joints)]
    return plan_of(model, imagined, found.best, int(arrival), rests=config.rests, ends=ends, **known)


def plan_of(
    model: PDVMRNN,
    imagined: Generated,
    intention: IntentionState,
    arrival_step: int,
    *,
    rests: bool = False,
    ends: Sequence[End] = (),
    **known: Any,
) -> Plan:
    """What was imagined, as the record that leaves this room: the frames of the first sequence, the mean joints of all.

    Args:
        rests: whether the robot stays where it arrives: at the mean of the joints from then on, without the sway of single steps.
        ends: what else is known of the joints where the robot switches something and, last, at the goal; the way there is bent to agree.
            One that switches more often or less is bent at the goal alone.
    """
    joints = mean_joints(model, imagined.log_codes)
    if rests:
        joints[arrival_step:] = joints[arrival_step:].mean(0)
    if ends:
        *at_switches, at_goal = ends
        steps = switch_steps(model, joints[: arrival_step + 1])
        on_the_way = dict(zip(steps, at_switches, strict=True)) if len(steps) == len(at_switches) else {}
        joints = bent_to(on_the_way | {arrival_step: at_goal}, joints, model.coding)
    return Plan(
        frames=to_frames(imagined.pixels[0]).cpu().numpy(),
        joints=joints.cpu().numpy(),
        arrival_step=arrival_step,
        rate_hz=model.config.rate_hz,
        joint_names=model.sensors.joint_names,
        intention=intention.flatten()[0].double().cpu().numpy(),
        **known,
    )


def mean_joints(model: PDVMRNN, log_codes: Float[Tensor, "looks *T J K"]) -> Float[Tensor, "*T J"]:
    """What all looks tell of the joints."""
    return model.coding.decode(log_codes.exp()).double().mean(0)


def switch_steps(model: PDVMRNN, joints: Float[Tensor, "T J"]) -> list[int]:
    """The steps at which what the demonstrations switch is switched."""
    joint, count = model.switching.int().tolist()
    middle = ((model.coding.lower + model.coding.upper) / 2).to(joints)
    return changes_side(joints[None], middle)[0, :, joint].nonzero()[:, 0].tolist() if count else []


def imagine_without_goal(model: PDVMRNN, start: Percept, *, config: PlanConfig | None = None) -> Plan:
    """What the model imagines when nothing is wanted: its intention at the prior mean. The baseline that shows what a goal buys."""
    config = config or PlanConfig()
    began = time.perf_counter()
    intention = model.intention_table.prior_mean(1)
    num_steps = horizon_of(model, config)
    with torch.no_grad():
        inputs = as_inputs(model, start, name="start")
        imagined = imagine_at_a_glance(model, intention, inputs, config)
    error = ToGoal(inputs, inputs).start_error(imagined)[0]
    searched = {"errors": np.zeros(0), "stopped": Stopped.ITERATIONS, "seconds": time.perf_counter() - began}
    return plan_of(model, imagined, intention, num_steps - 1, start=start, goal=Percept(), error=float(error), **searched)


def recognise(model: PDVMRNN, demonstration: Demonstration, *, config: PlanConfig | None = None) -> Recognition:
    """Infer the intention of a whole sensed sequence, so that the model regenerates it in closed loop (section II-C, equation 1).

    Raises:
        ValueError: frames or joints do not fit the model.
    """
    config = config or PlanConfig()
    sensed = at_rate(demonstration, model.config.rate_hz)
    percepts = [as_inputs(model, sensed[step], name=f"step {step}") for step in range(len(sensed))]
    pixels, codes = (torch.stack(parts)[None] for parts in zip(*percepts, strict=True))
    objective = ToSequence((pixels, codes))

    def from_start(intention: IntentionState, num_steps: int | None = None) -> Generated:
        return imagine(model, intention, percepts[0], num_steps=num_steps or len(sensed), precision=config.precision)

    space = model.intention_table.space(config.dimensions)
    with torch.no_grad():
        guesses = objective.errors(from_start(model.intention_table.intentions()))[0].argsort()[: config.candidates]
    found = regress_intention(space, space.training[guesses], from_start, objective, config=config)
    with torch.no_grad():
        generated = from_start(found.best)
        error, _ = objective.errors(generated)
    return Recognition(found.best, generated, float(error), found.errors.double().cpu().numpy(), found.stopped)


def home(model: PDVMRNN) -> Percept:
    """The mean first percept of the demonstrations: where a plan starts when nothing else is said."""
    return Percept(to_frames(model.home_pixels).cpu().numpy(), model.home_joints.double().cpu().numpy())


def horizon_of(model: PDVMRNN, config: PlanConfig) -> int:
    return config.horizon or int(model.longest)


def goal_inputs(model: PDVMRNN, goal: Percept, modalities: Modalities) -> Sensed:
    """The goal as the network's inputs; a modality that is not used is filled in and never looked at."""
    looked_at = Percept(
        frame=goal.frame if modalities in ("vision", "both") else home(model).frame,
        joints=goal.joints if modalities in ("joints", "both") else home(model).joints,
    )
    return as_inputs(model, looked_at, name="goal")


def as_inputs(model: PDVMRNN, percept: Percept, *, name: str) -> Sensed:
    """Pixels (C, H, W) and codes (J, K) of a percept.

    Raises:
        ValueError: it has no frame or no joints, they are of another size than the model's, or not finite.
    """
    sensors = model.sensors
    wanted = sensors.height, sensors.width, sensors.channels
    if percept.frame is None or percept.joints is None:
        raise ValueError(f"the {name} has no {'frame' if percept.frame is None else 'joints'}: give one, or plan for the other modality")
    if percept.frame.shape != wanted:
        raise ValueError(f"the {name}'s frame is {percept.frame.shape} (height, width, channels), the model sees {wanted}")
    if len(percept.joints) != sensors.num_joints:
        raise ValueError(f"the {name} has {number_of(len(percept.joints), 'joint')}, the model was trained with {sensors.num_joints}")
    if not np.isfinite(percept.joints).all():
        raise ValueError(f"the {name}'s joints are not finite: {percept.joints.tolist()}")
    if percept.frame.dtype != np.uint8:
        raise ValueError(f"the {name}'s frame holds {percept.frame.dtype}: give 8-bit pixels, 0 to 255 (uint8)")
    joints = torch.as_tensor(percept.joints, dtype=model.home_joints.dtype, device=model.home_joints.device)
    frame = torch.from_numpy(np.ascontiguousarray(percept.frame)).to(model.home_pixels.device)
    return to_pixels(frame).to(model.home_pixels.dtype), model.coding.encode(joints)
