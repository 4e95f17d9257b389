"""How the paper's method learns and plans: its numbers, without torch, so that the command line can name them at once.

What goes beyond the paper has its numbers in `presets`.
"""

from dataclasses import dataclass
from typing import Literal, Self

from preimage.compute.precision import Precision
from preimage.network.ranges import validate

Modalities = Literal["vision", "joints", "both"]
"""What of a goal is used."""


@dataclass(frozen=True)
class TrainConfig:
    """How the network learns (section II-B): back-propagation through time, Adam, equation 1, in closed loop.

    Raises:
        ValueError: a number is out of range.
    """

    updates: int = 1400
    """Number of updates of weights and intentions."""
    batch_size: int = 10
    """Demonstrations an update."""
    learning_rate: float = 2e-3
    """Adam's rate for the weights at its highest; it warms up, then falls along a cosine."""
    intention_learning_rate: float = 2e-2
    """Adam's rate for the intentions, on the same course."""
    warmup_updates: int = 20
    """Updates over which the rates rise."""
    final_share: float = 0.05
    """Share of the rates that is left at the end."""
    gradient_norm: float = 1.0
    """Largest norm of the weights' gradient; longer ones are shortened to it."""
    rest_steps: int = 30
    """Steps of rest after a demonstration's end that count: the arm learns to stay at the goal."""
    precision: Precision = "auto"
    """Precision of the layers' arithmetic; weights, states and errors stay float32."""
    checkpoint_every: int = 100
    """Updates between two checkpoints."""
    seed: int = 0
    """Draws the first weights, the batches and the noise."""

    def __post_init__(self) -> None:
        at_least = {"updates": 1, "batch_size": 1, "warmup_updates": 1, "checkpoint_every": 1, "rest_steps": 0, "seed": 0}
        rates = "learning_rate", "intention_learning_rate", "gradient_norm"
        validate(self, at_least=at_least, held=("batch_size", "rest_steps"), above_zero=rates, shares=("final_share",))

    @classmethod
    def paper(cls) -> Self:
        """The paper's, where it says how; the numbers are ours."""
        return cls()


@dataclass(frozen=True)
class PlanConfig:
    """How an intention is searched for (sections II-C and II-D): random starts, Adam, equation 2.

    Raises:
        ValueError: a number is out of range.
    """

    modalities: Modalities = "vision"
    """The modalities of the goal that are used; the rest of a goal percept is not looked at."""
    candidates: int = 8
    """Intentions regressed side by side, each from its own initial guess; the best is the plan's."""
    initial_deviation: float = 0.3
    """Standard deviation of a random initial guess, in those of the training intentions: from the middle all of them are near."""
    screening: int = 15
    """Iterations after which only the finalists go on."""
    finalists: int = 2
    """Candidates that go on, those with the least error."""
    iterations: int = 50
    """Iterations at the most."""
    learning_rate: float = 0.3
    """Adam's rate, in standard deviations of the training intentions."""
    intention_cost: float = 0.001
    """Charge for the squared size of the intention, in standard deviations: how near the search stays to what was learned."""
    dimensions: int | None = None
    """Directions that are searched, those in which the training intentions differ most; None: all in which they do."""
    horizon: int | None = None
    """Steps imagined, T_max; by default as many as the longest demonstration has."""
    earliest_arrival: int | None = None
    """First step at which the goal may be reached; by default the last of the shortest demonstration. Sooner, the picture of an arm that
    has not moved can be nearer to the goal's than that of one on its way, and a search that begins far off stays there."""
    delay_penalty: float = 1.01
    """Factor a step on the goal error when the arrival step is chosen (section II-D)."""
    precision: Precision = "auto"
    """Precision of the layers' arithmetic while searching."""
    search_seed: int = 0
    """Draws the initial guesses."""

    def __post_init__(self) -> None:
        at_least = dict.fromkeys(("candidates", "finalists", "horizon", "dimensions"), 1.0)
        at_least |= dict.fromkeys(("screening", "iterations", "intention_cost", "search_seed", "earliest_arrival"), 0.0)
        validate(
            self,
            at_least=at_least | {"initial_deviation": 0},
            held=("candidates", "horizon", "dimensions"),
            above_zero=("learning_rate", "delay_penalty"),
        )
        if self.modalities not in ("vision", "joints", "both"):
            raise ValueError(f"modalities is {self.modalities}: give vision, joints or both")

    @classmethod
    def paper(cls) -> Self:
        """The paper's search: nothing in it goes beyond sections II-C and II-D."""
        return cls()
