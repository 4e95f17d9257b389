"""Planning and recognition: find the intention whose imagined future contains the goal (sections II-C and II-D).

Recognition compares every step of a sequence that was sensed. Planning knows the two ends alone: what is sensed now and what is wanted.
When the goal is reached is open, so each iteration looks for the step that shows it best, the arrival step. The search begins at the
training intentions whose imagined percepts come nearest to the goal (`regression` goes on from there).
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from preimage.coding import to_frames, to_pixels
from preimage.intention import IntentionState, unflatten
from preimage.model import PDVMRNN, Generated, Inputs, InputSequence
from preimage.prediction_error import (
    VISUAL_WEIGHT,
    arrival_step,
    proprioceptive_error,
    proprioceptive_residuals,
    sequence_error,
    visual_error,
    visual_residuals,
)
from preimage.records import Demonstration, Percept, Plan, Stopped
from preimage.regression import RegressionConfig, regress_intention
from preimage.sequences import at_rate

Modalities = Literal["vision", "joints", "both"]


@dataclass(frozen=True)
class PlanConfig(RegressionConfig):
    """How a plan is searched for."""

    goal: Modalities = "vision"
    """The modalities of the goal that are used; the rest of a goal percept is not looked at."""
    horizon: int | None = None
    """Steps imagined, T_max; by default as many as the longest demonstration has."""
    delay_penalty: float = 1.01
    """Factor a step on the goal error when the arrival step is chosen (section II-D)."""


@dataclass(frozen=True, eq=False)
class Recognition:
    """The intention that explains a sensed sequence, and the sequence it regenerates."""

    intention: IntentionState
    generated: Generated
    error: float
    """Mean prediction error of a step, both modalities (equation 1)."""
    errors: Float[np.ndarray, " iterations"]
    stopped: Stopped


@dataclass(frozen=True, eq=False)
class ToGoal:
    """Equation 2: the first percept as observed, the goal at the step that shows it best."""

    start: Inputs
    goal: Inputs
    modalities: Modalities
    delay_penalty: float

    def errors(self, generated: Generated) -> tuple[Float[Tensor, " B"], Int[Tensor, " B"]]:
        """The prediction error and the arrival step. The delay penalty picks the step; it does not enter the error."""
        at_every_step = goal_error(generated, self.goal, self.modalities)
        arrival = arrival_step(at_every_step, delay_penalty=self.delay_penalty)
        return start_error(generated, self.start) + at_every_step.gather(1, arrival[:, None])[:, 0], arrival

    def residuals(self, generated: Generated, aims: Int[Tensor, " B"]) -> Float[Tensor, "B R"]:
        """The same error at given arrival steps, as residuals."""
        pixels, log_codes = generated.pixels, generated.log_codes
        rows = torch.arange(len(pixels), device=pixels.device)
        parts = [visual_residuals(pixels[:, 0], self.start[0]), proprioceptive_residuals(log_codes[:, 0], self.start[1])]
        if self.modalities != "joints":
            parts.append(visual_residuals(pixels[rows, aims], self.goal[0]))
        if self.modalities != "vision":
            parts.append(proprioceptive_residuals(log_codes[rows, aims], self.goal[1]))
        return torch.cat([part.flatten(1) for part in parts], dim=1)

    def steps_until(self, aims: Int[Tensor, " B"]) -> int:
        return int(aims.max()) + 1


@dataclass(frozen=True, eq=False)
class ToSequence:
    """Equation 1: every percept of a sensed sequence."""

    sensed: InputSequence

    def errors(self, generated: Generated) -> tuple[Float[Tensor, " B"], Int[Tensor, " B"]]:
        """The mean prediction error of a step; there is nothing to aim at."""
        pixels, codes = (part.expand(len(generated.pixels), *part.shape[1:]) for part in self.sensed)
        error = sequence_error(generated, pixels, codes, pixels.new_ones(pixels.shape[:2])).total
        return error, torch.zeros(len(error), dtype=torch.long, device=error.device)

    def residuals(self, generated: Generated, aims: Int[Tensor, " B"]) -> Float[Tensor, "B R"]:
        """The same error as residuals."""
        pixels, codes = self.sensed
        visual = visual_residuals(generated.pixels, pixels)
        felt = proprioceptive_residuals(generated.log_codes, codes)
        return torch.cat([part.flatten(1) for part in (visual, felt)], dim=1) / pixels.shape[1] ** 0.5

    def steps_until(self, aims: Int[Tensor, " B"]) -> None:
        return None


def imagine(model: PDVMRNN, intention: IntentionState, start: Inputs, *, num_steps: int, precision: str) -> Generated:
    """Generate in closed loop from one start percept, at the precision asked for."""
    pixels, codes = (part.expand(len(intention), *part.shape) for part in start)
    return model.generate_closed_loop(intention, (pixels, codes), num_steps=num_steps, dtype=getattr(torch, precision))


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


@dataclass(frozen=True, eq=False)
class Library:
    """What the model imagines for each of its training intentions from one start: first guesses are looked up in it."""

    start: Inputs
    imagined: Generated

    def begins_at(self, start: Inputs) -> bool:
        """Whether a plan may begin at this start as well: nothing that can be seen or felt stands elsewhere."""
        visual = visual_error(self.start[0], start[0])
        felt = proprioceptive_error(self.start[1].log(), start[1])
        return bool(visual < SAME_VISUAL) and bool(felt < SAME_PROPRIOCEPTIVE)


SAME_VISUAL, SAME_PROPRIOCEPTIVE = 10.0, 0.1
"""Percepts nearer than this to each other, in the errors of `prediction_error`, are alike enough to share a library."""


def imagine_library(model: PDVMRNN, start: Percept | None = None, *, config: PlanConfig | None = None) -> Library:
    """What the model imagines for each of its training intentions, from a start percept or from home."""
    config = config or PlanConfig()
    inputs = as_inputs(model, start or home(model), name="start")
    with torch.no_grad():
        table = model.intention_table.intentions()
        return Library(inputs, imagine(model, table, inputs, num_steps=horizon_of(model, config), precision=config.precision))


def first_guesses(library: Library, goal: Inputs, coordinates: Float[Tensor, "N K"], config: PlanConfig) -> Float[Tensor, "candidates K"]:
    """Where to begin: blends of the training intentions that end like the goal, then in turn the one nearest to it at any step and when
    it ends.
    """
    ends, wanted = end_features(library.imagined, goal, config.goal)
    blends = [blend_towards(wanted, ends, coordinates, neighbours) for neighbours in BLENDED if neighbours <= len(ends)]
    at_every_step = goal_error(library.imagined, goal, config.goal)
    steps = torch.arange(at_every_step.shape[1], device=at_every_step.device)
    at_any = (at_every_step * config.delay_penalty**steps).min(1).values.argsort().tolist()
    at_end = at_every_step[:, -1].argsort().tolist()
    in_turn = [row for pair in zip(at_any, at_end, strict=True) for row in pair]
    nearest = list(dict.fromkeys(in_turn))
    return torch.cat([*(blend[None] for blend in blends), coordinates[nearest]])[: config.candidates]


BLENDED = (10, 6)
"""How many training intentions are blended into a first guess."""
COARSE = 8
"""Pixels a side of the blocks whose mean greys are compared: so coarse that an arm beside the goal's still overlaps it."""


