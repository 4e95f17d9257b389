"""Where a search for a goal begins: at what the model imagines for its training intentions, the library, and at blends of them.

The nearer the search begins, the fewer iterations it needs and the fewer valleys lie between. The picture of an arm a little further to
the left is not between the pictures of two arms; the intention of the way there is, nearly, between their intentions.

>>> features, coordinates = torch.tensor([[0.0], [1.0], [2.0]]), torch.tensor([[0.0], [10.0], [20.0]])
>>> round(blend_towards(torch.tensor([1.5]), features, coordinates, neighbours=2).item())
15
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from preimage.model import Generated, Sensed
from preimage.prediction_error import VISUAL_WEIGHT, Modalities, ToGoal, proprioceptive_error, visual_error


@dataclass(frozen=True, eq=False)
class Library:
    """What the model imagines for each of its training intentions from one start: first guesses are looked up in it."""

    start: Sensed
    imagined: Generated

    def begins_at(self, start: Sensed) -> bool:
        """Whether a plan may begin at this start as well: nothing that can be seen or felt stands elsewhere."""
        visual = visual_error(self.start[0], start[0])
        felt = proprioceptive_error(self.start[1].clamp(min=1e-12).log(), start[1])
        return bool(visual < SAME_VISUAL) and bool(felt < SAME_PROPRIOCEPTIVE)


SAME_VISUAL, SAME_PROPRIOCEPTIVE = 10.0, 0.1
"""Percepts nearer than this to each other, in the errors of `prediction_error`, are alike enough to share a library."""


def first_guesses(library: Library, objective: ToGoal, coordinates: Float[Tensor, "N K"], *, count: int) -> Float[Tensor, "candidates K"]:
    """Blends of the training intentions that end like the goal; then, in turn, the one nearest to it at any step and when it ends."""
    ends, wanted = end_features(library.imagined, objective.goal, objective.modalities)
    blends = [blend_towards(wanted, ends, coordinates, neighbours) for neighbours in BLENDED if neighbours <= len(ends)]
    at_every_step = objective.goal_error(library.imagined)
    steps = torch.arange(at_every_step.shape[1], device=at_every_step.device)
    at_any = (at_every_step * objective.delay_penalty**steps).min(1).values.argsort().tolist()
    at_end = at_every_step[:, -1].argsort().tolist()
    in_turn = [row for pair in zip(at_any, at_end, strict=True) for row in pair]
    nearest = list(dict.fromkeys(in_turn))
    return torch.cat([*(blend[None] for blend in blends), coordinates[nearest]])[:count]


BLENDED = (10, 6)
"""How many training intentions are blended into a first guess."""
COARSE = 8
"""Pixels a side of the blocks whose mean greys are compared: so coarse that an arm beside the goal's still overlaps it."""


def end_features(imagined: Generated, goal: Sensed, modalities: Modalities) -> tuple[Float[Tensor, "N F"], Float[Tensor, " F"]]:
    """How the imagined sequences end and what is wanted, coarsely seen and felt."""
    pixels = torch.cat([imagined.pixels[:, -1], goal[0][None]])
    codes = torch.cat([imagined.log_codes[:, -1].exp(), goal[1][None]])
    seen = VISUAL_WEIGHT**0.5 * COARSE * nn.functional.avg_pool2d(pixels, COARSE).flatten(1)
    parts = {"vision": [seen], "joints": [codes.flatten(1)], "both": [seen, codes.flatten(1)]}[modalities]
    features = torch.cat(parts, 1)
    return features[:-1], features[-1]


def blend_towards(
    wanted: Float[Tensor, " F"], features: Float[Tensor, "N F"], coordinates: Float[Tensor, "N K"], neighbours: int
) -> Float[Tensor, " K"]:
    """The coordinates of the nearest features, weighted so that their features blend into what is wanted (Roweis and Saul 2000)."""
    nearest = (features - wanted).square().sum(1).argsort()[:neighbours]
    apart = features[nearest] - wanted
    gram = apart @ apart.T
    ridge = 0.01 * gram.trace() / neighbours + 1e-9
    weights = torch.linalg.solve(gram + ridge * torch.eye(neighbours).to(gram), gram.new_ones(neighbours))
    return weights / weights.sum() @ coordinates[nearest]
