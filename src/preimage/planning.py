"""Error regression: find the intention whose imagined future contains the goal (sections II-C and II-D).

The weights stay as they are; only the intention moves, down the gradient of a prediction error that is carried back through the whole
imagined sequence. Recognition compares every step of a sequence that was sensed. Planning knows the two ends alone: what is sensed now
and what is wanted. When the goal is reached is open, so each iteration looks for the step that shows it best, the arrival step.

The error has many valleys. The search therefore starts from several intentions at once, those of the training sequences whose imagined
percepts come nearest to the goal, and goes on with the best of them. It moves in the space that the training intentions span, in their
standard deviations: there, what is seen and what is felt have been learned together.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from preimage.coding import to_frames, to_pixels
from preimage.intention import IntentionSpace, IntentionState
from preimage.model import PDVMRNN, Generated, Inputs
from preimage.prediction_error import VISUAL_WEIGHT, arrival_step, proprioceptive_error, sequence_error, visual_error
from preimage.records import Demonstration, Percept, Plan, Stopped
from preimage.sequences import at_rate


@dataclass(frozen=True)
class PlanConfig:
    """How a plan is searched for."""

    goal: Literal["vision", "joints", "both"] = "vision"
    """The modalities of the goal that are used; the rest of a goal percept is not looked at."""
    candidates: int = 4
    """Intentions regressed side by side."""
    iterations: int = 40
    """Steps of Adam on the intention."""
    learning_rate: float = 0.1
    """Adam's rate, in standard deviations of the training intentions."""
    dimensions: int = 32
    """Directions of the intention space that are searched, those in which the training intentions differ most."""
    intention_cost: float = 0.0
    """Charge for the squared distance from the mean training intention, in standard deviations."""
    horizon: int | None = None
    """Steps imagined, T_max; by default as many as the longest demonstration has."""
    delay_penalty: float = 1.01
    """Factor a step on the goal error when the arrival step is chosen (section II-D)."""
    precision: Literal["bfloat16", "float32"] = "bfloat16"
    """Precision of the layers' arithmetic while searching."""


@dataclass(frozen=True, eq=False)
class Regression:
    """Where a regression of B intentions ended: for each the best iterate seen, with its own error."""

    intention: IntentionState
    error: Float[Tensor, " B"]
    errors: Float[Tensor, "iterations B"]
    stopped: Stopped


@dataclass(frozen=True, eq=False)
class Recognition:
    """The intention that explains a sensed sequence, and the sequence it regenerates."""

    intention: IntentionState
    generated: Generated
    error: float
    """Mean prediction error of a step, both modalities (equation 1)."""
    errors: Float[np.ndarray, " iterations"]
    stopped: Stopped


def regress_intention(
    space: IntentionSpace,
    coordinates: Float[Tensor, "B K"],
    error_of: Callable[[IntentionState], Float[Tensor, " B"]],
    *,
    config: PlanConfig,
) -> Regression:
    """Lower `error_of` from each of B places in the intention space by gradient descent through the imagined sequence.

    The weights are not touched. The error that is returned is that of the intention that is returned: the last value of a loop belongs
    to the step before.
    """
    point = coordinates.clone().requires_grad_()
    optimiser = torch.optim.Adam([point], lr=config.learning_rate)
    best_point, best = coordinates.clone(), coordinates.new_full((len(point),), torch.inf)
    errors: list[Tensor] = []
    stopped = Stopped.ITERATIONS
    for iteration in range(config.iterations + 1):
        with torch.enable_grad():
            error = error_of(space.intention(point))
            objective = error + config.intention_cost * point.square().sum(1)
        found = error.detach() < best
        best = torch.where(found, error.detach(), best)
        best_point[found] = point.detach()[found]
        errors.append(best.clone())
        if has_converged(errors):
            stopped = Stopped.CONVERGED
            break
        if iteration < config.iterations:
            (point.grad,) = torch.autograd.grad(objective.sum(), point)
            optimiser.step()
    with torch.no_grad():
        return Regression(space.intention(best_point), best, torch.stack(errors), stopped)


def has_converged(errors: list[Tensor], window: int = 10, share: float = 0.002) -> bool:
    """Whether the lowest error of all candidates fell by less than a share of itself over the last window."""
    return len(errors) > window and bool(errors[-1].min() > (1 - share) * errors[-1 - window].min())


