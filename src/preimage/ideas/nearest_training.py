"""Beginning at training intentions: those whose imagined sequences come nearest to what is wanted."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from preimage.method.prediction_error import ToGoal
from preimage.method.seam import Objective, Problem


@dataclass(frozen=True)
class NearestToGoal:
    """In turn the training intention that comes nearest to the goal at any step, and the one that ends nearest to it."""

    candidates: int

    @torch.no_grad()
    def __call__(self, problem: Problem, objective: Objective, generator: torch.Generator) -> Float[Tensor, "B K"]:
        assert isinstance(objective, ToGoal)
        at_every_step = objective.goal_error(problem.rollouts)
        steps = torch.arange(at_every_step.shape[1], device=at_every_step.device)
        at_any = (at_every_step * objective.delay_penalty**steps).min(1).values.argsort().tolist()
        at_end = at_every_step[:, -1].argsort().tolist()
        in_turn = [row for pair in zip(at_any, at_end, strict=True) for row in pair]
        return problem.space.training[list(dict.fromkeys(in_turn))[: self.candidates]]


@dataclass(frozen=True)
class NearestSequences:
    """The training intentions from which a whole sequence is regenerated best."""

    candidates: int

    @torch.no_grad()
    def __call__(self, problem: Problem, objective: Objective, generator: torch.Generator) -> Float[Tensor, "B K"]:
        return problem.space.training[objective.errors(problem.rollouts)[0].argsort()[: self.candidates]]
