"""How far two trainings of one network lie apart, measured by what they learned: an update changes weights by less than most bounds."""

from dataclasses import replace

import torch

from preimage.method.train import TrainConfig

STANDING_STILL = 1e-12


def learning_nothing(config: TrainConfig) -> TrainConfig:
    """The same training with rates so small that the weights stay where they began."""
    return replace(config, learning_rate=STANDING_STILL, intention_learning_rate=STANDING_STILL)


def apart(one: torch.nn.Module, other: torch.nn.Module, *, begun: torch.nn.Module) -> float:
    """Norm of the difference of two trained networks, as a share of that from the weights they began with to those they have."""
    first, second, before = (torch.cat([value.detach().cpu().flatten() for value in model.parameters()]) for model in (one, other, begun))
    learned = (second - before).norm()
    assert learned > 0
    return float((first - second).norm() / learned)
