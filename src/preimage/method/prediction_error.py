"""The prediction error: of whole sequences (training, recognition) and of a start and a goal alone (planning).

Vision is a squared error summed over pixels, the motors a Kullback-Leibler divergence summed over joints, KL(target || predicted); the
paper writes the arguments the other way round, see docs/paper.md. Frames of another size are charged as if they had 64x64 pixels, so
that the balance of the two modalities does not depend on the camera. Pictures may be compared coarsely (`ideas.image_features`).

>>> import torch
>>> error = torch.tensor([[9.0, 4.0, 4.0, 8.0]])
>>> int(arrival_step(error, delay_penalty=1.01))  # the first of two equal errors: arriving sooner is better
1
"""

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from preimage.ideas.image_features import blurred
from preimage.network.coding import JointCoding
from preimage.network.pdvmrnn import Generated, InputSequence, Sensed

Modalities = Literal["vision", "joints", "both"]
"""What of a goal is used."""

VISUAL_WEIGHT = 1 / 40
"""Weight of the visual error beside the joints' KL: chosen so that both fall together; the paper does not say."""
REFERENCE_PIXELS = 64 * 64


def pixel_scale(frames: Float[Tensor, "*batch C H W"]) -> float:
    """What a pixel counts, so that all frames count as if they had 64x64 of them."""
    return REFERENCE_PIXELS / frames.shape[-3:].numel()


def visual_error(
    predicted: Float[Tensor, "*batch C H W"], target: Float[Tensor, "*#batch C H W"], blur: float = 0.0
) -> Float[Tensor, "*batch"]:
    """Squared error summed over pixels, as of a frame of 64x64; of the blurred pictures where `blur` is not 0."""
    return pixel_scale(target) * blurred(predicted - target, blur).square().sum((-1, -2, -3))


def proprioceptive_error(log_predicted: Float[Tensor, "*batch J K"], target: Float[Tensor, "*#batch J K"]) -> Float[Tensor, "*batch"]:
    """KL(target || predicted) of the codes, summed over joints (nats)."""
    return (torch.special.xlogy(target, target) - target * log_predicted).sum((-1, -2))


def felt_apart(codes: Float[Tensor, "*batch J K"], target: Float[Tensor, "*#batch J K"]) -> Float[Tensor, "*batch"]:
    """The same of codes that were sensed and may hold zeros, instead of predicted ones."""
    return proprioceptive_error(codes.clamp(min=1e-12).log(), target)


def visual_residuals(predicted: Float[Tensor, "*batch C H W"], target: Float[Tensor, "*#batch C H W"]) -> Float[Tensor, "..."]:
    """Numbers whose squares sum to the weighted visual error."""
    return (VISUAL_WEIGHT * pixel_scale(target)) ** 0.5 * (predicted - target)


def proprioceptive_residuals(
    log_predicted: Float[Tensor, "*batch J K"], target: Float[Tensor, "*#batch J K"]
) -> Float[Tensor, "*batch J K"]:
    """Numbers whose squares sum to the KL to second order: sqrt(2) times the difference of the roots (Hellinger)."""
    return 2**0.5 * ((log_predicted / 2).exp() - target.sqrt())


@dataclass(frozen=True, eq=False)
class SequenceError:
    """Mean error of a percept, one value per sequence."""

    visual: Float[Tensor, " B"]
    proprioceptive: Float[Tensor, " B"]

    @property
    def total(self) -> Float[Tensor, " B"]:
        return VISUAL_WEIGHT * self.visual + self.proprioceptive


def sequence_error(
    generated: Generated,
    pixels: Float[Tensor, "B T C H W"],
    codes: Float[Tensor, "B T J K"],
    mask: Float[Tensor, "B T"],
    blur: float = 0.0,
) -> SequenceError:
    """Both modalities' errors against a full sequence (equation 1), averaged over the steps where mask is 1."""
    steps = mask.sum(1)
    visual = (visual_error(generated.pixels, pixels, blur) * mask).sum(1) / steps
    proprioceptive = (proprioceptive_error(generated.log_codes, codes) * mask).sum(1) / steps
    return SequenceError(visual, proprioceptive)


def arrival_step(goal_error: Float[Tensor, "B T"], *, delay_penalty: float) -> Int[Tensor, " B"]:
    """The step whose error times delay_penalty^t is smallest: T-hat of the paper. Where two are equal the earlier wins."""
    steps = torch.arange(goal_error.shape[1], device=goal_error.device)
    return (goal_error.detach() * delay_penalty**steps).argmin(1)


def resting_error(goal_error: Float[Tensor, "B T"]) -> Float[Tensor, "B T"]:
    """The mean of the goal error over a step and all that follow: what it is to arrive there and stay.

    >>> resting_error(torch.tensor([[9.0, 0.0, 6.0, 3.0]])).tolist()
    [[4.5, 3.0, 4.5, 3.0]]
    """
    num_later = torch.arange(goal_error.shape[1], 0, -1, device=goal_error.device)
    return goal_error.flip(1).cumsum(1).flip(1) / num_later


WIDER = 3.0
"""Expectations are held so many times wider than they are: the network does not imagine what it expects to a hair."""


@dataclass(frozen=True, eq=False)
class ExpectedJoints:
    """The joints that are expected at a goal of which only the picture is known: a Gaussian each."""

    coding: JointCoding
    mean: Float[Tensor, " J"]
    """In the joints' units."""
    deviation: Float[Tensor, " J"]
    """How far they may be off."""
    imagined: Float[Tensor, " J"]
    """How far the joints that the network imagines at a goal may be off."""

    def error(self, generated: Generated) -> Float[Tensor, "B T"]:
        """Half the squared distance in WIDER deviations, summed over joints: how unlikely the joints are (nats)."""
        return self.residuals(generated).square().sum(-1)

    def residuals(self, generated: Generated) -> Float[Tensor, "B T J"]:
        """Numbers whose squares sum to the error."""
        joints = self.coding.decode(generated.log_codes.to(self.mean.dtype).exp())
        return (joints - self.mean) / (WIDER * self.deviation) / 2**0.5


