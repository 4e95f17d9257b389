"""Moments at which a robot switches something: a gripper closes about an object, and opens again.

Between them it moves, and how is its own affair; at them it has to be in the right place. They are found where one joint is, in every
demonstration, nearly always near the one or the other end of its range, and changes sides equally often.

>>> open_, closed = [0.0, 0.0], [1.0, 1.0]
>>> gripper = torch.tensor([open_ + closed + open_, open_ + open_ + closed])[..., None]
>>> find_switches(gripper) is None  # twice in the one, once in the other
True
>>> find_switches(gripper[:1]).steps.tolist()
[[2, 4]]
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

MOST = 4
"""Demonstrations that switch more often than this are not looked through for what is common to them."""
BETWEEN = 0.05
"""A joint that is in the middle third of its range for a larger share of the steps does not switch, it moves."""


@dataclass(frozen=True, eq=False)
class Switches:
    """Which joint switches, and at which K steps of each of N demonstrations it is on the other side for the first time."""

    joint: int
    steps: Int[Tensor, "N K"]


def find_switches(joints: Float[Tensor, "N T J"]) -> Switches | None:
    """The switches that all demonstrations have in common, of the joint that switches most cleanly; None where there are none."""
    lower, upper = joints.amin((0, 1)), joints.amax((0, 1))
    places = (joints - lower) / (upper - lower).clamp(min=1e-9)
    between = ((places - 0.5).abs() < 1 / 6).float().mean((0, 1))
    switched = changes_side(places, 0.5)
    counts = switched.sum(1)  # (N, J)
    common = (counts == counts[0]).all(0) & (counts[0] > 0) & (counts[0] <= MOST) & (between <= BETWEEN)
    if not bool(common.any()):
        return None
    joint = int(torch.where(common, between, torch.inf).argmin())
    return Switches(joint, switched[..., joint].nonzero()[:, 1].view(len(joints), -1))


def changes_side(ways: Float[Tensor, "N T J"], middle: float | Float[Tensor, " J"]) -> Bool[Tensor, "N T J"]:
    """Where each joint is on another side of a value than at the step before."""
    above = ways > middle
    return torch.cat([torch.zeros_like(above[:, :1]), above[:, 1:] != above[:, :-1]], dim=1)
