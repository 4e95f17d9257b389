"""Error regression: move an intention until what is imagined from it has the least prediction error, the weights frozen (section II-C).

The error is carried back through the whole imagined sequence, and Adam moves the intention. As the error has many valleys, several
intentions begin side by side, and those that came lowest after a while go on.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from preimage.method.seam import Objective, Problem, Regression
from preimage.records import Stopped

PATIENCE, LEAST_GAIN = 20, 0.002
"""A search has converged when so many iterations lowered the error by less than this share of it."""


@dataclass(frozen=True, eq=False)
class Descent:
    """For each of B intentions the best iterate, by the error and the charge for the intention together."""

    points: Float[Tensor, "B K"]
    charged: Float[Tensor, " B"]
    error: Float[Tensor, " B"]
    """The prediction error alone."""
    lowest: list[Tensor]
    """The lowest charged error of all, iteration by iteration."""
    stopped: Stopped


def adam(problem: Problem, objective: Objective, guesses: Float[Tensor, "B K"]) -> Regression:
    """Lower the error from each of the guesses; after `config.screening` iterations the `config.finalists` that came lowest go on."""
    config = problem.config
    found = descend(problem, objective, guesses, min(config.screening, config.iterations))
    lowest = found.lowest
    if config.iterations > config.screening:
        finalists = found.points[found.charged.argsort()[: config.finalists]]
        found = descend(problem, objective, finalists, config.iterations - config.screening)
        lowest = lowest + found.lowest[1:]  # the finalists' first iterate is the best of the screening, but for a smaller batch's rounding
    return Regression(problem.space.intention(found.points), found.error, torch.stack(lowest).cummin(0).values, found.stopped)


def descend(problem: Problem, objective: Objective, guesses: Float[Tensor, "B K"], iterations: int) -> Descent:
    """Gradient descent through time. The last value of a loop belongs to the step before, so that every iterate is judged by its own."""
    point = guesses.clone().requires_grad_()
    optimiser = torch.optim.Adam([point], lr=problem.config.learning_rate)
    points, charged, errors = guesses.clone(), guesses.new_full((len(guesses),), torch.inf), guesses.new_zeros(len(guesses))
    lowest: list[Tensor] = []
    for iteration in range(iterations + 1):
        with torch.enable_grad():
            error, _ = objective.errors(problem.imagine(problem.space.intention(point)))
            total = error + problem.config.intention_cost * point.square().sum(1)
        better = total.detach() < charged
        charged, errors = (torch.where(better, now.detach(), best) for now, best in ((total, charged), (error, errors)))
        points[better] = point.detach()[better]
        lowest.append(charged.min())
        if len(lowest) > PATIENCE and lowest[-1] > (1 - LEAST_GAIN) * lowest[-1 - PATIENCE]:
            return Descent(points, charged, errors, lowest, Stopped.CONVERGED)
        if iteration < iterations:
            (point.grad,) = torch.autograd.grad(total.sum(), point)
            optimiser.step()
    return Descent(points, charged, errors, lowest, Stopped.ITERATIONS)
