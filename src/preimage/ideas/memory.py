"""Where a search for a goal begins, and which joints it expects there: both from memory of how the demonstrations end.

The nearer the search begins, the fewer iterations it needs and the fewer valleys lie between. The picture of an arm a little further to
the left is not between the pictures of two arms; the intention of the way there is, nearly, between their intentions, and so are the
joints in which it ends. What is recalled (`ideas.kriging`) is the first of the guesses, and other joints than the recalled ones cost.

Remembered is what has come to stand in the picture from start to end: whatever lies about and stays does not count, nor what is gone.
Where the plan begins with other joints than the demonstrations did, other things change, and how the model imagines its training sequences
from there stands in.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from preimage.ideas.image_features import BLUR, apart, arrived, blurred
from preimage.ideas.kriging import Recalled, View, in_own_units, recall
from preimage.method.prediction_error import VISUAL_WEIGHT, ExpectedJoints, ToGoal, felt_apart, visual_error
from preimage.network.coding import JointCoding
from preimage.network.pdvmrnn import PDVMRNN, Generated, Sensed


@dataclass(frozen=True, eq=False)
class Library:
    """What is known of the demonstrations, to begin a search from one start: how they end, and what the model imagines for each of them."""

    start: Sensed
    num_steps: int
    """How far ahead it looks."""
    imagine: Callable[[], Generated]
    """Imagines all of it, which takes as long as a search or longer: asked when it is needed, and once."""
    background: Float[Tensor, "C H W"]
    """What is seen where nothing came to stand."""
    arrivals: Float[Tensor, "N D h w"]
    """What has come to stand in the picture at the end of each sequence, coarsely seen."""
    lasts: Float[Tensor, "N C h w"]
    """The picture at the end of each, coarsely seen."""
    firsts: Float[Tensor, "N J"]
    """The joints in which each begins (rad)."""
    ends: Float[Tensor, "N J"]
    """The joints in which each ends (rad)."""

    def serves(self, start: Sensed, num_steps: int) -> bool:
        """Whether a plan may begin at this start as well: it looks as far ahead, and nothing that can be seen or felt stands elsewhere."""
        alike = bool(visual_error(self.start[0], start[0]) < SAME_VISUAL) and feel_alike(self.start[1], start[1])
        return alike and self.num_steps == num_steps

    @cached_property
    def imagined(self) -> Generated:
        """What the model imagines for each of its training intentions."""
        return self.imagine()

    @property
    def at_hand(self) -> Generated | None:
        """The same, if it has been needed before."""
        return vars(self).get("imagined")


def feel_alike(one: Float[Tensor, "J K"], other: Float[Tensor, "J K"]) -> bool:
    """Whether joints of these codes are as good as the same."""
    return bool(felt_apart(one, other) < SAME_PROPRIOCEPTIVE)


def begins_as_shown(model: PDVMRNN, start: Sensed) -> bool:
    """Whether a start feels like those of the demonstrations, so that what they keep of pictures can be compared.

    It is as near to the nearest of them as most of them are to their nearest.
    """
    nearest = felt_apart(model.coding.encode(model.shown_firsts), start[1]).min()
    return nearest.item() < max(model.starts_apart.item(), SAME_PROPRIOCEPTIVE)


SAME_VISUAL, SAME_PROPRIOCEPTIVE = 10.0, 0.1
"""Percepts nearer than this to each other, in the errors of `method.prediction_error`, are alike enough to share a library."""


def expected_joints(library: Library, objective: ToGoal, coding: JointCoding) -> ExpectedJoints:
    """The joints with which sequences end that end like the goal: what a picture alone does not say, memory does."""
    return expected(recall(views_of(library, objective, coding), library.ends), library.ends, coding)


def expected_at_switches(model: PDVMRNN, objective: ToGoal) -> list[ExpectedJoints]:
    """The joints at which the robot switches something on the way, from what stands at the start, or has come to stand at the goal.

    Which of them tells it, what is brighter there or what is darker, is found by how well it tells the demonstrations.
    """
    standing, come = apart(objective.start[0] - model.usual_start), arrived(objective.start[0], objective.goal[0], model.background)
    parts = zip(standing.chunk(2), model.shown_starts.chunk(2, dim=1), strict=True)
    views = [*parts, (standing, model.shown_starts), (come, model.shown_arrivals)]
    flat = [(wanted.flatten(), shown.flatten(1)) for wanted, shown in views]
    shown_joints = model.shown_switches[:, : int(model.switching[1])].unbind(1)
    return [expected(recall(flat, joints), joints, model.coding) for joints in shown_joints]


def expected(recalled: Recalled, shown: Float[Tensor, "N J"], coding: JointCoding) -> ExpectedJoints:
    """What is recalled of joints, beside what a network that was shown these would be expected to be off.

    A joint that was always in one place, as an open gripper, tells goals apart no better than one of which memory knows nothing.
    """
    spread, finest = shown.std(0, unbiased=False), FINEST * (coding.upper - coding.lower)
    told = torch.where(spread < finest, torch.inf, recalled.deviation.maximum(finest))
    return ExpectedJoints(coding, recalled.mean, told, imagined=IMAGINED * spread)


IMAGINED = 0.15
"""How far a network's imagined ending is taken to be off, as a share of how much the endings differ."""
FINEST = 0.005
"""Share of a joint's range below which no expectation is sharper: a code does not tell it more finely."""


