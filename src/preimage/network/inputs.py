"""Percepts as the network takes them: the one it begins with where nothing else is known, and any other, checked."""

import numpy as np
import torch

from preimage.network.coding import to_frames, to_pixels
from preimage.network.pdvmrnn import PDVMRNN, InputSequence, Sensed
from preimage.records import Demonstration, Percept, number_of


def home(model: PDVMRNN) -> Percept:
    """The mean first percept of the demonstrations: where a plan starts when nothing else is said."""
    return Percept(to_frames(model.home_pixels).cpu().numpy(), model.home_joints.double().cpu().numpy())


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


def as_input_sequence(model: PDVMRNN, sensed: Demonstration) -> InputSequence:
    """Pixels (1, T, C, H, W) and codes (1, T, J, K) of a sequence sensed at the model's rate; ValueError where a step does not fit."""
    percepts = [as_inputs(model, sensed[step], name=f"step {step}") for step in range(len(sensed))]
    pixels, codes = (torch.stack(parts)[None] for parts in zip(*percepts, strict=True))
    return pixels, codes
