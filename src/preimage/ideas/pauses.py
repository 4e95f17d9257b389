"""Pauses: the moment amid each demonstration at which the robot is slowest, for there something may be done on the way to the goal.

What is touched or taken there often stands in the first picture, so that the joints at the pause can be predicted from it
(`ideas.memory`), as those at the end can be from the last. Where nothing is done on the way the slowest moment is any, and nothing
predicts it.

>>> way = torch.tensor([0.0, 0.0, 1.0, 2.0, 2.1, 3.0, 4.0, 4.0])[None, :, None]
>>> slowest_steps(way).tolist()
[4]
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor

UNDER_WAY = 0.3
"""A robot is under way from the first step to the last that is faster than this share of its fastest."""


def slowest_steps(joints: Float[Tensor, "N T J"]) -> Int[Tensor, " N"]:
    """The step of each demonstration before and after which the robot moves least, while it is under way.

    Args:
        joints: padded (`data.sequences.pad`), each joint in shares of its range.
    """
    speeds = joints.diff(dim=1).norm(dim=2)  # (N, T - 1), of step t to t + 1
    fast = speeds > UNDER_WAY * speeds.amax(1, keepdim=True)
    set_out, to_go = fast.cumsum(1) > 0, fast.flip(1).cumsum(1).flip(1) > 0
    never = torch.full_like(speeds[:, :1], torch.inf)
    before, after = speeds.masked_fill(~set_out, torch.inf), speeds.masked_fill(~to_go, torch.inf)
    return (torch.cat([never, before], 1) + torch.cat([after, never], 1)).argmin(1)
