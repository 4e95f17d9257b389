"""Where a search for a goal begins, and which joints it expects there: both from the library, what a model imagines for its training.

The nearer the search begins, the fewer iterations it needs and the fewer valleys lie between. The picture of an arm a little further to
the left is not between the pictures of two arms; the intention of the way there is, nearly, between their intentions, and so are the
joints in which it ends. What is recalled (`recall`) is the first of the guesses, and other joints than the recalled ones cost.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from preimage.blurring import BLUR, blurred
from preimage.coding import JointCoding
from preimage.model import Generated, Sensed
from preimage.prediction_error import VISUAL_WEIGHT, ExpectedJoints, Modalities, ToGoal, proprioceptive_error, visual_error
from preimage.recall import recall


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


def expected_joints(library: Library, objective: ToGoal, coding: JointCoding) -> ExpectedJoints:
    """The joints with which imagined sequences end that end like the goal: what a picture alone does not say, memory does."""
    ends, wanted = end_features(library.imagined, objective.goal, objective.modalities)
    recalled = recall(wanted, ends, coding.decode(library.imagined.log_codes[:, -1].exp()))
    finest = FINEST * (coding.upper - coding.lower)
    return ExpectedJoints(coding, recalled.mean, WIDER * recalled.deviation.maximum(finest))


WIDER = 3.0
"""Expectations are so many times wider than how well memory tells its own: a goal is photographed, memory is imagined."""
FINEST = 0.005
"""Share of a joint's range below which no expectation is sharper: a code does not tell it more finely."""


def first_guesses(library: Library, objective: ToGoal, coordinates: Float[Tensor, "N K"], *, count: int) -> Float[Tensor, "candidates K"]:
    """The intention that is recalled for the goal; then training intentions, in turn the one nearest to it at any step and when it ends."""
    ends, wanted = end_features(library.imagined, objective.goal, objective.modalities)
    at_every_step = objective.goal_error(library.imagined)
    steps = torch.arange(at_every_step.shape[1], device=at_every_step.device)
    at_any = (at_every_step * objective.delay_penalty**steps).min(1).values.argsort().tolist()
    at_end = at_every_step[:, -1].argsort().tolist()
    in_turn = [row for pair in zip(at_any, at_end, strict=True) for row in pair]
    nearest = list(dict.fromkeys(in_turn))
    return torch.cat([recall(wanted, ends, coordinates).mean[None], coordinates[nearest]])[:count]


def end_features(imagined: Generated, goal: Sensed, modalities: Modalities) -> tuple[Float[Tensor, "N F"], Float[Tensor, " F"]]:
    """How the imagined sequences end and what is wanted, coarsely seen and felt."""
    pixels = torch.cat([imagined.pixels[:, -1], goal[0][None]])
    codes = torch.cat([imagined.log_codes[:, -1].exp(), goal[1][None]])
    seen = VISUAL_WEIGHT**0.5 * blurred(pixels, BLUR).flatten(1)
    parts = {"vision": [seen], "joints": [codes.flatten(1)], "both": [seen, codes.flatten(1)]}[modalities]
    features = torch.cat(parts, 1)
    return features[:-1], features[-1]
