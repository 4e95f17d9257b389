"""Mixup: weighted sums of alike demonstrations, what should lie between them and a little beyond, in the intention space.

A hundred points say nothing about the space between them, and a network that has the capacity learns them by heart. A mixed sequence is
generated from a weighted sum of the intentions of a few alike demonstrations, and compared with the same sum of their joints. The picture
between two pictures of an arm is not their sum; coarsely seen it nearly is, so that these are compared through a blur
(`ideas.image_features`). After Zhang et al. 2018.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int, Shaped
from torch import Tensor

from preimage.data.sequences import Sequences
from preimage.ideas.image_features import BLUR, blurred
from preimage.method.seam import Batch

NEIGHBOURS = 6
"""The others in a sum are drawn from so many that are most like the first."""


@dataclass(frozen=True)
class Mixup:
    """Replace the last of a batch, a share of them, by weighted sums."""

    share: float
    """Less than 1, so that some demonstrations are shown as they are."""
    arity: int = 3
    """Demonstrations in a sum; fewer where there are not as many."""
    extrapolation: float = 1.3
    """How far sums reach, in sizes of what their demonstrations span; beyond 1 some lie outside of it."""

    def __call__(self, batch: Batch, sequences: Sequences, generator: torch.Generator) -> Batch:
        count = len(batch.rows)
        num_mixed = int(self.share * count)
        rows, weights = self.draw(batch.rows[:, 0], sequences, generator)
        weights[: count - num_mixed] = torch.eye(weights.shape[1])[0]
        parts = sequences.begun_at(rows.flatten(), torch.zeros(rows.numel(), dtype=torch.long))
        lengths = parts.lengths.view_as(rows).where(weights != 0, 1).amax(1)
        frames = weighted_sum(parts.frames.float(), weights).round().clamp(0, 255).to(parts.frames.dtype)
        mixed = Sequences(frames, weighted_sum(parts.joints, weights), lengths, sequences.rest_steps)
        return replace(batch, rows=rows, weights=weights, sequences=mixed, blurred=torch.arange(count) >= count - num_mixed, blur=coarse)

    def draw(
        self, rows: Int[Tensor, " B"], sequences: Sequences, generator: torch.Generator
    ) -> tuple[Int[Tensor, "B P"], Float[Tensor, "B P"]]:
        """Some of those most alike to each, and weights that sum to 1, drawn evenly over what they span and a little beyond."""
        near = sequences.alike[:, :NEIGHBOURS]
        arity = min(self.arity, near.shape[1] + 1)
        others = torch.rand(len(rows), near.shape[1], generator=generator).argsort(1)[:, : arity - 1]
        even = torch.rand(len(rows), arity, generator=generator).clamp(min=1e-9).log()
        even = even / even.sum(1, keepdim=True)
        return torch.cat([rows[:, None], near[rows].gather(1, others)], 1), 1 / arity + self.extrapolation * (even - 1 / arity)


def weighted_sum(parts: Shaped[Tensor, "BP ..."], weights: Float[Tensor, "B P"]) -> Float[Tensor, "B ..."]:
    return torch.einsum("bp...,bp->b...", parts.unflatten(0, weights.shape), weights.to(parts))


def coarse(pictures: Float[Tensor, "*batch C H W"]) -> Float[Tensor, "*batch C h w"]:
    """Pictures through a blur, of which fewer pixels count as much as all."""
    small = blurred(pictures, BLUR)
    return small * (small.shape[-2:].numel() / pictures.shape[-2:].numel()) ** 0.5
