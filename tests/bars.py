"""A bright bar that moves with the first joint, and what the method is asked about it: for tests of the method and of its ideas."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from preimage.ideas.hold_goal import Held
from preimage.method.config import PlanConfig, TrainConfig
from preimage.method.prediction_error import ToGoal, goal_terms
from preimage.method.seam import Problem
from preimage.method.train import train
from preimage.network.config import ModelConfig
from preimage.network.pdvmrnn import PDVMRNN
from preimage.presets import PlanOptions
from preimage.records import Demonstration, Percept

EXACT = PlanConfig(precision="float32")
PAPER = PlanOptions(precision="float32")
REGRESSION = replace(PlanOptions.regression(), precision="float32")
SOLVED = replace(REGRESSION, search="gauss_newton", candidates=4, iterations=40, dimensions=32)
FULL = replace(PlanOptions.full(), precision="float32", tolerance=0.0)
"""The presets in the precision that tests compare in; of all ideas those are left out that blur what is compared."""


def bar(far: float, num_steps: int = 6) -> Demonstration:
    """A bright bar that moves with the first joint, as far as is said."""
    joints = np.linspace(0, far, num_steps)[:, None] * np.array([1.0, -0.5])
    columns, place = np.arange(16), 2 + joints[:, :1] * 10
    brightness = np.exp(-(((columns - place) / 1.5) ** 2))  # (T, 16)
    frames = np.repeat((brightness * 220).astype(np.uint8)[:, None, :, None], 16, axis=1)
    return Demonstration(frames, joints, 2.5, ("a", "b"))


def bars() -> list[Demonstration]:
    """Six that go farther and farther."""
    return [bar(far) for far in np.linspace(0.2, 1, 6)]


def learned(network: ModelConfig) -> PDVMRNN:
    """A network that learned the six bars a little."""
    rates = {"learning_rate": 4e-2, "intention_learning_rate": 4e-2, "warmup_updates": 5}
    return train(bars(), network, config=TrainConfig(updates=70, batch_size=6, rest_steps=3, precision="float32", **rates))


def tiny_double(network: ModelConfig | None = None) -> PDVMRNN:
    """A network that learned next to nothing, in double precision."""
    config = TrainConfig(updates=3, rest_steps=2, precision="float32")
    return train([bar(far) for far in (0.3, 0.6, 0.9)], network or ModelConfig.tiny(), config=config).double()


def problem_to(model: PDVMRNN, shown: Demonstration, *, start: Percept | None = None, **changes: Any) -> Problem:
    """From the first percept of a demonstration to its last, in the precision of the weights."""
    config = replace(EXACT, precision=str(model.pixel_bias.dtype).removeprefix("torch."), **changes)
    return Problem.between(model, start or shown.first, shown.last, config)


def objective_of(problem: Problem, *, held: bool = False) -> ToGoal:
    """The paper's objective, or the same of a goal that is held."""
    terms = goal_terms(problem.goal, problem.config.modalities)
    return ToGoal(problem.start, [Held(terms)] if held else terms, problem.config.delay_penalty)


def nearly(codes: torch.Tensor) -> torch.Tensor:
    """Log codes a few percent off."""
    return (codes.log() + torch.linspace(-0.05, 0.05, codes.shape[-1])).log_softmax(-1)
