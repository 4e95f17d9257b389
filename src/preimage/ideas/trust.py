"""Trust: how likely a plan is to succeed, and what speaks against it, said before anything moves.

What is looked at is evidence, numbers that are the larger the worse: what of the goal the network cannot imagine, as a whole and at its
worst place; how far start and goal are from what was demonstrated; how far memory and imagination are apart. They are read from a plan
that is done, and change nothing about it. What they mean is learned from goals of which it is known whether they were reached
(`ideas.calibration`); where nobody calibrated there is a ranking, and no probability.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from preimage.ideas.calibration import Calibration
from preimage.ideas.image_features import BLUR, apart, arrived, blurred
from preimage.ideas.kriging import MAX_FIT_POINTS, Endings, Kernel, fits, krige_by_all, usual
from preimage.ideas.memory import DemonstrationMemory, looks_at
from preimage.ideas.unseen_parts import FINE_ROWS, in_few_rows, unimagined_thing, unseen_part
from preimage.network.coding import to_pixels
from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Plan, Trust

NOT_IMAGINED = "the goal is not found in what can be imagined"
START_UNLIKE = "the start is unlike that of any demonstration"
NEVER_SEEN = "part of the goal looks like nothing that was demonstrated or is imagined"
OFF_DEMONSTRATED = "the goal is off what was demonstrated"
DISAGREE = "memory and imagination disagree about the joints"
SEVERAL = "several futures fit equally well"
ALREADY_THERE = "the goal is, nearly, the start"
REASONS = {
    "unexplained": NOT_IMAGINED,
    "goal_residual": NOT_IMAGINED,
    "goal_worst_place": NOT_IMAGINED,
    "goal_part": NEVER_SEEN,
    "unimagined_thing": NEVER_SEEN,
    "start_residual": START_UNLIKE,
    "start_joints": START_UNLIKE,
    "start_picture": START_UNLIKE,
    "start_uncertainty": START_UNLIKE,
    "pause_uncertainty": START_UNLIKE,
    "goal_blend": OFF_DEMONSTRATED,
    "goal_picture": OFF_DEMONSTRATED,
    "final_joints": OFF_DEMONSTRATED,
    "disagreement": DISAGREE,
    "correction": DISAGREE,
    "off_pause": DISAGREE,
    "uncertainty": OFF_DEMONSTRATED,
    "ambiguity": SEVERAL,
    "little_change": ALREADY_THERE,
}
"""The evidence by name, and what it says in words where there is much of it."""
REFUSING = "goal_part", "unimagined_thing"
"""Evidence of what cannot be. A hand between demonstrated hands is strange by it too, and reached, so it says nothing of how likely."""
LIKELY_ONLY = "start_uncertainty", "off_pause", "pause_uncertainty"
"""Evidence that refuses nothing: it tells of the start and what follows from it more than of the goal, and a few strange starts among
those that are reached would let all goals pass."""
PLACE = 1 / 16
"""Side of the place that is imagined worst, in heights of a frame: about a hand, or a thing on the table."""
UNLIKELY = 0.5
"""A plan below this probability of success has a reason, even where it is not refused."""
STRANGE = 2.0
"""Evidence beyond so many spreads from the usual is named as a reason of a refusal."""
FINEST_PIXEL = 1e-6
"""Squared difference of pixels below which pictures are the same (half ranges, squared): a tenth of a grey level."""
FINEST_PART = 1e-2
"""Share of what is to be seen at a place, below which all of it is found."""
FINEST_THING = 1 / FINE_ROWS**2
"""Mean square over a picture (half ranges, squared) of a thing that is none: one pixel that differs by half the range."""
MOST_ALIKE = 24
"""Endings, those that look most like the goal, in which its parts are looked for: the others have their hands elsewhere."""
FINEST_JOINT = 5e-3
"""Difference of joints, as a share of their range, below which they are the same: a code resolves no more."""
SECOND_BLUR = 0.2
"""Of what stands at the start, on top of the blur it is kept with (heights of a frame): together a quarter of a frame."""
START_LENGTH, START_NOISE = 10.0, 1e-2
"""Squared length, in median squared distances, and noise of the kernel between start pictures: a smooth one, by which a scene lies inside
of those demonstrated or outside (docs/log.md)."""
NEIGHBOURS = 5
"""Endings that look most like the goal, by which it is seen whether alike pictures have alike joints."""
FEWEST = 3
"""Demonstrations below which none can be compared with a blend of the others."""
LARGEST = 1e6
"""No evidence counts for more, nor a ratio to something that never differs."""
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
    refusing: ClassVar = REFUSING
    likely_only: ClassVar = LIKELY_ONLY

    def __call__(self, plan: Plan) -> Trust:
        evidence = self.evidence(plan)
        known = self.calibration
        if known is None:
            return uncalibrated(evidence, "for plans with these options" if self.otherwise else "")
        if set(known.names) - set(evidence):
            return uncalibrated(evidence, "for goals of this kind")
        probability, refused = known.probability(evidence), known.is_refused(evidence)
        return Trust(probability, refused, self.reasons(evidence, known), known.note, known.strangeness(evidence), evidence)

    def of_later_leg(self, plan: Plan) -> Trust:
        """Of a plan that begins where another arrives, which no calibration has seen."""
        return uncalibrated(self.evidence(plan), "for goals after the first")

    def reasons(self, evidence: Mapping[str, float], known: Calibration) -> tuple[str, ...]:
        """Of a plan that is refused what is strange, the strangest first; of an unlikely one that is not refused, what makes it so."""
        scaled = dict(zip(known.names, known.scaled(evidence), strict=True))
        strangest = sorted(set(scaled) - set(known.likely_only), key=lambda name: -scaled[name])
        strange = [name for name in strangest if scaled[name] > STRANGE] or strangest[:1] if known.is_refused(evidence) else []
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
                found |= self.demonstrated.evidence(plan, start, goal, arrival)
        return found

    @cached_property
    def demonstrated(self) -> "Demonstrated | None":
        """What to compare with, where a memory of enough demonstrations is there."""
        known = self.memory
        return Demonstrated.of(known, self.model) if known is not None and len(known.final_joints) >= FEWEST else None


def uncalibrated(evidence: Mapping[str, float], why: str) -> Trust:
    """What can be said without a calibration: a rank."""
    note = f"not calibrated{' ' if why else ''}{why}: plans are ranked, and none is refused"
    return Trust(note=note, strangeness=sum(evidence.get(name, 0.0) for name in RANKED_BY), evidence=dict(evidence))


@dataclass(frozen=True, eq=False)
class Demonstrated:
    """What was demonstrated, ready to be compared with: how demonstrations end and begin, and how far they are from each other."""

    background: Float[Tensor, "C H W"]
    first_background: Float[Tensor, "C H W"]
    starts: Endings
    """What stood where when demonstrations began."""
    start_kernel: Kernel
    looks: list[Endings]
    """The same of M demonstrations, looked at in several ways: with many, some of them tell where there is a pause (`MAX_FIT_POINTS`)."""
    pause_joints: Float[Tensor, "M J"]
    """In shares of the joints' ranges, as are the other joints here."""
    first_joints: Float[Tensor, "N J"]
    last_frames: Float[Tensor, "N P"]
    final_pictures: Float[Tensor, "N C h w"]
    final_joints: Float[Tensor, "N J"]
    joint_range: Float[Tensor, " J"]
    arrivals: Float[Tensor, "N F"]
    kernel: Kernel
    """Of the arrivals."""
    blend_error: Float[Tensor, ""]
    """How far the picture of an ending usually is from the blend of the others."""
    joint_errors: Float[Tensor, " N"]
    """How far the joints of each ending are from the blend of the others."""

    @classmethod
    def of(cls, memory: DemonstrationMemory, model: PDVMRNN) -> "Demonstrated":
        joint_range = plain(model.coding.upper - model.coding.lower)
        arrivals, joints = plain(memory.arrivals).flatten(1), plain(memory.final_joints) / joint_range
        tried = fits(arrivals[0], Endings(arrivals), joints)
        kernel = tried.kernels[int(tried.residual.argmin())]
        objects = plain(memory.first_objects)
        starts, count = Endings(objects.flatten(1)), len(objects)
        some = torch.linspace(0, count - 1, min(count, MAX_FIT_POINTS)).round().long()
        left_out = [(kernel.inverse @ padded(values))[:-1] / kernel.inverse.diagonal()[:-1, None] for values in (arrivals, joints)]
        return cls(
            background=plain(memory.background),
            first_background=plain(memory.first_background),
            starts=starts,
            start_kernel=starts.kernel(START_LENGTH * usual(starts.distances), torch.tensor(START_NOISE).double()),
            looks=[Endings(each.flatten(1)) for each in looks_at_start(objects[some])],
            pause_joints=plain(memory.pause_joints)[some] / joint_range,
            first_joints=plain(memory.first_joints) / joint_range,
            last_frames=plain(memory.last_frames).flatten(1),
            final_pictures=to_pixels(memory.final_pictures.cpu().movedim(1, -1)),
            final_joints=joints,
            joint_range=joint_range,
            arrivals=arrivals,
            kernel=kernel,
            blend_error=left_out[0].norm(dim=1).median(),
            joint_errors=left_out[1].norm(dim=1),
        )

    def evidence(
        self, plan: Plan, start: Float[Tensor, "C H W"], goal: Float[Tensor, "C H W"], arrival: Float[Tensor, "C H W"]
    ) -> dict[str, float]:
        """What speaks against a plan by what was demonstrated.

        Args:
            arrival: what is imagined where the plan arrives.
        """
        came = arrived(start, goal, self.background).flatten()
        apart_from = (self.arrivals - came).square().sum(1)
        towards = self.kernel.towards(apart_from)
        weights = towards @ self.kernel.inverse
        alike = apart_from.argsort()[:NEIGHBOURS]
        things = apart(start - self.first_background)
        standing = things.flatten()
        from_starts = self.start_kernel.towards((self.starts.points - standing).square().sum(1))
        wanted = [each.flatten() for each in looks_at_start(things)]
        pause = krige_by_all(list(zip(wanted, self.looks, strict=True)), self.pause_joints)
        seen, imagined_end = in_few_rows(torch.stack([goal, arrival]))
        finely = in_few_rows(torch.stack([goal, arrival, start, self.background]), FINE_ROWS)
        most_alike = self.final_pictures[(self.final_pictures - seen).square().sum((1, 2, 3)).argsort()[:MOST_ALIKE]]
        begun, way = self.shares(plan.start.joints), self.shares(plan.joints[: plan.arrival_step + 1])
        found = {
            "goal_blend": log((weights @ padded(self.arrivals) - came).norm() / self.blend_error),
            "uncertainty": log(self.kernel.variance(towards), 1e-8),
            "ambiguity": log(self.joint_errors[alike].square().mean().sqrt(), FINEST_JOINT),
            "goal_part": log(unseen_part(seen, torch.cat([imagined_end[None], most_alike])), FINEST_PART),
            "unimagined_thing": log(unimagined_thing(finely[0], finely[1], finely[2:]), FINEST_THING),
            "goal_picture": log(nearest(blurred(goal, BLUR), self.last_frames)),
            "final_joints": log(nearest(way[-1], self.final_joints), FINEST_JOINT),
            "start_joints": log(nearest(begun, self.first_joints), FINEST_JOINT),
            "start_picture": log(nearest(standing, self.starts.points), 1e-3),
            "start_uncertainty": log(self.start_kernel.variance(from_starts), 1e-8),
            "off_pause": log(distance_to_way(pause.mean, way), FINEST_JOINT),
            "pause_uncertainty": log(pause.deviation.norm(), FINEST_JOINT),
            "little_change": -log(came.norm() / self.arrivals.norm(dim=1).median(), 1e-3),
        }
        if plan.imagined_joints is not None:
            imagined, expected = self.shares(plan.imagined_joints), weights @ padded(self.final_joints)
            if plan.expected_joints is not None:
                expected = self.shares(plan.expected_joints[-1])
            found["disagreement"] = log((imagined[plan.arrival_step] - expected).abs().max(), FINEST_JOINT)
            found["correction"] = log((self.shares(plan.joints) - imagined).abs().max(), FINEST_JOINT)
        return found

    def shares(self, joints: Float[np.ndarray, "*steps J"] | None) -> Float[Tensor, "*steps J"]:
        """Joints in shares of their ranges."""
        assert joints is not None
        return torch.from_numpy(joints).double() / self.joint_range


