"""Trust: how likely a plan is to succeed, and what speaks against it, said before anything moves.

What is looked at is evidence, numbers that are the larger the worse: what of the goal the network cannot imagine, as a whole and at its
worst place; how far start and goal are from what was demonstrated; how far memory and imagination are apart. They are read from a plan
that is done, and change nothing about it. What they mean is learned from goals of which it is known whether they were reached
(`ideas.calibration`); where nobody calibrated there is a ranking, and no probability.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from preimage.ideas.calibration import Calibration
from preimage.ideas.image_features import BLUR, apart, arrived, blurred
from preimage.ideas.kriging import bordered, fits
from preimage.ideas.memory import DemonstrationMemory
from preimage.network.coding import to_pixels
from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Plan, Trust

NOT_IMAGINED = "the goal is not found in what can be imagined"
START_UNLIKE = "the start is unlike that of any demonstration"
OFF_DEMONSTRATED = "the goal is off what was demonstrated"
DISAGREE = "memory and imagination disagree about the joints"
SEVERAL = "several futures fit equally well"
ALREADY_THERE = "the goal is, nearly, the start"
REASONS = {
    "unexplained": NOT_IMAGINED,
    "goal_residual": NOT_IMAGINED,
    "goal_worst_place": NOT_IMAGINED,
    "start_residual": START_UNLIKE,
    "start_joints": START_UNLIKE,
    "start_picture": START_UNLIKE,
    "goal_blend": OFF_DEMONSTRATED,
    "goal_picture": OFF_DEMONSTRATED,
    "final_joints": OFF_DEMONSTRATED,
    "disagreement": DISAGREE,
    "correction": DISAGREE,
    "uncertainty": SEVERAL,
    "little_change": ALREADY_THERE,
}
"""The evidence by name, and what it says in words where there is much of it."""
PLACE = 1 / 16
"""Side of the place that is imagined worst, in heights of a frame: about a hand, or a thing on the table."""
UNLIKELY = 0.5
"""A plan below this probability of success has a reason, even where it is not refused."""
FINEST_PIXEL = 1e-6
"""Squared difference of pixels below which pictures are the same (half ranges, squared): a tenth of a grey level."""
FINEST_JOINT = 5e-3
"""Difference of joints, as a share of their range, below which they are the same: a code resolves no more."""
RANKED_BY = "unexplained", "goal_blend"
"""What plans are ranked by where nothing was calibrated: what is not imagined of the goal, and how far it is from a blend of endings."""


@dataclass(frozen=True, eq=False)
class Assessment:
    """Says of a plan how far to trust it.

    Args:
        calibration: what evidence means, for plans of these options.
        otherwise: whether there is a calibration, but for plans of other options.
    """

    model: PDVMRNN
    memory: DemonstrationMemory | None = None
    calibration: Calibration | None = None
    otherwise: bool = False

    def __call__(self, plan: Plan) -> Trust:
        evidence = self.evidence(plan)
        known = self.calibration
        if known is None or set(known.names) - set(evidence):
            why = "for plans with these options" if self.otherwise else "" if known is None else "for goals of this kind"
            note = f"not calibrated{' ' if why else ''}{why}: plans are ranked, and none is refused"
            return Trust(None, note=note, strangeness=sum(evidence.get(name, 0.0) for name in RANKED_BY), evidence=evidence)
        probability, refused = known.probability(evidence), known.is_refused(evidence)
        return Trust(probability, refused, self.reasons(evidence, known), known.note, known.strangeness(evidence), evidence)

    def reasons(self, evidence: Mapping[str, float], known: Calibration) -> tuple[str, ...]:
        """What is stranger than the limit of refusals, the strangest first; of an unlikely plan that is not refused, what makes it so."""
        scaled = dict(zip(known.names, known.scaled(evidence), strict=True))
        strange = sorted((name for name in scaled if scaled[name] > known.limit), key=lambda name: -scaled[name])
        if not strange and known.probability(evidence) < UNLIKELY:
            strange = [known.names[int(np.argmax(known.weights * known.scaled(evidence)))]]
        return tuple(dict.fromkeys(REASONS[name] for name in strange))

    def evidence(self, plan: Plan) -> dict[str, float]:
        """What speaks against a plan, by name, the larger the worse: logarithms, of ratios where there is something to compare with."""
        found: dict[str, float] = {}
        if plan.unexplained is not None:
            found["unexplained"] = log(plan.unexplained, 1e-4)
        start, first, arrival = (pixels(frame) for frame in (plan.start.frame, plan.frames[0], plan.frames[plan.arrival_step]))
        found["start_residual"] = log(worst_place(first - start), FINEST_PIXEL)
        if plan.goal.frame is not None:
            goal = pixels(plan.goal.frame)
            found["goal_residual"] = log((arrival - goal).square().mean(), FINEST_PIXEL)
            found["goal_worst_place"] = log(worst_place(arrival - goal), FINEST_PIXEL)
            if self.demonstrated is not None:
                found |= self.demonstrated.evidence(plan, start, goal)
        return found

    @cached_property
    def demonstrated(self) -> "Demonstrated | None":
        return Demonstrated.of(self.memory, self.model) if self.memory is not None else None


@dataclass(frozen=True, eq=False)
class Demonstrated:
    """What was demonstrated, ready to be compared with: how demonstrations end and begin, and how far they are from each other."""

    memory: DemonstrationMemory
    joint_range: Float[Tensor, " J"]
    arrivals: Float[Tensor, "N F"]
    inverse: Float[Tensor, "M M"]
    """Of the bordered kernel of the arrivals (`ideas.kriging`)."""
    length: float
    noise: float
    blend_error: Float[Tensor, ""]
    """How far the picture of an ending usually is from the blend of the others."""

    @classmethod
    def of(cls, memory: DemonstrationMemory, model: PDVMRNN) -> "Demonstrated":
        coding = model.coding
        arrivals, joints = memory.arrivals.flatten(1).double().cpu(), memory.final_joints.double().cpu()
        joint_range = (coding.upper - coding.lower).double().cpu()
        best = min(fits(arrivals[0], arrivals, joints / joint_range), key=lambda fit: fit.residual)
        kernel = bordered(1 / (1 + torch.cdist(arrivals, arrivals).square() / best.length))
        own = torch.cat([torch.ones(len(arrivals)), torch.zeros(1)]).double().diag()
        inverse = torch.linalg.inv(kernel + best.noise * own)
        left_out = (inverse @ padded(arrivals))[:-1] / inverse.diagonal()[:-1, None]
        return cls(memory, joint_range, arrivals, inverse, best.length, best.noise, left_out.norm(dim=1).median())

    def evidence(self, plan: Plan, start: Float[Tensor, "C H W"], goal: Float[Tensor, "C H W"]) -> dict[str, float]:
        memory, whole = self.memory, self.joint_range
        wanted = arrived(start, goal, memory.background.double().cpu()).flatten()
        towards = torch.cat([1 / (1 + (self.arrivals - wanted).square().sum(1) / self.length), torch.ones(1).double()])
        weights = towards @ self.inverse
        blend, variance = weights @ padded(self.arrivals), 1 + self.noise - weights @ towards
        expected = weights @ padded(memory.final_joints.double().cpu())
        final, imagined = torch.from_numpy(plan.joints[plan.arrival_step]), plan.imagined_joints
        if plan.expected_joints is not None:
            expected = torch.from_numpy(plan.expected_joints[-1])
        found = {
            "goal_blend": log((blend - wanted).norm() / self.blend_error),
            "uncertainty": log(variance, 1e-8),
            "goal_picture": log(nearest(blurred(goal, BLUR), memory.last_frames)),
            "final_joints": log(nearest(final / whole, memory.final_joints.cpu() / whole), FINEST_JOINT),
            "start_joints": log(nearest(torch.from_numpy(plan.start.joints) / whole, memory.first_joints.cpu() / whole), FINEST_JOINT),
            "start_picture": log(nearest(apart(start - memory.first_background.double().cpu()), memory.first_objects), 1e-3),
            "little_change": -log(wanted.norm() / self.arrivals.norm(dim=1).min(), 1e-3),
        }
        if imagined is not None:
            found["disagreement"] = log(((torch.from_numpy(imagined[plan.arrival_step]) - expected) / whole).abs().max(), FINEST_JOINT)
            found["correction"] = log((torch.from_numpy(plan.joints - imagined) / whole).abs().max(), FINEST_JOINT)
        return found


def pixels(frame: UInt8[np.ndarray, "H W C"] | None) -> Float[Tensor, "C H W"]:
    assert frame is not None
    return to_pixels(torch.from_numpy(np.ascontiguousarray(frame))).double()


def worst_place(difference: Float[Tensor, "C H W"]) -> Float[Tensor, ""]:
    """The largest mean square of a difference over a place of the picture."""
    side = max(1, int(PLACE * difference.shape[1]))
    return torch.nn.functional.avg_pool2d(difference.square().mean(0)[None, None], side, max(1, side // 2)).max()


def nearest(wanted: Tensor, known: Float[Tensor, "N ..."]) -> Float[Tensor, ""]:
    """Distance to the nearest of what is known."""
    return torch.cdist(wanted.flatten()[None].double(), known.cpu().flatten(1).double()).min()


def padded(values: Float[Tensor, "N V"]) -> Float[Tensor, "M V"]:
    """The values with a row of zeros, for the border of the kernel."""
    return torch.cat([values, values.new_zeros(1, values.shape[1])])


def log(value: float | Tensor, finest: float = 1e-6) -> float:
    """The logarithm of a value, which is at least the finest that is told apart."""
    return float(np.log(max(float(value), finest)))
