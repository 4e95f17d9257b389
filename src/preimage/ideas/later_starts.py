"""Later starts: a share of the sequences of a batch begin at a later step of their demonstration, under the same intention.

What is wanted stays the same wherever the robot stands, so that the intention learns to hold where the way leads, and leaves to the percept
where it starts. And the robot may stand anywhere.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Int
from torch import Tensor

from preimage.data.sequences import Sequences
from preimage.method.seam import Batch


@dataclass(frozen=True)
class LaterStarts:
    """Let a share of the sequences begin at any of their steps."""

    share: float

    def __call__(self, batch: Batch, sequences: Sequences, generator: torch.Generator) -> Batch:
        drawn = batch.sequences
        steps = self.first_steps(drawn.lengths, generator)
        return replace(batch, sequences=drawn.begun_at(torch.arange(len(steps)), steps))

    def first_steps(self, lengths: Int[Tensor, " B"], generator: torch.Generator) -> Int[Tensor, " B"]:
        later, where = torch.rand(2, len(lengths), generator=generator)
        return (where * lengths).long() * (later < self.share)
