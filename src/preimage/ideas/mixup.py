"""Blends of demonstrations: what should lie between them, and a little beyond, in the intention space.

A hundred points say nothing about the space between them, and a network that has room learns them by heart. A blend is an intention between
those of a few alike demonstrations, with the joints blended step by step. The picture between two pictures of an arm is not their blend;
coarsely seen it nearly is, so that blends are compared with coarse eyes (`ideas.image_features`).
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int, Shaped
from torch import Tensor

from preimage.data.sequences import Sequences
from preimage.network.intention import IntentionState

NEIGHBOURS = 6
"""The others in a blend are drawn from so many that are most like the first."""


@dataclass(frozen=True, eq=False)
class Blends:
    """Which demonstrations go into each of B sequences, and how much of each; a demonstration by itself has all the weight."""

    rows: Int[Tensor, "B P"]
    weights: Float[Tensor, "B P"]

    def __getitem__(self, chosen: Tensor) -> "Blends":
        return Blends(self.rows[chosen], self.weights[chosen])

    @property
    def blended(self) -> Tensor:
        """Which of them are blends indeed, (B)."""
        return self.weights[:, 0] != 1

    def intention(self, parts: IntentionState) -> IntentionState:
        """The blended intentions, of those of all parts, one after the other."""
        return IntentionState({name: self._blend(values) for name, values in parts.layers.items()})

    def sequences(self, sequences: Sequences, steps: Int[Tensor, " B"]) -> Sequences:
        """The blended sequences, all parts of one from the same step of theirs on; a blend is as long as the longest of them."""
        parts = sequences.begun_at(self.rows.flatten(), steps.repeat_interleave(self.rows.shape[1]))
        lengths = parts.lengths.view_as(self.rows).where(self.weights != 0, 1).amax(1)
        frames = self._blend(parts.frames.float()).round().clamp(0, 255).to(parts.frames.dtype)
        return Sequences(frames, self._blend(parts.joints), lengths, sequences.rest_steps)

    def _blend(self, values: Shaped[Tensor, "parts ..."]) -> Float[Tensor, "B ..."]:
        parts = values.unflatten(0, self.rows.shape)
        return torch.einsum("bp...,bp->b...", parts, self.weights.to(parts))


def draw_blends(
    rows: Int[Tensor, " B"], sequences: Sequences, generator: torch.Generator, *, share: float, parts: int = 3, reach: float = 1.3
) -> Blends:
    """Blend the last of these demonstrations, a share of them, each with some of those most alike; leave the others as they are.

    Args:
        parts: demonstrations in a blend; fewer where there are not as many.
        reach: how far blends reach, in sizes of what their demonstrations span; beyond 1 some lie outside of it.
    """
    num_blends = int(share * len(rows))
    if num_blends == 0:
        return Blends(rows[:, None], torch.ones(len(rows), 1))
    near = sequences.alike[:, :NEIGHBOURS]
    parts = min(parts, near.shape[1] + 1)
    others = torch.rand(len(rows), near.shape[1], generator=generator).argsort(1)[:, : parts - 1]
    even = torch.rand(len(rows), parts, generator=generator).clamp(min=1e-9).log()
    even = even / even.sum(1, keepdim=True)  # evenly over what they span
    weights = 1 / parts + reach * (even - 1 / parts)
    weights[: len(rows) - num_blends] = torch.eye(parts)[0]
    return Blends(torch.cat([rows[:, None], near[rows].gather(1, others)], 1), weights)
