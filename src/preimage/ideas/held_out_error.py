"""How well a network that is still learning regenerates episodes that it is not shown: their intention is searched for, briefly."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from preimage.compute.precision import Precision
from preimage.data.sequences import at_rate
from preimage.ideas.gauss_newton import GaussNewton
from preimage.method.config import PlanConfig
from preimage.method.error_regression import adam
from preimage.method.plan import recognise
from preimage.method.prediction_error import SequenceError, sequence_error
from preimage.method.seam import Ideas, Objective, Problem
from preimage.network.inputs import as_input_sequence
from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Demonstration

MOST_EPISODES = 4
"""Held-out episodes that are looked at; with what each is given below they cost a training less than a tenth of its time."""
NUM_GUESSES = 16
"""Training intentions, evenly drawn, at the nearest of which a search begins: from their mean it ends far off (docs/log.md)."""
ITERATIONS = {"latent": 8, "free": 10}
"""Of Gauss-Newton for few numbers, of Adam for many."""


def held_out_error(model: PDVMRNN, episodes: Sequence[Demonstration], *, precision: Precision) -> dict[str, float]:
    """The mean prediction error of a step, both modalities, of the first held-out episodes (equation 1), as training reports its own.

    Args:
        precision: of the layers' arithmetic, that of the training.
    """
    kind = model.config.intention
    config = PlanConfig(iterations=ITERATIONS[kind], candidates=1, precision=precision)
    ideas = Ideas(nearest_of_some, GaussNewton(config.iterations) if kind == "latent" else adam)
    errors = [error_of(model, episode, config, ideas) for episode in episodes[:MOST_EPISODES]]
    both = torch.stack([torch.cat([each.visual, each.proprioceptive]) for each in errors]).mean(0).tolist()
    return dict(zip(("visual", "proprioceptive"), both, strict=True))


@torch.no_grad()
def nearest_of_some(problem: Problem, objective: Objective, generator: torch.Generator) -> Float[Tensor, "1 K"]:
    """One guess: of some training intentions, always the same, that from which the episode is regenerated best."""
    training, intentions = problem.space.training, problem.model.intention_table.intentions()
    rows = torch.linspace(0, len(training) - 1, min(NUM_GUESSES, len(training))).long()
    errors, _ = objective.errors(problem.imagine(intentions[rows]))
    return training[rows[errors.argmin()]][None]


def error_of(model: PDVMRNN, episode: Demonstration, config: PlanConfig, ideas: Ideas) -> SequenceError:
    """Both errors of the episode as it is regenerated."""
    found = recognise(model, episode, config=config, ideas=ideas)
    pixels, codes = as_input_sequence(model, at_rate(episode, model.config.rate_hz))
    return sequence_error(found.generated, pixels, codes, pixels.new_ones(pixels.shape[:2]))
