"""Expected joints: a goal of which only the picture is known is charged for joints that do not go with such pictures (a Gaussian each).

A picture alone has false bottoms: a hand above the table looks like one further away on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float, Int
from torch import Tensor

from preimage.ideas.memory import DemonstrationMemory, Estimate
from preimage.method.seam import ErrorTerm, Problem, at_step
from preimage.network.coding import JointCoding
from preimage.network.pdvmrnn import Generated

WIDER = 3.0
"""Expectations are held so many times wider than they are: the network does not imagine what it expects to a hair."""


@dataclass(frozen=True, eq=False)
class ExpectedJoints:
    """Half the squared distance from the estimate in WIDER standard deviations, summed over joints: how unlikely joints are (nats)."""

    coding: JointCoding
    estimate: Estimate

    def errors(self, generated: Generated) -> Float[Tensor, "B T"]:
        return self._off(generated).square().sum(-1)

    def residuals(self, generated: Generated, arrival: Int[Tensor, " B"]) -> Float[Tensor, "B R"]:
        return self._off(at_step(generated, arrival))[:, 0]

    def num_steps(self, arrival: Int[Tensor, " B"]) -> int:
        return int(arrival.max()) + 1

    def _off(self, generated: Generated) -> Float[Tensor, "B T J"]:
        joints = self.coding.decode(generated.log_codes.to(self.estimate.mean.dtype).exp())
        return (joints - self.estimate.mean) / (WIDER * self.estimate.deviation) / 2**0.5


@dataclass(frozen=True, eq=False)
class ExpectJoints:
    """Add what a memory expects at the goal, where its picture alone is known."""

    memory: DemonstrationMemory

    def __call__(self, problem: Problem, terms: Sequence[ErrorTerm]) -> Sequence[ErrorTerm]:
        if problem.config.modalities != "vision":
            return terms
        return [*terms, ExpectedJoints(problem.model.coding, self.memory.about(problem).joints_at_goal)]
