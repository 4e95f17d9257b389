"""Error regression: move an intention until what is imagined from it has the least prediction error, the weights frozen (section II-C).

The error is carried back through the whole imagined sequence, and Adam moves the intention. Several intentions are regressed side by
side, for the error has many valleys.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from preimage.method.seam import Objective, Problem, Regression
from preimage.records import Stopped

PATIENCE, LEAST_GAIN = 20, 0.002
"""A search has converged when so many iterations lowered the error by less than this share of it."""


def adam(problem: Problem, objective: Objective, guesses: Float[Tensor, "B K"]) -> Regression:
    """Lower the error from each of the guesses by gradient descent through time.

    The charge for the intention is part of what is lowered and of what the best iterate is chosen by. The error that is returned is the
    prediction error of the intention that is returned: the last value of a loop belongs to the step before.
    """
    config, space = problem.config, problem.space
    point = guesses.clone().requires_grad_()
    optimiser = torch.optim.Adam([point], lr=config.learning_rate)
    best, best_charged, best_error = guesses.clone(), guesses.new_full((len(guesses),), torch.inf), guesses.new_zeros(len(guesses))
    lowest: list[Tensor] = []
    stopped = Stopped.ITERATIONS
    for iteration in range(config.iterations + 1):
        with torch.enable_grad():
            error, _ = objective.errors(problem.imagine(space.intention(point)))
            charged = error + config.intention_cost * point.square().sum(1)
        better = charged.detach() < best_charged
        best_charged = torch.where(better, charged.detach(), best_charged)
        best_error = torch.where(better, error.detach(), best_error)
        best[better] = point.detach()[better]
        lowest.append(best_charged.min())
        if len(lowest) > PATIENCE and lowest[-1] > (1 - LEAST_GAIN) * lowest[-1 - PATIENCE]:
            stopped = Stopped.CONVERGED
            break
        if iteration < config.iterations:
            (point.grad,) = torch.autograd.grad(charged.sum(), point)
            optimiser.step()
    with torch.no_grad():
        return Regression(space.intention(best), best_error, torch.stack(lowest), stopped)
