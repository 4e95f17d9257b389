"""One-step prediction (section III-C): the intention comes from a plan, and the robot's own camera and joints go in step by step.

The paper calls a plan played without looking closed loop, and this open loop. Where a plan's joints are not those that the network
imagines (`Plan.imagined_joints`), what is predicted differs from what the network predicts in the same way: the network is told that the
robot stands where it would stand if nothing had been corrected.
"""

import itertools

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from preimage.method.seam import Policy
from preimage.network.inputs import as_inputs
from preimage.network.intention import unflatten
from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Percept, Plan


@torch.no_grad()
def follow(model: PDVMRNN, plan: Plan) -> Policy:
    """A policy that predicts the next joints (rad; gripper: m) from what is sensed, step by step, under the intention of a plan.

    It is asked once a step, first when the robot stands where the plan starts.

    Raises:
        ValueError: the plan is of several legs, or a percept does not fit the model.
    """
    if plan.legs:
        raise ValueError("the plan has several legs, each with its intention: follow them one by one (Planner.follow does)")
    corrections = np.zeros_like(plan.joints) if plan.imagined_joints is None else plan.joints - plan.imagined_joints
    here_and_next = itertools.chain(itertools.pairwise(corrections), itertools.repeat((corrections[-1], corrections[-1])))
    start = as_inputs(model, plan.start, name="start")
    intention = unflatten(torch.from_numpy(plan.intention).to(model.home_joints)[None], model.intention_table.shapes)
    forward, states = model.at(model.pixel_bias.dtype), model.initial_states(intention)

    @torch.no_grad()
    def predict(pixels: Float[Tensor, "C H W"], codes: Float[Tensor, "J K"]) -> Float[np.ndarray, " J"]:
        nonlocal states
        (_, log_codes), states = forward((pixels[None], codes[None]), states)
        return model.coding.decode(log_codes.exp())[0].double().cpu().numpy()

    predict(*start)  # output t is the prediction of percept t, so the first predicts the start itself

    def next_joints(percept: Percept) -> Float[np.ndarray, " J"]:
        here, there = next(here_and_next)
        uncorrected = None if percept.joints is None else percept.joints - here
        return predict(*as_inputs(model, Percept(percept.frame, uncorrected), name="percept")) + there

    return next_joints
