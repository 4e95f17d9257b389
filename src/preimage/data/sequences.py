"""Demonstrations as the network takes them: at the model's rate, padded to one length, with a mask.

>>> import numpy as np
>>> demonstration = Demonstration(np.zeros((6, 4, 4, 1), np.uint8), np.arange(6.0)[:, None], 10.0, ("yaw",))
>>> at_rate(demonstration, 5.0).joints[:, 0].tolist()  # every second step, and always the last
[0.0, 2.0, 4.0, 5.0]
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from preimage.data.joint_range import LIMIT_MARGIN
from preimage.network.config import Sensors
from preimage.records import Demonstration


def at_rate(demonstration: Demonstration, rate_hz: float) -> Demonstration:
    """The demonstration at a coarser rate: the steps nearest to the model's clock, the first and the last always among them, none twice.

    Where the model's clock ticks between two steps of the recording, it is stretched or shortened so that it ends on the last step: the
    steps are then as far apart as one another, but for one.

    Raises:
        ValueError: the rate is above the recording's.
    """
    if rate_hz > demonstration.rate_hz:
        raise ValueError(f"the model runs at {rate_hz:g} Hz, the recording at {demonstration.rate_hz:g} Hz: record faster or lower rate_hz")
    steps = _steps_at(demonstration.rate_hz / rate_hz, len(demonstration) - 1)
    return replace(demonstration, frames=demonstration.frames[steps], joints=demonstration.joints[steps], rate_hz=rate_hz)


def _steps_at(stride: float, last: int) -> Int[np.ndarray, " S"]:
    """
    >>> _steps_at(2.0, 5).tolist(), _steps_at(7.5, 8).tolist(), _steps_at(2.5, 9).tolist()
    ([0, 2, 4, 5], [0, 8], [0, 2, 4, 7, 9])
    """
    if abs(stride - round(stride)) < 1e-9:
        return np.append(np.arange(0, last, round(stride)), last)
    num_intervals = max(round(last / stride), int(np.ceil(last / np.ceil(stride))))
    return np.linspace(0, last, num_intervals + 1).round().astype(int)


def sensors_of(demonstrations: Sequence[Demonstration]) -> Sensors:
    """Frame size and joints as they are in the data; every demonstration must agree."""
    first = demonstrations[0]
    for index, other in enumerate(demonstrations):
        if other.frames.shape[1:] != first.frames.shape[1:]:
            raise ValueError(
                f"demonstration {index} has frames of {other.frames.shape[1:]}, the first of {first.frames.shape[1:]} (H, W, C)"
            )
        if other.joint_names != first.joint_names:
            raise ValueError(f"demonstration {index} has joints {other.joint_names}, the first {first.joint_names}")
    joints = np.concatenate([demonstration.joints for demonstration in demonstrations])
    lower, upper = joints.min(0), joints.max(0)
    margin = np.maximum(LIMIT_MARGIN * (upper - lower), 1e-3)  # a joint that never moves still needs a range
    height, width, channels = first.frames.shape[1:]
    limits = tuple((lower - margin).tolist()), tuple((upper + margin).tolist())
    return Sensors(height, width, channels, first.joint_names, *limits)


@dataclass(frozen=True, eq=False)
class Sequences:
    """N demonstrations padded to T steps. After its last step a sequence repeats it, for a robot that has arrived rests."""

    frames: UInt8[Tensor, "N T H W C"]
    joints: Float[Tensor, "N T J"]
    lengths: Int[Tensor, " N"]
    rest_steps: int
    """Steps of rest after the last recorded one that count."""

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def mask(self) -> Float[Tensor, "N T"]:
        """1 where a step counts: the recorded steps and the first few of rest."""
        return (torch.arange(self.frames.shape[1]) < self.lengths[:, None] + self.rest_steps).float()

    @cached_property
    def alike(self) -> Int[Tensor, "N others"]:
        """For each sequence the others, that whose joints are most like its own, step by step, first."""
        sizes = (self.joints.amax((0, 1)) - self.joints.amin((0, 1))).clamp(min=1e-6)
        ways = (self.joints / sizes).flatten(1)
        return torch.cdist(ways, ways).fill_diagonal_(-1).argsort(1)[:, 1:]

    def begun_at(self, rows: Int[Tensor, " B"], steps: Int[Tensor, " B"]) -> "Sequences":
        """Some of them, each from a step of its own on, padded to the same length."""
        longest = self.frames.shape[1]
        at = rows[:, None], (steps[:, None] + torch.arange(longest)).clamp(max=longest - 1)
        return Sequences(self.frames[at], self.joints[at], self.lengths[rows] - steps, self.rest_steps)


def pad(demonstrations: Sequence[Demonstration], *, rate_hz: float, rest_steps: int = 0) -> Sequences:
    """Demonstrations at `rate_hz`, padded to the longest of them; of the steps at rest the first `rest_steps` count.

    Raises:
        ValueError: there is no demonstration, or they do not agree in frame size or joints.
    """
    if not demonstrations:
        raise ValueError("there is no demonstration: give one or more")
    sensors_of(demonstrations)
    resampled = [at_rate(demonstration, rate_hz) for demonstration in demonstrations]
    lengths = torch.tensor([len(demonstration) for demonstration in resampled])
    longest = int(lengths.max())
    steps = [np.minimum(np.arange(longest), len(demonstration) - 1) for demonstration in resampled]
    frames = np.stack([demonstration.frames[at] for demonstration, at in zip(resampled, steps, strict=True)])
    joints = np.stack([demonstration.joints[at] for demonstration, at in zip(resampled, steps, strict=True)])
    return Sequences(torch.from_numpy(frames), torch.from_numpy(joints).float(), lengths, rest_steps)
