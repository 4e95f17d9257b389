"""Calibration: what evidence against a plan means, learned from goals of which it is known whether they were reached.

Two things are learned. A logistic regression gives the probability of success; its weights are none of them negative, so that more of
any evidence never makes a plan more likely to succeed. And a conformal bound (Vovk, Gammerman and Shafer 2005) says from where on a goal
is refused: of n goals that could be reached, the next one like them is stranger than the k-th strangest with a probability of k / (n + 1)
at most, whatever the evidence is. Less than 1 / (n + 1) can be promised of no rule. What is usual is learned from other possible goals
than those the limit is set by, for the bound holds of a measure that has not seen them.

>>> evidence, reached = [{"error": float(number)} for number in range(20)], [number < 10 for number in range(20)]
>>> calibration = Calibration.of(evidence, reached, possible=[number < 8 for number in range(20)])
>>> calibration.probability({"error": 1.0}) > 0.9 > 0.1 > calibration.probability({"error": 18.0})
True
>>> calibration.is_refused({"error": 5.0}), calibration.is_refused({"error": 30.0}), round(calibration.false_refusals, 2)
(False, True, 0.17)
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from jaxtyping import Bool, Float

FALSE_REFUSALS = 0.02
"""Share of the goals that would be reached that may be refused, where so small a share can be promised."""
RIDGE = 0.3
"""Penalty of a squared weight, as much as a goal with that loss: evidence that says little gets little weight."""
FARTHEST = -3.0, 8.0
"""Evidence counts for the probability down and up to so many spreads from the usual."""
SPREAD_QUANTILE = 0.9
"""The spread of evidence is from the median of possible goals to this quantile of them."""
EVERY = 3
"""Of the possible goals every third says what is usual; the others set the limit of refusals."""
SMALLEST_SPREAD = 0.3
"""Evidence is logarithmic: factors of less than 1.35 are none, and a few goals that are alike by chance make no spread."""
NEWTON_STEPS = 30

Evidence = Mapping[str, float]
Options = Mapping[str, str | float | bool | None]


@dataclass(frozen=True)
class Calibration:
    """What is kept of n calibration goals, beside a run's weights."""

    names: tuple[str, ...]
    """The evidence that was looked at."""
    usual: tuple[float, ...]
    """Its median among possible goals."""
    spread: tuple[float, ...]
    """From the median up to SPREAD_QUANTILE."""
    weights: tuple[float, ...]
    """Log odds of failure for each spread of each evidence; 0 or more."""
    bias: float
    """Log odds of success of usual evidence."""
    limit: float
    """Goals stranger than this are refused (`strangeness_of`)."""
    num_possible: int
    """Goals by which the limit was set."""
    num_stranger: int
    """How many of them are refused."""
    num_goals: int
    """Goals by which the probability was fitted."""
    num_reached: int
    plan: Options = field(default_factory=dict)
    """The options of the plans: it holds for no others."""
    likely_only: tuple[str, ...] = ()
    """Evidence that says how likely a plan is to succeed, and refuses no goal."""

    def __post_init__(self) -> None:
        """Raises ValueError where what is kept does not fit together."""
        for name in ("usual", "spread", "weights"):
            if len(getattr(self, name)) != len(self.names):
                raise ValueError(f"{len(self.names)} names and {len(getattr(self, name))} {name}")
        if not self.names or min(self.spread) <= 0 or min(self.weights) < 0:
            raise ValueError(f"a spread is {min(self.spread, default=0):g} and a weight {min(self.weights, default=0):g}")
        if not 0 <= self.num_stranger < self.num_possible:
            raise ValueError(f"num_stranger is {self.num_stranger} of {self.num_possible} goals")

    @classmethod
    def of(
        cls,
        evidence: Sequence[Evidence],
        reached: Sequence[bool],
        *,
        possible: Sequence[bool],
        refusing: Collection[str] = (),
        likely_only: Collection[str] = (),
        plan: Options | None = None,
    ) -> Self:
        """Learn from what became of goals.

        Args:
            evidence: of each goal, all of the same names.
            reached: whether its plan succeeded.
            possible: whether it is one of those goals that are not to be refused: drawn as the demonstrations were, and reached.
            refusing: names of evidence that says what cannot be, and nothing of how likely is what can: it counts for refusals alone.
            likely_only: names of evidence that counts for the probability alone.

        Raises:
            ValueError: there are too few possible goals that were reached, or names differ.
        """
        names = tuple(evidence[0]) if evidence else ()
        if any(tuple(each) != names for each in evidence):
            raise ValueError("the goals have different evidence: calibrate with goals of one kind")
        rows, known = np.array([[each[name] for name in names] for each in evidence]), np.array(possible, bool)
        if known.sum() < EVERY:
            raise ValueError(f"{int(known.sum())} goals that were reached cannot calibrate anything: give {EVERY} or more")
        of_usual = np.flatnonzero(known)[::EVERY]
        usual = rounded(np.median(rows[of_usual], axis=0))
        spread = rounded(np.maximum(np.quantile(rows[of_usual], SPREAD_QUANTILE, axis=0) - usual, SMALLEST_SPREAD))
        known[of_usual] = False
        scaled = (rows - usual) / spread
        telling = np.array([name not in refusing for name in names])
        weights = np.zeros(len(names))
        bias, weights[telling] = fit_logistic(np.clip(scaled[:, telling], *FARTHEST), np.array(reached, bool))
        strange = np.array([name not in likely_only for name in names])
        limit, num_stranger = limit_of(strangeness_of(scaled[np.ix_(known, strange)]))
        return cls(
            names, tuple(usual.tolist()), tuple(spread.tolist()), tuple(rounded(weights).tolist()), round(bias, 6), limit,
            int(known.sum()), num_stranger, len(rows), int(np.sum(reached)), dict(plan or {}), tuple(likely_only),
        )  # fmt: skip

    def scaled(self, evidence: Evidence) -> Float[np.ndarray, " E"]:
        """Evidence in its spreads from the usual."""
        return (np.array([evidence[name] for name in self.names]) - self.usual) / self.spread

    def probability(self, evidence: Evidence) -> float:
        """Of success; falls with each evidence."""
        against = np.dot(self.weights, np.clip(self.scaled(evidence), *FARTHEST))
        return float(1 / (1 + np.exp(against - self.bias)))

    def strangeness(self, evidence: Evidence) -> float:
        """How far evidence is beyond its usual spread, in spreads, all of it together."""
        strange = [name not in self.likely_only for name in self.names]
        return float(strangeness_of(self.scaled(evidence)[None, strange])[0])

    def is_refused(self, evidence: Evidence) -> bool:
        """Whether a goal is stranger than the limit."""
        return self.strangeness(evidence) > self.limit

    @property
    def false_refusals(self) -> float:
        """The share of possible goals that are refused at most, on average over calibrations."""
        return (self.num_stranger + 1) / (self.num_possible + 1)

    @property
    def note(self) -> str:
        """What it stands on, and what it promises."""
        return (
            f"calibrated by {self.num_goals} goals, {self.num_reached} of which were reached; refuses {100 * self.false_refusals:.1f} % at "
            f"most of the goals that it reaches, and with {self.num_possible} of them less than 1/{self.num_possible + 1} can be promised "
            "of no rule"
        )


