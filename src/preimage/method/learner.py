"""What changes while training: network, optimiser and the number of updates done; what is told of it, and the course of the rates."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from preimage.method.config import TrainConfig
from preimage.method.seam import Augmentation
from preimage.network.pdvmrnn import PDVMRNN
from preimage.storage.checkpoints import write_non_finite


class NonFinite(RuntimeError):
    """The training met a number that is not finite; the text says where, and what would do."""


@dataclass
class Learner:
    """What changes while training: network, optimiser and the number of updates done."""

    model: PDVMRNN
    optimiser: torch.optim.Optimizer
    update: int = 0
    augmentations: Sequence[Augmentation] = ()
    batch_error: Callable[..., tuple[Tensor, ...]] | None = None
    """`BatchError`, recorded at the first batch."""

    def state(self) -> dict[str, Any]:
        return {"update": self.update, "model": self.model.state_dict(), "optimiser": self.optimiser.state_dict()}

    def load(self, state: dict[str, Any]) -> None:
        self.model.load_state_dict(state["model"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.update = state["update"]


@dataclass(frozen=True)
class Progress:
    """What there is to report after each update."""

    update: int
    updates: int
    visual: float
    """Squared error of a frame, summed over pixels, mean of the demonstrations of the batch, weighted sums of several aside."""
    proprioceptive: float
    """KL of the joint codes, summed over joints, likewise (nats)."""
    seconds: float = field(compare=False)
    """Wall time of the update."""


def optimiser_of(model: PDVMRNN, config: TrainConfig) -> torch.optim.Optimizer:
    """Adam on weights and intentions, each at its own rate."""
    weights = [value for name, value in model.named_parameters() if not name.startswith("intention_table.")]
    intentions = list(model.intention_table.parameters())
    groups = [
        {"params": weights, "peak": config.learning_rate},
        {"params": intentions, "peak": config.intention_learning_rate},
    ]
    return torch.optim.Adam(groups, betas=(0.9, 0.99))


def share_of_rate(update: int, config: TrainConfig) -> float:
    """The share of the highest rate at an update: a linear rise, then half a cosine down to `final_share`."""
    rise = min(1.0, (update + 1) / config.warmup_updates)
    fall = 0.5 * (1 + math.cos(math.pi * update / config.updates))
    return rise * (config.final_share + (1 - config.final_share) * fall)


def validate_finite(learner: Learner, errors: Mapping[str, Tensor], norm: Tensor, run: Path | None) -> None:
    """Raises NonFinite, naming the first tensor that is not finite, before it can reach the weights."""
    intentions = (p.grad for p in learner.model.intention_table.parameters() if p.grad is not None)  # which the norm does not hold
    if all(bool(value.isfinite().all()) for value in (*errors.values(), norm, *intentions)):
        return
    gradients = {f"the gradient of {name}": p.grad for name, p in learner.model.named_parameters() if p.grad is not None}
    broken = (name for name, value in (dict(errors) | gradients).items() if not bool(value.isfinite().all()))
    name = next(broken, "the norm of the gradient")
    text = f"{name} is not finite at update {learner.update + 1}: a lower learning rate or precision float32 would do"
    if run:
        write_non_finite(run, learner.update + 1, name)
    raise NonFinite(text)
