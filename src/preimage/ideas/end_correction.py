"""End correction: a plan ends between the joints that the network imagines at the goal and those that the memory expects there.

The network was trained to regenerate what it was shown, and a goal between what it was shown it imagines a little beside itself: an
arm that looks right in the picture, and joints that are off by a degree or two. The memory is off as well, but elsewhere, and it knows by
how much. So the last joints are the mean of both, each weighed by its inverse variance, that of a plan in doubt the larger the larger its
error. The way is blended to them where it is near the goal: further away, where the hand may have to touch something first, it stays as
imagined, except at gripper events, of which the memory knows the joints as well. Where the goal is given as joints, there the plan ends.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import torch
from jaxtyping import Float
from torch import Tensor

from preimage.ideas.gripper_events import events_in
from preimage.ideas.memory import DemonstrationMemory, Estimate
from preimage.method.seam import Draft, Objective, Problem
from preimage.network.coding import JointCoding

BLEND_WIDTH = 1 / 3
"""How far from its end a way is blended, as a share of the farthest that it is from there."""
DOUBT = 0.05
"""Share of the error of staying at the start from which on the variance of what is imagined grows with its error."""


@dataclass(frozen=True, eq=False)
class TerminalTarget:
    """Joints that a way should pass or end in, and how much of the way there it is to be blended, of 1."""

    joints: Float[Tensor, " J"]
    weight: Float[Tensor, " J"]

    @classmethod
    def certain(cls, joints: Float[Tensor, " J"]) -> Self:
        """Joints that are asked for, and so not to be doubted."""
        return cls(joints, torch.ones_like(joints))

    @classmethod
    def expected(cls, estimate: Estimate, unexplained: float) -> Self:
        """Joints that a memory expects.

        Args:
            unexplained: the error of what is imagined, as a share of the error of staying at the start.
        """
        imagined = estimate.network_deviation.square() * max(1.0, unexplained / DOUBT)
        return cls(estimate.mean, imagined / (imagined + estimate.deviation.square()))


@dataclass(frozen=True, eq=False)
class EndCorrection:
    """Blend a plan to what is asked for or expected at its goal and at its gripper events."""

    memory: DemonstrationMemory
    at_goal: bool = True
    at_events: bool = True

    def __call__(self, draft: Draft, problem: Problem, objective: Objective) -> Draft:
        coding, modalities = problem.model.coding, problem.config.modalities
        if modalities != "vision":
            assert problem.goal_joints is not None
            targets = {draft.arrival: TerminalTarget.certain(problem.goal_joints)} if self.at_goal else {}
            return replace(draft, joints=blend_to(targets, draft.joints, coding))
        known = self.memory.about(problem)
        at_events = known.joints_at_events if self.at_events else []
        at_goal = [known.joints_at_goal] if self.at_goal else []
        steps = events_in(draft.joints[None, : draft.arrival + 1], self.memory.event_joint, coding)[0].nonzero()[:, 0].tolist()
        on_the_way = zip(steps, at_events, strict=True) if len(steps) == len(at_events) else ()
        estimates = dict(on_the_way) | dict(zip([draft.arrival], at_goal, strict=False))
        targets = {step: TerminalTarget.expected(each, draft.unexplained) for step, each in estimates.items()}
        expected = torch.stack([each.mean for each in [*at_events, *at_goal]]) if at_events or at_goal else None
        return replace(draft, joints=blend_to(targets, draft.joints, coding), expected=expected)


def blend_to(targets: Mapping[int, TerminalTarget], joints: Float[Tensor, "T J"], coding: JointCoding) -> Float[Tensor, "T J"]:
    """A way that passes, at some steps, between where it does and other joints, in the joints' units, and stays within their ranges.

    From each of the steps to the next it is blended as much as it is near the next. Distances are measured in the joints' ranges, and a
    joint about which the target says nothing counts for nothing.
    """
    lower, upper = coding.lower.to(joints), coding.upper.to(joints)
    moved, begun, offset = torch.zeros_like(joints), 0, torch.zeros_like(joints[0])
    for step, target in sorted(targets.items()):
        weight, wanted, here = target.weight.to(joints), target.joints.to(joints), joints[step]
        distance = (weight * ((joints[begun:] - here) / (upper - lower)).square()).sum(-1)
        nearness = torch.exp(-distance / (BLEND_WIDTH**2 * distance[: step + 1 - begun].max()).clamp(min=1e-12))
        moved[begun:] = offset + nearness[:, None] * (weight * (wanted - here) - offset)
        begun, offset = step + 1, weight * (wanted - here)
    return (joints + moved).clamp(lower, upper)
