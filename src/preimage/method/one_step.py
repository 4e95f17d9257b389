"""One-step prediction (section III-C): the intention comes from a plan, and the robot's own camera and joints go in step by step.

The paper calls a plan played without looking closed loop, and this open loop. What a plan knows besides what its network imagines, where
the hand has to be as it grips and at the goal (`ideas.end_correction`), the network does not know: it is told that the robot stands where
it would stand if the plan were not bent, and what it says is bent as the plan is.
"""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from preimage.ideas.test_time_augmentation import glances
from preimage.method.plan import PlanConfig, as_inputs, imagine_at_a_glance, mean_joints
from preimage.network.intention import unflatten
from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Percept, Plan


def follow(model: PDVMRNN, plan: Plan, *, config: PlanConfig | None = None) -> Callable[[Percept], Float[np.ndarray, " J"]]:
    """A policy that predicts the next joints (rad; gripper: m) from what is sensed, step by step, under the intention of a plan.

    It is asked once a step, first when the robot stands where the plan starts. Each frame is looked at as the start is
    (`PlanConfig.glance`).

    Args:
        config: what the plan was searched with.
    """
    config = replace(config or PlanConfig(), horizon=len(plan.joints))
    start = as_inputs(model, plan.start, name="start")
    intention = unflatten(torch.from_numpy(plan.intention).to(model.home_joints)[None], model.intention_table.shapes)
    with torch.no_grad():
        imagined = imagine_at_a_glance(model, intention, start, config)
    bends = plan.joints - mean_joints(model, imagined.log_codes).cpu().numpy()
    here_and_next = itertools.chain(itertools.pairwise(bends), itertools.repeat((bends[-1], bends[-1])))
    forward, num_looks = model.at(model.pixel_bias.dtype), len(glances(start[0], config.glance))
    states = model.initial_states(intention[torch.zeros(num_looks, dtype=torch.long)])

    def predict(pixels: Float[Tensor, "C H W"], codes: Float[Tensor, "J K"]) -> Float[np.ndarray, " J"]:
        nonlocal states
        with torch.no_grad():
            (_, log_codes), states = forward((glances(pixels, config.glance), codes.expand(num_looks, *codes.shape)), states)
        return mean_joints(model, log_codes).cpu().numpy()

    predict(*start)  # output t is the prediction of percept t, so the first predicts the start itself

    def next_joints(percept: Percept) -> Float[np.ndarray, " J"]:
        here, there = next(here_and_next)
        unbent = None if percept.joints is None else percept.joints - here
        return predict(*as_inputs(model, Percept(percept.frame, unbent), name="percept")) + there

    return next_joints
