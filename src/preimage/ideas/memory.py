"""Memory of the demonstrations: how they begin and end, and where they pause or open or close a gripper. It lies beside the network,
never in it.

The picture of an arm a little further to the left is not between the pictures of two arms; the joints in which it stands are, nearly,
between their joints. What goes with a picture is found by kriging (`ideas.kriging`) among the demonstrations, by what has come to stand in
the picture from start to end: whatever lies about and stays does not count, nor what is gone.

Where a plan begins in joints in which no demonstration begins, other things change in the picture, and how the network imagines its
training sequences from there stands in for the demonstrations (`from_rollouts`).
"""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from preimage.data.sequences import Sequences
from preimage.ideas.gripper_events import find_events
from preimage.ideas.image_features import BLUR, apart, arrived, blurred
from preimage.ideas.kriging import Endings, Prediction, View, in_own_units, krige
from preimage.ideas.pauses import slowest_steps
from preimage.ideas.unseen_parts import in_few_rows
from preimage.method.seam import Objective, Problem
from preimage.network.coding import JointCoding, to_frames, to_pixels
from preimage.network.divergence import VISUAL_WEIGHT, proprioceptive_error, sensed_log
from preimage.network.pdvmrnn import Sensed

SAME_JOINTS = 0.1
"""Joints nearer than this to each other, in the error of their codes, are as good as the same (nats)."""
NETWORK_DEVIATION = 0.15
"""How far a network's imagined ending is taken to be off, as a share of how much endings differ."""
FINEST = 0.005
"""Share of a joint's range below which no estimate is sharper: a code does not resolve it more finely."""
FIRST_JOINTS_WEIGHT = 0.5
"""What a difference of first joints counts beside one of last pictures, each in its usual size."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """What a memory says about joints: a Gaussian each, in the joints' units."""

    mean: Float[Tensor, " J"]
    deviation: Float[Tensor, " J"]
    """How far they may be off; infinite where nothing is known."""
    network_deviation: Float[Tensor, " J"]
    """How far the joints that a network imagines there may be off."""


@dataclass(frozen=True, eq=False)
class DemonstrationMemory:
    """What is kept of N demonstrations, pictures coarsely (`ideas.image_features`)."""

    background: Float[Tensor, "C H W"]
    """Median of the last frames: what is seen where nothing came to stand."""
    arrivals: Float[Tensor, "N D h w"]
    """What has come to stand in each last frame."""
    last_frames: Float[Tensor, "N C h2 w2"]
    first_joints: Float[Tensor, "N J"]
    final_joints: Float[Tensor, "N J"]
    start_distance: Float[Tensor, ""]
    """Nine in ten demonstrations begin with joints nearer than this to those of another (nats)."""
    first_background: Float[Tensor, "C H W"]
    """Median of the first frames."""
    first_objects: Float[Tensor, "N D h w"]
    """What stands in each first frame."""
    final_pictures: UInt8[Tensor, "N C h3 w3"]
    """The last frames in few rows (`ideas.unseen_parts`), for what their parts look like."""
    pause_joints: Float[Tensor, "N J"]
    """Joints at the slowest moment of the way (`ideas.pauses`)."""
    event_joints: Float[Tensor, "N K J"]
    """Joints at each of the K gripper events that all demonstrations have in common."""
    event_joint: int = 0
    """The joint that opens and closes, where there are such events."""
    _last: list["Recollection"] = field(default_factory=list, repr=False)
    _endings: dict[tuple[Hashable, ...], Endings] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, sequences: Sequences, coding: JointCoding) -> Self:
        """The memory of demonstrations at a model's rate, padded (`data.sequences.pad`)."""
        first, last = to_pixels(sequences.frames[:, 0]), to_pixels(sequences.frames[:, -1])
        joints, background, first_background = sequences.joints, last.median(0).values, first.median(0).values
        events = find_events(joints)
        rows, shares = torch.arange(len(joints)), joints / (coding.upper - coding.lower)
        return cls(
            background=background,
            arrivals=arrived(first, last, background),
            last_frames=blurred(last, BLUR),
            first_joints=joints[:, 0],
            final_joints=joints[:, -1],
            start_distance=torch.tensor(usual_distance(coding.encode(joints[:, 0]))),
            first_background=first_background,
            first_objects=apart(first - first_background),
            final_pictures=to_frames(in_few_rows(last)).movedim(-1, 1),
            pause_joints=joints[rows, slowest_steps(shares)],
            event_joints=joints[rows[:, None], events.steps] if events else joints[:, :0],
            event_joint=events.joint if events else 0,
        )

    def tensors(self) -> dict[str, Tensor]:
        """All there is to save."""
        kept = {name: value for name, value in vars(self).items() if isinstance(value, Tensor)}
        return kept | {"event_joint": torch.tensor(self.event_joint)}

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Tensor]) -> Self:
        """What was saved.

        Raises:
            KeyError, TypeError: a tensor is missing, or there is one too many.
            ValueError: one of them has another shape than the others ask for, or is of another type than was written.
        """
        others = {name: value for name, value in tensors.items() if name != "event_joint"}
        validate_tensors(others | {"event_joint": tensors["event_joint"]})
        return cls(**others, event_joint=int(tensors["event_joint"]))  # pyright: ignore[reportArgumentType]

    def to(self, device: torch.device) -> Self:
        """The same on a device."""
        return self.from_tensors({name: value.to(device) for name, value in self.tensors().items()})

    @property
    def num_events(self) -> int:
        return self.event_joints.shape[1]

    def about(self, problem: Problem) -> "Recollection":
        """What it says about a problem; the last answer is kept, for several ideas ask the same."""
        if not (self._last and self._last[0].problem is problem):
            self._last[:] = [Recollection(self, problem)]
        return self._last[0]

    def endings(self, features: Float[Tensor, "N F"], *known_as: Hashable) -> Endings:
        """The features by which sequences are compared; what kriging works out of them is kept, for it is the same at every goal."""
        return self._endings.setdefault(known_as, Endings(features))

    def knows_start(self, start: Sensed, coding: JointCoding) -> bool:
        """Whether a start is as near to that of a demonstration as most of them are to each other."""
        nearest = code_distance(coding.encode(self.first_joints), start[1]).min()
        return nearest.item() < max(self.start_distance.item(), SAME_JOINTS)

    def from_rollouts(self, problem: Problem) -> Self:
        """How the network imagines its training sequences from the problem's start, as if these had been the demonstrations."""
        imagined, coding = problem.rollouts, problem.model.coding
        last = imagined.pixels[:, -1]
        first_joints = coding.decode(problem.start[1]).repeat(len(last), 1)  # not expanded, of which torch 2.13 takes a wrong median
        return replace(
            self,
            arrivals=arrived(problem.start[0], last, self.background),
            last_frames=blurred(last, BLUR),
            first_joints=first_joints,
            final_joints=coding.decode(imagined.log_codes[:, -1].exp()),
            _last=[],
            _endings={},
        )


