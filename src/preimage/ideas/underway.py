"""What a plan is charged for while it is executed: what was sensed lately, and the goal at a step still to come."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from preimage.ideas.residuals import residuals_of
from preimage.method.prediction_error import ToGoal
from preimage.network.divergence import VISUAL_WEIGHT, proprioceptive_error, proprioceptive_residuals, visual_error, visual_residuals
from preimage.network.pdvmrnn import Generated


@dataclass(frozen=True, eq=False)
class Sensed:
    """A percept that was sensed, and the step of the imagined way at which it was."""

    step: int
    pixels: Float[Tensor, "C H W"]
    """Where no frame came, the last one that did."""
    codes: Float[Tensor, "J K"]
    seen: bool
    """Whether a frame came."""


@dataclass(frozen=True, eq=False)
class Window:
    """The last percepts, of W steps."""

    steps: Int[Tensor, " W"]
    """The steps of the imagined way at which they were sensed."""
    pixels: Float[Tensor, "W C height width"]
    codes: Float[Tensor, "W J K"]
    seen: Bool[Tensor, " W"]

    @classmethod
    def of(cls, sensed: Sequence[Sensed]) -> "Window":
        """Some percepts, one or more."""
        pixels, codes = torch.stack([each.pixels for each in sensed]), torch.stack([each.codes for each in sensed])
        steps, seen = torch.tensor([each.step for each in sensed]), torch.tensor([each.seen for each in sensed])
        return cls(steps.to(pixels.device), pixels, codes, seen.to(pixels.device))

    def imagined(self, generated: Generated) -> Generated:
        """What was imagined for these steps."""
        return Generated(generated.pixels[:, self.steps], generated.log_codes[:, self.steps])

    def errors(self, generated: Generated) -> Float[Tensor, " B"]:
        """The mean prediction error of a step, both modalities; a frame that did not come is not counted."""
        imagined, num_seen = self.imagined(generated), self.seen.sum().clamp(min=1)
        visual = (visual_error(imagined.pixels, self.pixels) * self.seen).sum(1) / num_seen
        return VISUAL_WEIGHT * visual + proprioceptive_error(imagined.log_codes, self.codes).mean(1)

    def errors_by_step(self, generated: Generated) -> Float[Tensor, "B W"]:
        """The prediction error of each step, both modalities."""
        imagined = self.imagined(generated)
        visual = visual_error(imagined.pixels, self.pixels) * self.seen
        return VISUAL_WEIGHT * visual + proprioceptive_error(imagined.log_codes, self.codes)

    def residuals(self, generated: Generated) -> Float[Tensor, "B R"]:
        """What `errors` sums, as residuals."""
        imagined, num_seen = self.imagined(generated), self.seen.sum().clamp(min=1)
        visual = visual_residuals(imagined.pixels, self.pixels) * (self.seen / num_seen).sqrt()[:, None, None, None]
        felt = proprioceptive_residuals(imagined.log_codes, self.codes) / len(self.steps) ** 0.5
        return torch.cat([visual.flatten(1), felt.flatten(1)], dim=1)


@dataclass(frozen=True, eq=False)
class Underway:
    """The objective of a step: the window's error and the goal's, both in one."""

    to_goal: ToGoal
    """Its earliest arrival is now."""
    window: Window

    def errors(self, generated: Generated) -> tuple[Float[Tensor, " B"], Int[Tensor, " B"]]:
        error, arrival = self.to_goal.errors(generated)
        return error + self.window.errors(generated), arrival

    def residuals(self, generated: Generated, arrival: Int[Tensor, " B"]) -> Float[Tensor, "B R"]:
        return torch.cat([residuals_of(self.to_goal, generated, arrival), self.window.residuals(generated)], dim=1)

    def num_steps(self, arrival: Int[Tensor, " B"]) -> None:
        """All of them."""
        return None

    @property
    def to_explain(self) -> float:
        return self.to_goal.to_explain