def end_features(imagined: Generated, goal: Inputs, modalities: Modalities) -> tuple[Float[Tensor, "N F"], Float[Tensor, " F"]]:
    """How the imagined sequences end and what is wanted, coarsely seen and felt."""
    pixels = torch.cat([imagined.pixels[:, -1], goal[0][None]])
    codes = torch.cat([imagined.log_codes[:, -1].exp(), goal[1][None]])
    seen = VISUAL_WEIGHT**0.5 * COARSE * nn.functional.avg_pool2d(pixels, COARSE).flatten(1)
    parts = {"vision": [seen], "joints": [codes.flatten(1)], "both": [seen, codes.flatten(1)]}[modalities]
    features = torch.cat(parts, 1)
    return features[:-1], features[-1]


def blend_towards(
    wanted: Float[Tensor, " F"], features: Float[Tensor, "N F"], coordinates: Float[Tensor, "N K"], neighbours: int
) -> Float[Tensor, " K"]:
    """The coordinates of the nearest features, weighted so that their features blend into what is wanted (Roweis and Saul 2000)."""
    nearest = (features - wanted).square().sum(1).argsort()[:neighbours]
    apart = features[nearest] - wanted
    gram = apart @ apart.T
    ridge = 0.01 * gram.trace() / neighbours + 1e-9
    weights = torch.linalg.solve(gram + ridge * torch.eye(neighbours).to(gram), gram.new_ones(neighbours))
    return weights / weights.sum() @ coordinates[nearest]


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
        goal: what is wanted; of it only the modalities that `config.goal` names are looked at.
        library: imagined training sequences (`imagine_library`), used where they begin as the plan does; else they are imagined anew.

    Returns:
        a plan, always; its error and its reason to have stopped say how far to trust it.

    Raises:
        ValueError: a frame or joints do not fit the model, are missing where they are needed, or are not finite.
    """
    began = time.perf_counter()
    config = config or PlanConfig()
    start = start or home(model)
    objective = ToGoal(as_inputs(model, start, name="start"), goal_inputs(model, goal, config.goal), config.goal, config.delay_penalty)
    if library is None or not library.begins_at(objective.start):
        library = imagine_library(model, start, config=config)

    def from_start(intention: IntentionState, num_steps: int | None = None) -> Generated:
        return imagine(model, intention, objective.start, num_steps=num_steps or horizon_of(model, config), precision=config.precision)

    space = model.intention_table.space(config.dimensions)
    guesses = first_guesses(library, objective.goal, space.training, config)
    found = regress_intention(space, guesses, from_start, objective, config=config)
    with torch.no_grad():
        imagined = from_start(found.best)
        error, arrival = objective.errors(imagined)
    return Plan(
        frames=to_frames(imagined.pixels[0]).numpy(),
        joints=model.coding.decode(imagined.log_codes[0].exp()).double().numpy(),
        arrival_step=int(arrival),
        rate_hz=model.config.rate_hz,
        joint_names=model.sensors.joint_names,
        start=start,
        goal=goal,
        error=float(error),
        errors=found.errors.double().numpy(),
        stopped=found.stopped,
        seconds=time.perf_counter() - began,
        intention=found.best.flatten()[0].double().numpy(),
    )


def imagine_without_goal(model: PDVMRNN, start: Percept, *, config: PlanConfig | None = None) -> Plan:
    """What the model imagines when nothing is wanted: its intention at the prior mean. The baseline that shows what a goal buys."""
    config = config or PlanConfig()
    began = time.perf_counter()
    intention = model.intention_table.prior_mean(1)
    num_steps = horizon_of(model, config)
    with torch.no_grad():
        inputs = as_inputs(model, start, name="start")
        imagined = imagine(model, intention, inputs, num_steps=num_steps, precision=config.precision)
    return Plan(
        frames=to_frames(imagined.pixels[0]).numpy(),
        joints=model.coding.decode(imagined.log_codes[0].exp()).double().numpy(),
        arrival_step=num_steps - 1,
        rate_hz=model.config.rate_hz,
        joint_names=model.sensors.joint_names,
        start=start,
        goal=Percept(),
        error=float(start_error(imagined, inputs)),
        errors=np.zeros(0),
        stopped=Stopped.ITERATIONS,
        seconds=time.perf_counter() - began,
        intention=intention.flatten()[0].double().numpy(),
    )


def follow(model: PDVMRNN, plan: Plan) -> Callable[[Percept], Float[np.ndarray, " J"]]:
    """A policy that predicts one step ahead from what is sensed, step by step, under the intention of a plan (open loop).

    The paper calls it one-step prediction (section III-C): closed loop finds the intention, then the robot's own camera and joints go in
    and the next joints come out.
    """
    forward = model.at(model.pixel_bias.dtype)
    table = model.intention_table
    intention = unflatten(torch.from_numpy(plan.intention).to(model.home_joints.dtype)[None], table.shapes)
    states = [model.initial_states(intention)]

    def predict(percept: Percept) -> Inputs:
        pixels, codes = as_inputs(model, percept, name="percept")
        with torch.no_grad():
            predicted, states[0] = forward((pixels[None], codes[None]), states[0])
        return predicted

    predict(plan.start)  # output t is the prediction of percept t, so the first predicts the start itself

    def next_joints(percept: Percept) -> Float[np.ndarray, " J"]:
        _, log_codes = predict(percept)
        return model.coding.decode(log_codes[0].exp()).double().numpy()

    return next_joints


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
    return Recognition(found.best, generated, float(error), found.errors.double().numpy(), found.stopped)


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