@dataclass(frozen=True, eq=False)
class Recollection:
    """What a memory says about one problem, each part worked out when it is first asked for."""

    memory: DemonstrationMemory
    problem: Problem

    @cached_property
    def knows_start(self) -> bool:
        return self.memory.knows_start(self.problem.start, self.problem.model.coding)

    @cached_property
    def endings(self) -> DemonstrationMemory:
        """What is compared with the goal: the demonstrations, or what the network imagines from another start."""
        return self.memory if self.knows_start else self.memory.from_rollouts(self.problem)

    @cached_property
    def views(self) -> list[View]:
        return views_of(self.endings, self.problem)

    @property
    def last_percepts(self) -> Float[Tensor, "N E"]:
        """How sequences end, coarsely: both modalities in units of their errors."""
        seen, felt = self.endings.arrivals, self.problem.model.coding.encode(self.endings.final_joints)
        return torch.cat([VISUAL_WEIGHT**0.5 * seen.flatten(1), felt.flatten(1)], 1)

    @cached_property
    def joints_at_goal(self) -> Estimate:
        """The joints in which sequences end that end like the goal."""
        endings = self.endings.final_joints
        return estimate_of(krige(self.views, endings), endings, self.problem.model.coding)

    @cached_property
    def coordinates(self) -> Float[Tensor, " K"]:
        """The intention that goes with the goal, in the problem's space."""
        return krige(self.views, self.problem.space.training).mean

    @cached_property
    def joints_at_events(self) -> list[Estimate]:
        """The joints at the gripper events, by what stands at the start or has come to stand at the goal; none from an unknown start.

        Which of them it is, what is brighter there or what is darker, is found by how well each predicts the demonstrations.
        """
        memory, problem = self.memory, self.problem
        if not self.knows_start:
            return []
        standing = apart(problem.start[0] - memory.first_background)
        come = arrived(problem.start[0], problem.goal[0], memory.background)
        views = [*zip(looks_at(standing), looks_at(memory.first_objects), strict=True), (come, memory.arrivals)]
        flat = [(wanted.flatten(), memory.endings(known.flatten(1), "events", k)) for k, (wanted, known) in enumerate(views)]
        coding = problem.model.coding
        return [estimate_of(krige(flat, joints), joints, coding) for joints in memory.event_joints.unbind(1)]


@dataclass(frozen=True, eq=False)
class KrigedGuess:
    """Begin at the intention that goes with the goal: a mean of the training intentions, weighed by kriging."""

    memory: DemonstrationMemory

    def __call__(self, problem: Problem, objective: Objective, generator: torch.Generator) -> Float[Tensor, "B K"]:
        return self.memory.about(problem).coordinates[None]