def imagine(model: PDVMRNN, intention: IntentionState, start: Inputs, *, num_steps: int, precision: str) -> Generated:
    """Generate in closed loop from one start percept, at the precision asked for."""
    pixels, codes = start
    count = len(intention)
    start = pixels.expand(count, *pixels.shape[-3:]), codes.expand(count, *codes.shape[-2:])
    return model.generate_closed_loop(intention, start, num_steps=num_steps, dtype=getattr(torch, precision))


def goal_error(generated: Generated, goal: Inputs, modalities: str) -> Float[Tensor, "B T"]:
    """The goal's part of equation 2, at every imagined step: vision, joints or both."""
    pixels, codes = goal
    error = torch.zeros(generated.pixels.shape[:2], device=generated.pixels.device, dtype=generated.pixels.dtype)
    if modalities in ("vision", "both"):
        error = error + VISUAL_WEIGHT * visual_error(generated.pixels, pixels.expand_as(generated.pixels))
    if modalities in ("joints", "both"):
        error = error + proprioceptive_error(generated.log_codes, codes.expand_as(generated.log_codes))
    return error


def start_error(generated: Generated, start: Inputs) -> Float[Tensor, " B"]:
    """The start's part of equation 2: the first predicted percept against the one observed, both modalities."""
    pixels, codes = start
    visual = visual_error(generated.pixels[:, 0], pixels.expand_as(generated.pixels[:, 0]))
    return VISUAL_WEIGHT * visual + proprioceptive_error(generated.log_codes[:, 0], codes.expand_as(generated.log_codes[:, 0]))


def plan_error(generated: Generated, start: Inputs, goal: Inputs, config: PlanConfig) -> tuple[Float[Tensor, " B"], Int[Tensor, " B"]]:
    """Equation 2 of the paper, and the arrival step it was taken at. The delay penalty picks the step; it does not enter the error."""
    at_every_step = goal_error(generated, goal, config.goal)
    arrival = arrival_step(at_every_step, delay_penalty=config.delay_penalty)
    return start_error(generated, start) + at_every_step.gather(1, arrival[:, None])[:, 0], arrival


def first_guesses(library: Generated, goal: Inputs, config: PlanConfig) -> Int[Tensor, " candidates"]:
    """The training sequences to start from: in turn the one nearest to the goal when it ends, and the one nearest at any step."""
    at_every_step = goal_error(library, goal, config.goal)
    steps = torch.arange(at_every_step.shape[1], device=at_every_step.device)
    at_any = (at_every_step * config.delay_penalty**steps).min(1).values.argsort().tolist()
    at_end = at_every_step[:, -1].argsort().tolist()
    in_turn = [row for pair in zip(at_any, at_end, strict=True) for row in pair]
    return torch.tensor(list(dict.fromkeys(in_turn))[: config.candidates])


def imagine_library(model: PDVMRNN, start: Percept | None = None, *, config: PlanConfig | None = None) -> Generated:
    """What the model imagines for each of its training intentions, from a start percept or from home: first guesses are found in it."""
    config = config or PlanConfig()
    start = start or home(model)
    with torch.no_grad():
        inputs = as_inputs(model, start, name="start")
        table = model.intention_table.intentions()
        return imagine(model, table, inputs, num_steps=horizon_of(model, config), precision=config.precision)