def first_guesses(
    library: Library, objective: ToGoal, coding: JointCoding, coordinates: Float[Tensor, "N K"], *, count: int
) -> Float[Tensor, "candidates K"]:
    """The intention that is recalled for the goal; then training intentions, in turn the one nearest to it at any step and when it ends."""
    recalled = recall(views_of(library, objective, coding), coordinates).mean[None]
    if count == 1:
        return recalled
    at_every_step = objective.goal_error(library.imagined)
    steps = torch.arange(at_every_step.shape[1], device=at_every_step.device)
    at_any = (at_every_step * objective.delay_penalty**steps).min(1).values.argsort().tolist()
    at_end = at_every_step[:, -1].argsort().tolist()
    in_turn = [row for pair in zip(at_any, at_end, strict=True) for row in pair]
    nearest = list(dict.fromkeys(in_turn))
    return torch.cat([recalled, coordinates[nearest]])[:count]


def views_of(library: Library, objective: ToGoal, coding: JointCoding) -> list[View]:
    """How the goal looks and feels among the endings, coarsely.

    Where the sequences begin in different joints, as a robot does that a person brought there, these tell something as well, and the
    picture as a whole tells more than what changed in it: one begins with another thing in view than the other. That is a second view.
    """
    wanted = arrived(objective.start[0], objective.goal[0], library.background)
    seen = VISUAL_WEIGHT**0.5 * torch.cat([wanted[None], library.arrivals]).flatten(1)
    felt = torch.cat([objective.goal[1][None], coding.encode(library.ends)]).flatten(1)
    parts = {"vision": [seen], "joints": [felt], "both": [seen, felt]}[objective.modalities]
    views = [torch.cat(parts, 1)]
    if objective.modalities == "vision" and begin_differently(library, coding):
        pictures = torch.cat([blurred(objective.goal[0], BLUR)[None], library.lasts]).flatten(1)
        spread = library.firsts.std(0, unbiased=False).maximum(FINEST * (coding.upper - coding.lower))
        begun = torch.cat([coding.decode(objective.start[1])[None], library.firsts]) / spread
        views.append(torch.cat([in_own_units(pictures), BEGUN * in_own_units(begun)], 1))
    return [(rows[0], rows[1:]) for rows in views]


def begin_differently(library: Library, coding: JointCoding) -> bool:
    """Whether some sequences feel otherwise at their beginning than most."""
    usual = coding.encode(library.firsts.median(0).values)
    return bool((felt_apart(coding.encode(library.firsts), usual) >= SAME_PROPRIOCEPTIVE).any())


BEGUN = 0.5
"""What a difference of first joints counts beside one of last pictures, each in its usual size."""
