"""A bright bar that moves with the first joint, what is wanted of it, and a network that has seen it: for tests of planning."""

from dataclasses import replace

import numpy as np

from preimage.method.plan import as_inputs
from preimage.method.prediction_error import ToGoal
from preimage.method.train import TrainConfig, train
from preimage.network.config import ModelConfig
from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Demonstration


def bar(far: float, num_steps: int = 6) -> Demonstration:
    """A bright bar that moves with the first joint, as far as is said."""
    joints = np.linspace(0, far, num_steps)[:, None] * np.array([1.0, -0.5])
    columns, place = np.arange(16), 2 + joints[:, :1] * 10
    brightness = np.exp(-(((columns - place) / 1.5) ** 2))  # (T, 16)
    frames = np.repeat((brightness * 220).astype(np.uint8)[:, None, :, None], 16, axis=1)
    return Demonstration(frames, joints, 2.5, ("a", "b"))


def tiny_double(dimensions: int | None = 4) -> PDVMRNN:
    demonstrations = [bar(far) for far in (0.3, 0.6, 0.9)]
    config = TrainConfig(updates=3, rest_steps=2, precision="float32")
    model = train(demonstrations, replace(ModelConfig.tiny(), intention_dimensions=dimensions), config=config)
    return model.double()


def objective(model: PDVMRNN, modalities: str = "vision") -> ToGoal:
    return replace(objective_to(model, bar(0.7)), modalities=modalities)


def objective_to(model: PDVMRNN, shown: Demonstration) -> ToGoal:
    return ToGoal(as_inputs(model, shown.first, name="start"), as_inputs(model, shown.last, name="goal"))