def plan(
    model: PDVMRNN,
    *,
    start: Percept | None = None,
    goal: Percept,
    config: PlanConfig | None = None,
    library: Generated | None = None,
) -> Plan:
    """Imagine a way from the start percept to the goal (section II-D).

    Args:
        model: a trained network.
        start: what is sensed now, frame and joints; by default the mean first percept of the demonstrations.
        goal: what is wanted; of it only the modalities that `config.goal` names are looked at.
        library: imagined training sequences, where they are at hand (`imagine_library`); else they are imagined from the start.

    Returns:
        a plan, always; its error and its reason to have stopped say how far to trust it.

    Raises:
        ValueError: a frame or joints do not fit the model, are missing where they are needed, or are not finite.
    """
    began = time.perf_counter()
    config = config or PlanConfig()
    start = start or home(model)
    from_start = as_inputs(model, start, name="start")
    to_goal = goal_inputs(model, goal, config.goal)
    library = library or imagine_library(model, start, config=config)
    num_steps = horizon_of(model, config)

    def error_of(intention: IntentionState) -> Tensor:
        generated = imagine(model, intention, from_start, num_steps=num_steps, precision=config.precision)
        return plan_error(generated, from_start, to_goal, config)[0]

    space = model.intention_table.space(config.dimensions)
    found = regress_intention(space, space.training[first_guesses(library, to_goal, config)], error_of, config=config)
    best = found.intention[found.error.argmin()[None]]
    with torch.no_grad():
        imagined = imagine(model, best, from_start, num_steps=num_steps, precision=config.precision)
        error, arrival = plan_error(imagined, from_start, to_goal, config)
    return Plan(
        frames=to_frames(imagined.pixels[0]).numpy(),
        joints=model.coding.decode(imagined.log_codes[0].exp()).double().numpy(),
        arrival_step=int(arrival),
        rate_hz=model.config.rate_hz,
        joint_names=model.sensors.joint_names,
        start=start,
        goal=goal,
        error=float(error),
        errors=found.errors.min(1).values.double().numpy(),
        stopped=found.stopped,
        seconds=time.perf_counter() - began,
    )


def recognise(model: PDVMRNN, demonstration: Demonstration, *, config: PlanConfig | None = None) -> Recognition:
    """Infer the intention of a whole sensed sequence, so that the model regenerates it in closed loop (section II-C, equation 1).

    Raises:
        ValueError: frames or joints do not fit the model.
    """
    config = config or PlanConfig()
    sensed = at_rate(demonstration, model.config.rate_hz)
    percepts = [as_inputs(model, sensed[step], name=f"step {step}") for step in range(len(sensed))]
    pixels, codes = (torch.stack(parts)[None] for parts in zip(*percepts, strict=True))
    start, num_steps = percepts[0], len(sensed)

    def against_sensed(generated: Generated) -> Tensor:
        count = len(generated.pixels)
        mask = pixels.new_ones(count, num_steps)
        return sequence_error(generated, pixels.expand_as(generated.pixels), codes.expand_as(generated.log_codes), mask).total

    def error_of(intention: IntentionState) -> Tensor:
        return against_sensed(imagine(model, intention, start, num_steps=num_steps, precision=config.precision))

    space = model.intention_table.space(config.dimensions)
    with torch.no_grad():
        guesses = error_of(model.intention_table.intentions()).argsort()[: config.candidates]
    found = regress_intention(space, space.training[guesses], error_of, config=config)
    best = found.intention[found.error.argmin()[None]]
    with torch.no_grad():
        generated = imagine(model, best, start, num_steps=num_steps, precision=config.precision)
        error = float(against_sensed(generated))
    return Recognition(best, generated, error, found.errors.min(1).values.double().numpy(), found.stopped)


def home(model: PDVMRNN) -> Percept:
    """The mean first percept of the demonstrations: where a plan starts when nothing else is said."""
    return Percept(to_frames(model.home_pixels).numpy(), model.home_joints.double().numpy())


def horizon_of(model: PDVMRNN, config: PlanConfig) -> int:
    return config.horizon or int(model.longest)


def goal_inputs(model: PDVMRNN, goal: Percept, modalities: str) -> Inputs:
    """The goal as the network's inputs; a modality that is not used is filled in and never looked at."""
    looked_at = Percept(
        frame=goal.frame if modalities in ("vision", "both") else home(model).frame,
        joints=goal.joints if modalities in ("joints", "both") else home(model).joints,
    )
    return as_inputs(model, looked_at, name="goal")


def as_inputs(model: PDVMRNN, percept: Percept, *, name: str) -> Inputs:
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
        raise ValueError(f"the {name} has {len(percept.joints)} joints, the model was trained with {sensors.num_joints}")
    if not np.isfinite(percept.joints).all():
        raise ValueError(f"the {name}'s joints are not finite: {percept.joints.tolist()}")
    joints = torch.as_tensor(percept.joints, dtype=model.home_joints.dtype, device=model.home_joints.device)
    frame = torch.from_numpy(np.ascontiguousarray(percept.frame)).to(model.home_pixels.device)
    return to_pixels(frame).to(model.home_pixels.dtype), model.coding.encode(joints)