@dataclass(frozen=True, eq=False)
class ToGoal:
    """Equation 2: the first percept as observed, the goal at the step that shows it best, and, where it rests, from then on."""

    start: Sensed
    goal: Sensed
    modalities: Modalities = "vision"
    delay_penalty: float = 1.01
    rests: bool = True
    """Whether the goal is to be stayed in. In passing, a hand above the table can look like one on it."""
    expected: ExpectedJoints | None = None
    """What more the joints are charged for at the goal, where its picture alone is known."""
    earliest: int = 0
    """The first step at which the goal may be reached."""

    def start_error(self, generated: Generated) -> Float[Tensor, " B"]:
        """The start's part: the first predicted percept against the one observed, both modalities."""
        pixels, codes = self.start
        visual = visual_error(generated.pixels[:, 0], pixels)
        return VISUAL_WEIGHT * visual + proprioceptive_error(generated.log_codes[:, 0], codes)

    def goal_error(self, generated: Generated) -> Float[Tensor, "B T"]:
        """The goal's part at every imagined step: vision, joints or both."""
        error = torch.zeros(generated.pixels.shape[:2]).to(generated.pixels)
        if self.modalities != "joints":
            error = error + VISUAL_WEIGHT * visual_error(generated.pixels, self.goal[0])
        if self.modalities != "vision":
            error = error + proprioceptive_error(generated.log_codes, self.goal[1])
        if self.expected:
            error = error + self.expected.error(generated)
        return resting_error(error) if self.rests else error

    @property
    def start_to_goal(self) -> float:
        """The goal's part of the error of staying at the start, as sensed: how much there is to be explained."""
        pixels, codes = self.start
        staying = Generated(pixels[None, None], codes.clamp(min=1e-12).log()[None, None])
        return float(self.goal_error(staying)[0, 0])

    def errors(self, generated: Generated) -> tuple[Float[Tensor, " B"], Int[Tensor, " B"]]:
        """The prediction error and the arrival step. The delay penalty picks the step; it does not enter the error."""
        at_every_step = self.goal_error(generated)
        arrival = self.earliest + arrival_step(at_every_step[:, self.earliest :], delay_penalty=self.delay_penalty)
        return self.start_error(generated) + at_every_step.gather(1, arrival[:, None])[:, 0], arrival

    def residuals(self, generated: Generated, aims: Int[Tensor, " B"]) -> Float[Tensor, "B R"]:
        """The same error at given arrival steps, as residuals."""
        at_goal, shares = self.counted(generated, aims)
        parts: list[Tensor] = []
        if self.modalities != "joints":
            parts.append(visual_residuals(at_goal.pixels, self.goal[0]) * shares[..., None, None, None])
        if self.modalities != "vision":
            parts.append(proprioceptive_residuals(at_goal.log_codes, self.goal[1]) * shares[..., None, None])
        if self.expected:
            parts.append(self.expected.residuals(at_goal).to(shares.dtype) * shares[..., None])
        parts.append(visual_residuals(generated.pixels[:, 0], self.start[0]))
        parts.append(proprioceptive_residuals(generated.log_codes[:, 0], self.start[1]))
        return torch.cat([part.flatten(1) for part in parts], dim=1)

    def counted(self, generated: Generated, aims: Int[Tensor, " B"]) -> tuple[Generated, Float[Tensor, "B T"]]:
        """The steps that count for the goal, and the root of each step's share: the arrival step alone where the goal is passed through."""
        if not self.rests:
            rows = torch.arange(len(aims), device=aims.device)
            passed = Generated(generated.pixels[rows, aims][:, None], generated.log_codes[rows, aims][:, None])
            return passed, passed.pixels.new_ones(len(aims), 1)
        later = torch.arange(generated.pixels.shape[1], device=aims.device) >= aims[:, None]
        return generated, (later / later.sum(1, keepdim=True)).sqrt().to(generated.pixels.dtype)

    def steps_until(self, aims: Int[Tensor, " B"]) -> int | None:
        """Up to the latest arrival, where nothing after it counts."""
        return None if self.rests else int(aims.max()) + 1


@dataclass(frozen=True, eq=False)
class ToSequence:
    """Equation 1: every percept of a sensed sequence."""

    sensed: InputSequence

    def errors(self, generated: Generated) -> tuple[Float[Tensor, " B"], Int[Tensor, " B"]]:
        """The mean prediction error of a step; there is nothing to aim at."""
        pixels, codes = (part.expand(len(generated.pixels), *part.shape[1:]) for part in self.sensed)
        error = sequence_error(generated, pixels, codes, pixels.new_ones(pixels.shape[:2])).total
        return error, torch.zeros(len(error), dtype=torch.long, device=error.device)

    def residuals(self, generated: Generated, aims: Int[Tensor, " B"]) -> Float[Tensor, "B R"]:
        """The same error as residuals."""
        pixels, codes = self.sensed
        visual = visual_residuals(generated.pixels, pixels)
        felt = proprioceptive_residuals(generated.log_codes, codes)
        return torch.cat([part.flatten(1) for part in (visual, felt)], dim=1) / pixels.shape[1] ** 0.5

    def steps_until(self, aims: Int[Tensor, " B"]) -> None:
        """All of them."""
        return None
