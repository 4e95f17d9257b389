"""Where a plan arrives: what the network imagines of a goal and what memory tells of it, each weighed by how far it may be off.

The network was trained to regenerate what it was shown, and a goal between what it was shown it imagines a little beside itself: an
arm that looks right in the picture, and joints that are off by a degree or two. Memory (`first_guess.expected_joints`) is off as well,
but elsewhere, and it knows by how much. So the last joints are the mean of both, each weighed by its inverse variance, and the way is
bent to them where it is near the goal: further away, where the hand may have to touch something first, it stays as imagined. Where the
goal is given as joints nothing has to be weighed: there the plan ends.
"""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from preimage.coding import JointCoding
from preimage.prediction_error import ExpectedJoints

NEAR = 1 / 3
"""How far from its end a way is bent, as a share of the distance from its start to its end."""


def certain(coding: JointCoding, joints: Float[np.ndarray, " J"]) -> ExpectedJoints:
    """Joints that are asked for, and so not to be doubted."""
    mean = torch.as_tensor(joints, dtype=coding.lower.dtype, device=coding.lower.device)
    return ExpectedJoints(coding, mean, deviation=torch.zeros_like(mean), weight=torch.ones_like(mean))


def bent_to(expected: ExpectedJoints, joints: Float[Tensor, "T J"], arrival_step: int) -> Float[Tensor, "T J"]:
    """A way that arrives between the imagined and the expected joints, in the joints' units, and stays within their ranges.

    Distances are measured in the joints' ranges, and a joint of which memory tells nothing counts for nothing.
    """
    known = expected.weight, expected.mean, expected.coding.lower, expected.coding.upper
    weight, mean, lower, upper = (each.to(joints) for each in known)
    end = joints[arrival_step]
    apart = (weight * ((joints - end) / (upper - lower)).square()).sum(-1)  # (T,)
    nearness = torch.exp(-apart / (NEAR**2 * apart[0]).clamp(min=1e-12))
    return (joints + nearness[:, None] * weight * (mean - end)).clamp(lower, upper)
