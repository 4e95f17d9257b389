"""Where a plan arrives: what the network imagines of a goal and what memory tells of it, each weighed by how far it may be off.

The network was trained to regenerate what it was shown, and a goal between what it was shown it imagines a little beside itself: an
arm that looks right in the picture, and joints that are off by a degree or two. Memory (`ideas.memory.expected_joints`) is off as well,
but elsewhere, and it knows by how much. So the last joints are the mean of both, each weighed by its inverse variance, that of a plan in
doubt the larger the larger its error. The way is bent to them where it is near the goal: further away, where the hand may have to touch
something first, it stays as imagined, unless memory tells what it should be there: where the robot switches something
(`ideas.gripper_events`), it is bent in the same way. Where the goal is given as joints nothing has to be weighed: there the plan ends.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from preimage.method.prediction_error import ExpectedJoints
from preimage.network.coding import JointCoding

NEAR = 1 / 3
"""How far from its end a way is bent, as a share of the farthest that it is from there."""

SURE = 0.05
"""Share of the error of staying at the start from which on the variance of what is imagined grows with its error."""


@dataclass(frozen=True, eq=False)
class End:
    """The joints in which a way should end, and how much of the way there it is to be bent, of 1."""

    joints: Float[Tensor, " J"]
    weight: Float[Tensor, " J"]

    @classmethod
    def certain(cls, joints: Float[np.ndarray, " J"]) -> Self:
        """Joints that are asked for, and so not to be doubted."""
        return cls(torch.as_tensor(joints), torch.ones(len(joints)))

    @classmethod
    def expected(cls, expected: ExpectedJoints, unexplained: float) -> Self:
        """Joints that memory tells.

        Args:
            unexplained: the error of what is imagined, as a share of the error of staying at the start.
        """
        imagined = expected.imagined.square() * max(1.0, unexplained / SURE)
        return cls(expected.mean, imagined / (imagined + expected.deviation.square()))


def bent_to(ends: Mapping[int, End], joints: Float[Tensor, "T J"], coding: JointCoding) -> Float[Tensor, "T J"]:
    """A way that passes, at some steps, between where it does and other joints, in the joints' units, and stays within their ranges.

    From each of the steps to the next it is bent as much as it is near the next. Distances are measured in the joints' ranges, and a
    joint of which the other end tells nothing counts for nothing.
    """
    lower, upper = coding.lower.to(joints), coding.upper.to(joints)
    moved, begun, bend = torch.zeros_like(joints), 0, torch.zeros_like(joints[0])
    for step, end in sorted(ends.items()):
        weight, wanted, here = end.weight.to(joints), end.joints.to(joints), joints[step]
        apart = (weight * ((joints[begun:] - here) / (upper - lower)).square()).sum(-1)
        nearness = torch.exp(-apart / (NEAR**2 * apart[: step + 1 - begun].max()).clamp(min=1e-12))
        moved[begun:] = bend + nearness[:, None] * (weight * (wanted - here) - bend)
        begun, bend = step + 1, weight * (wanted - here)
    return (joints + moved).clamp(lower, upper)
