"""Goal-conditioned behaviour cloning: the baseline that maps what is sensed and the goal straight to the next joints.

It sees the current frame, the current joints and the goal frame, and is trained on the same demonstrations to give the joints of the next
step. There is no imagination and no error regression in it, and it is of about the size of the `small` network.
"""

import itertools
from collections.abc import Callable, Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from preimage.compute.devices import CPU
from preimage.data.sequences import pad, sensors_of
from preimage.network.coding import JointCoding, to_pixels
from preimage.network.config import Sensors
from preimage.network.divergence import proprioceptive_error
from preimage.network.pdvmrnn import Inputs
from preimage.records import Demonstration, Percept

NOISE_SHARE = 0.02
"""Noise on the sensed joints while training, as a share of their range, so that the policy learns to come back to the demonstrated way."""


class Clone(nn.Module):
    """A convolutional network over (frame, goal frame), joined by the joints, with the joints' code as output.

    Args:
        sensors: frame size and joints, as they are in the data.
    """

    def __init__(self, sensors: Sensors, units_per_joint: int = 10) -> None:
        super().__init__()
        self.sensors = sensors
        self.coding = JointCoding(torch.tensor(sensors.joint_lower), torch.tensor(sensors.joint_upper), units_per_joint)
        num_codes = sensors.num_joints * units_per_joint
        channels = (2 * sensors.channels, 32, 64, 64, 64)
        convolutions = [layer for low, high in itertools.pairwise(channels) for layer in (nn.Conv2d(low, high, 4, 2, 1), nn.ReLU())]
        features = channels[-1] * (sensors.height >> 4) * (sensors.width >> 4)
        self.see = nn.Sequential(*convolutions, nn.Flatten())
        self.decide = nn.Sequential(
            nn.Linear(features + num_codes, 512), nn.ReLU(), nn.Linear(512, 512), nn.ReLU(), nn.Linear(512, num_codes)
        )

    def forward(self, sensed: Inputs, goal: Float[Tensor, "B C H W"]) -> Float[Tensor, "B J K"]:
        """Log codes of the next joints."""
        pixels, codes = sensed
        features = torch.cat([self.see(torch.cat([pixels, goal], 1)), codes.flatten(1)], 1)
        return self.decide(features).unflatten(1, codes.shape[1:]).log_softmax(-1)

    def policy_to(self, goal: Percept) -> Callable[[Percept], Float[np.ndarray, " J"]]:
        """A policy towards the goal's frame: from what is sensed to the joints to command next."""
        wanted = self._pixels(goal)

        @torch.no_grad()
        def next_joints(percept: Percept) -> Float[np.ndarray, " J"]:
            joints = torch.as_tensor(percept.joints).to(self.coding.centres)[None]
            log_codes = self((self._pixels(percept), self.coding.encode(joints)), wanted)
            return self.coding.decode(log_codes.exp())[0].double().cpu().numpy()

        return next_joints

    def _pixels(self, percept: Percept) -> Float[Tensor, "1 C H W"]:
        assert percept.frame is not None
        return to_pixels(torch.from_numpy(np.ascontiguousarray(percept.frame)).to(self.coding.centres.device))[None]


def clone(
    demonstrations: Sequence[Demonstration],
    *,
    rate_hz: float,
    updates: int = 3000,
    batch_size: int = 64,
    seed: int = 0,
    place: torch.device = CPU,
) -> Clone:
    """Learn to do what the demonstrations did next, at the rate at which it will be asked."""
    sequences = pad(demonstrations, rate_hz=rate_hz, rest_steps=4)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        policy = Clone(sensors_of(demonstrations)).to(place)
    generator = torch.Generator().manual_seed(seed)
    pixels, joints = to_pixels(sequences.frames.to(place)), sequences.joints.to(place)
    before = (sequences.mask[:, 1:] > 0).nonzero()  # (pairs, 2): sequence, step
    scale = NOISE_SHARE * (policy.coding.upper - policy.coding.lower)
    optimiser = torch.optim.Adam(policy.parameters(), lr=1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, updates)
    for _ in range(updates):
        row, step = before[torch.randint(len(before), (batch_size,), generator=generator)].T
        sensed = joints[row, step] + scale * torch.randn(batch_size, len(scale), generator=generator).to(place)
        predicted = policy((pixels[row, step], policy.coding.encode(sensed)), pixels[row, -1])
        loss = proprioceptive_error(predicted, policy.coding.encode(joints[row, step + 1])).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return policy.requires_grad_(False).eval()
