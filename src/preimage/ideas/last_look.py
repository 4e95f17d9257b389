"""A last look: arrived and at rest, the robot compares the picture it sees with the goal's, in joints.

An encoder that is a little off brings the arm beside the goal, and nothing that is felt says so; the picture does. The memory says of any
picture of an arm at rest which joints go with it. It is off itself, but of two pictures that look nearly alike it is off alike: the
difference of what it says of the goal and of what is seen is how far the arm still has to go.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from preimage.ideas.memory import DemonstrationMemory
from preimage.method.seam import Problem

SURE = 1.0
"""Differences are made up for in full where they are many times the memory's own deviation, and by half where they are so many."""


@dataclass(frozen=True, eq=False)
class LastLook:
    """How far the joints that go with a picture are from those that go with the goal's."""

    memory: DemonstrationMemory

    @torch.no_grad()
    def __call__(self, problem: Problem, pixels: Float[Tensor, "C H W"]) -> Float[Tensor, " J"]:
        """What to add to the joints, in their units; what may be the memory's own error is shrunk away.

        Args:
            pixels: what is seen.
        """
        wanted = self.memory.about(problem).joints_at_goal
        seen = replace(self.memory, _last=[]).about(replace(problem, goal=(pixels, problem.goal[1]))).joints_at_goal
        missing = wanted.mean - seen.mean
        noise = SURE * wanted.deviation.square()
        return torch.where(noise.isfinite(), missing * missing.square() / (missing.square() + noise), 0.0)