def strangeness_of(scaled: Float[np.ndarray, "N E"]) -> Float[np.ndarray, " N"]:
    """Of evidence in spreads from the usual, what lies beyond one spread, summed: what cannot be is often a little strange in many ways,
    where a goal that can be reached is so in one.

    >>> strangeness_of(np.array([[0.9, 0.9, 0.9], [3.0, 0.0, -5.0], [2.0, 2.0, 2.0]])).tolist()
    [0.0, 2.0, 3.0]
    """
    return np.maximum(scaled - 1, 0).sum(axis=1)


def fit_logistic(rows: Float[np.ndarray, "N E"], success: Bool[np.ndarray, " N"]) -> tuple[float, Float[np.ndarray, " E"]]:
    """Bias and weights of the log odds bias - weights @ row, the weights 0 or more, by Newton's method with a ridge.

    Evidence whose weight would be negative is left out, one after the other, the most negative first.
    """
    left = list(range(rows.shape[1]))
    while True:
        inputs = np.column_stack([np.ones(len(rows)), -rows[:, left]])
        found, ridge = np.zeros(inputs.shape[1]), RIDGE * np.eye(inputs.shape[1])
        ridge[0, 0] = RIDGE / 100  # a set of successes alone has no finite bias
        for _ in range(NEWTON_STEPS):
            likely = 1 / (1 + np.exp(-inputs @ found))
            slope = inputs.T @ (success - likely) - ridge @ found
            step = np.linalg.solve((inputs * (likely * (1 - likely))[:, None]).T @ inputs + ridge, slope)
            found = found + step / max(1.0, float(np.abs(step).max()))
        if not left or found[1:].min() >= 0:
            weights = np.zeros(rows.shape[1])
            weights[left] = found[1:]
            return float(found[0]), weights
        del left[int(found[1:].argmin())]


def limit_of(strangeness: Float[np.ndarray, " N"]) -> tuple[float, int]:
    """From where on goals are refused, and how many of these possible ones are stranger.

    Of n goals the k-th strangest is the limit, k being the most for which k / (n + 1) is at most FALSE_REFUSALS. Where there are too few
    for that to be one, the limit lies beyond the strangest, by as much as an exponential tail would have it.
    """
    ordered = np.sort(strangeness)
    num_stranger = max(0, int(FALSE_REFUSALS * (len(ordered) + 1)) - 1)
    median = np.median(ordered)
    tail = float((ordered[ordered >= median] - median).mean())
    beyond = tail * max(0.0, float(np.log(1 / (FALSE_REFUSALS * (len(ordered) + 1)))))
    return float(ordered[-1 - num_stranger]) + beyond, num_stranger


def rounded(numbers: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """To as many digits as are kept."""
    return np.round(numbers, 6)
