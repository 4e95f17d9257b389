"""Whether the parts of a run can be those of a network, asked before there is room made for it."""

import json
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from preimage.network.config import ModelConfig, Sensors
from preimage.storage.run_files import WEIGHTS

if TYPE_CHECKING:
    import torch

    from preimage.network.pdvmrnn import PDVMRNN

OURS = "home_pixels"
"""A tensor of every network of ours."""
PICKLED = b"\x80", b"PK\x03\x04"
"""How a file begins that `torch.save` wrote, before PyTorch 1.6 and since."""
LONGEST_HEADER = 100 << 20
"""Bytes that safetensors allows."""


def validate_sensors(sensors: Sensors) -> None:
    """Raises ValueError where sensors have no frame or no joints, a joint has no range, or two have one name."""
    if min(sensors.height, sensors.width) < 1 or not 1 <= sensors.channels <= 4:
        raise ValueError(f"frames of {sensors.height}x{sensors.width}x{sensors.channels}")
    if not len(sensors.joint_names) == len(sensors.joint_lower) == len(sensors.joint_upper) > 0:
        raise ValueError("joint_names, joint_lower and joint_upper are not equally many")
    if len(set(sensors.joint_names)) < len(sensors.joint_names):
        raise ValueError("joint_names names one twice")
    for name, low, high in zip(sensors.joint_names, sensors.joint_lower, sensors.joint_upper, strict=True):
        if not low < high:
            raise ValueError(f"{name} goes from {low:g} to {high:g}")


def validate_size(config: ModelConfig, sensors: Sensors, num_sequences: int, *, num_bytes: int) -> None:
    """Raises ValueError where a network is larger than the file of its weights could hold, before there is room made for it."""
    sizes = *config.vision_channels, *config.motor_units, config.top_channels, config.lateral_channels, config.seen_channels
    if min(*sizes, config.units_per_joint, num_sequences) < 1:
        raise ValueError("its network has a size below 1")
    recurrent = 4 * sum(size**2 for size in (*config.vision_channels, *config.motor_units))  # four gates from a layer to itself
    frame, table = math.prod((sensors.height, sensors.width, sensors.channels)), num_sequences * (config.intention_dimensions or 1)
    if 2 * max(recurrent, frame, table, sensors.num_joints * config.units_per_joint) > num_bytes:
        raise ValueError(f"its network is larger than {WEIGHTS}")


def tensors_unlike(model: "PDVMRNN", tensors: "Mapping[str, torch.Tensor]") -> str | None:
    """The first reason why tensors are not the weights of a model; None where they are."""
    wanted = model.state_dict()
    for name in [*wanted, *tensors]:
        if name not in tensors or name not in wanted:
            return f"{WEIGHTS} has {'no' if name in wanted else 'an unknown'} {name}"
        if tensors[name].shape != wanted[name].shape:
            return f"{name} is {tuple(tensors[name].shape)}, the network's {tuple(wanted[name].shape)}"
        if not bool(tensors[name].isfinite().all()):
            return f"{name} holds numbers that are not finite"
    return None


def what_else_it_is(content: bytes) -> str | None:
    r"""What a file is that holds the weights of some other program; None where it may hold ours, damaged or not.

    >>> what_else_it_is(b"\x80\x04.")
    'a pickled file of PyTorch, which is not opened'
    >>> what_else_it_is(b"\x80\x18\0\0\0\0\0\0{")  # safetensors, whose header happens to be 6272 bytes long
    """
    if content.startswith(PICKLED) and content[8:9] != b"{":
        return "a pickled file of PyTorch, which is not opened"
    length = int.from_bytes(content[:8], "little")
    if not 0 < length <= min(LONGEST_HEADER, len(content) - 8):
        return None
    try:
        names = [name for name in json.loads(content[8 : 8 + length]) if name != "__metadata__"]
    except (ValueError, RecursionError):
        return None
    if not names or OURS in names:
        return None
    return f"a checkpoint of another network ({names[0]:.60} and {len(names) - 1} more)"