def estimate_of(predicted: Prediction, known: Float[Tensor, "N J"], coding: JointCoding) -> Estimate:
    """What kriging predicts of joints.

    A joint that was always in one place, as an open gripper, distinguishes goals no better than one of which nothing is known.
    """
    spread, finest = known.std(0, unbiased=False), FINEST * (coding.upper - coding.lower)
    deviation = torch.where(spread < finest, torch.inf, predicted.deviation.maximum(finest))
    return Estimate(predicted.mean, deviation, NETWORK_DEVIATION * spread)


def views_of(memory: DemonstrationMemory, problem: Problem) -> list[View]:
    """How the goal looks and feels among the endings, coarsely.

    Where sequences begin in different joints, as a robot does that a person brought there, these matter as well, and the picture as a
    whole says more than what changed in it: one begins with another thing in view than the other. That is a second view.
    """
    coding, (pixels, codes) = problem.model.coding, problem.goal
    wanted = arrived(problem.start[0], pixels, memory.background)
    seen = VISUAL_WEIGHT**0.5 * torch.cat([wanted[None], memory.arrivals]).flatten(1)
    felt = torch.cat([codes[None], coding.encode(memory.final_joints)]).flatten(1)
    parts = {"vision": [seen], "joints": [felt], "both": [seen, felt]}[problem.config.modalities]
    views = [torch.cat(parts, 1)]
    if problem.config.modalities == "vision" and begin_differently(memory, coding):
        pictures = torch.cat([blurred(pixels, BLUR)[None], memory.last_frames]).flatten(1)
        spread = memory.first_joints.std(0, unbiased=False).maximum(FINEST * (coding.upper - coding.lower))
        begun = torch.cat([coding.decode(problem.start[1])[None], memory.first_joints]) / spread
        views.append(torch.cat([in_own_units(pictures), FIRST_JOINTS_WEIGHT * in_own_units(begun)], 1))
    return [(rows[0], memory.endings(rows[1:], problem.config.modalities, coding, k)) for k, rows in enumerate(views)]


def looks_at(standing: Float[Tensor, "*batch D h w"]) -> list[Float[Tensor, "*batch _ h w"]]:
    """Ways to look at what stands in a picture: what is brighter there, what is darker, and both."""
    return [*standing.chunk(2, dim=-3), standing]


def validate_tensors(tensors: Mapping[str, Tensor]) -> None:
    """Raises ValueError where the tensors of a memory do not fit each other or are of another type, KeyError where one is missing."""
    background, first_joints = tensors["background"], tensors["first_joints"]
    if background.ndim != 3 or first_joints.ndim != 2:
        raise ValueError(f"background and first_joints have the shapes {tuple(background.shape)} and {tuple(first_joints.shape)}")
    count, num_joints = first_joints.shape
    standing, coarse = apart(background).shape, blurred(background, BLUR).shape
    shapes = {
        "arrivals": (count, *standing), "first_objects": (count, *standing), "last_frames": (count, *coarse),
        "first_background": background.shape, "final_joints": (count, num_joints), "pause_joints": (count, num_joints),
        "start_distance": (), "event_joint": (),
        "final_pictures": (count, *in_few_rows(background).shape), "event_joints": (count, *tensors["event_joints"].shape[1:2], num_joints),
    }  # fmt: skip
    for name, shape in shapes.items():
        if tensors[name].shape != shape:
            raise ValueError(f"{name} has the shape {tuple(tensors[name].shape)}, and {tuple(shape)} fits the others")
    types = {"final_pictures": torch.uint8, "event_joint": torch.int64}
    for name, tensor in tensors.items():
        if tensor.dtype != types.get(name, torch.float32):
            raise ValueError(f"{name} is of {tensor.dtype}, and was written as {types.get(name, torch.float32)}")


def begin_differently(memory: DemonstrationMemory, coding: JointCoding) -> bool:
    """Whether some sequences begin in other joints than most."""
    usual = coding.encode(memory.first_joints.median(0).values)
    return bool((code_distance(coding.encode(memory.first_joints), usual) >= SAME_JOINTS).any())


def code_distance(codes: Float[Tensor, "*batch J K"], target: Float[Tensor, "*#batch J K"]) -> Float[Tensor, "*batch"]:
    """How far sensed joints are from others, in the error of their codes (nats)."""
    return proprioceptive_error(sensed_log(codes), target)


def usual_distance(codes: Float[Tensor, "N J K"]) -> float:
    """The distance within which nine in ten have another (nats); of a single one 0."""
    distances = torch.stack([proprioceptive_error(sensed_log(codes), one) for one in codes]).fill_diagonal_(torch.inf)
    return float(distances.amin(1).quantile(0.9)) if len(codes) > 1 else 0.0