def looks_at_start(standing: Float[Tensor, "*batch D h w"]) -> list[Float[Tensor, "*batch _ _ _"]]:
    """Ways to look at what stands at the start (`ideas.memory.looks_at`), and all of it through a second blur: that goes on where the
    scene is off those demonstrated."""
    return [*looks_at(standing), blurred(standing, SECOND_BLUR)]


def pixels(frame: UInt8[np.ndarray, "H W C"] | None) -> Float[Tensor, "C H W"]:
    assert frame is not None
    return to_pixels(torch.from_numpy(np.ascontiguousarray(frame))).double()


def worst_place(difference: Float[Tensor, "C H W"]) -> Float[Tensor, ""]:
    """The largest mean square of a difference over a place of the picture."""
    side = max(1, int(PLACE * difference.shape[1]))
    return torch.nn.functional.avg_pool2d(difference.square().mean(0)[None, None], side, max(1, side // 2)).max()


def nearest(wanted: Tensor, known: Float[Tensor, "N V"]) -> Float[Tensor, ""]:
    """Distance to the nearest of what is known."""
    return torch.cdist(wanted.flatten()[None], known).min()


def distance_to_way(joints: Float[Tensor, " J"], way: Float[Tensor, "T J"]) -> Float[Tensor, ""]:
    """How far joints are from the nearest point of a way, which goes straight from step to step.

    >>> way = torch.tensor([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0]])
    >>> round(distance_to_way(torch.tensor([1.0, 0.5]), way).item(), 3), round(distance_to_way(torch.tensor([2.0, 3.0]), way).item(), 3)
    (0.5, 1.0)
    """
    along = torch.cat([way.diff(dim=0), torch.zeros_like(way[-1:])])
    shares = ((joints - way) * along).sum(1) / along.square().sum(1).clamp(min=1e-12)
    return (way + shares.clamp(0, 1)[:, None] * along - joints).norm(dim=1).amin()


def padded(values: Float[Tensor, "N V"]) -> Float[Tensor, "M V"]:
    """The values with a row of zeros, for the border of the kernel."""
    return torch.cat([values, values.new_zeros(1, values.shape[1])])


def plain(values: Tensor) -> Tensor:
    """In double precision, where the matrices are small enough for no GPU to be of use."""
    return values.cpu().double()


def log(value: float | Tensor, finest: float = 1e-6) -> float:
    """The logarithm of a value, which is at least the finest that is told apart."""
    known = float(value)
    return float(np.log(min(max(known, finest), LARGEST))) if np.isfinite(known) else float(np.log(LARGEST))
