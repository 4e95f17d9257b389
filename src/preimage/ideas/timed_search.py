"""A search that is done a little at a time: at each step of the robot as much as fits into the step, and the rest at the next.

By its own measure of how long imagining a sequence takes, a step begins no work that would end too late.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from preimage.ideas.gauss_newton import DAMPINGS, WORTHWHILE, GaussNewton, Iterate, steps_from
from preimage.ideas.residuals import residuals_of
from preimage.method.error_regression import LEAST_GAIN, descend
from preimage.method.seam import Objective, Problem
from preimage.network.pdvmrnn import Generated

FIRST_S = 0.02
"""What imagining one sequence is taken to last before it was measured (s)."""
FORGETTING = 0.97
"""Share of a sequence's time that is left with every step: that a step was slow once must not keep all later ones from trying."""
PLANNED_SHARE = 0.8
"""Share of a step's time that what is begun may take by its measure; the rest is for what is done with it, and for a slower moment."""
PROBE = GaussNewton.finite_difference_step
DESCENT_COST = 6
"""Sequences that could be imagined in the time of an iteration of Adam: two, each there and back."""


class Clock:
    """How much of a step's time is left.

    Args:
        now: tells the time (s).
        budget_s: time for each step (s).
    """

    def __init__(self, now: Callable[[], float], budget_s: float) -> None:
        self._now, self._budget_s = now, budget_s
        self._alone_s, self._further_s = FIRST_S, None
        self.begin()

    def begin(self) -> None:
        """A step begins."""
        self._began, self.num_imagined = self._now(), 0
        self._alone_s *= FORGETTING
        self._further_s = None if self._further_s is None else FORGETTING * self._further_s

    @property
    def spent_s(self) -> float:
        return self._now() - self._began

    @property
    def room(self) -> int:
        """Sequences that can still be imagined in time, at once. One alone takes longer than one among others."""
        left_s = PLANNED_SHARE * self._budget_s - self.spent_s - self._alone_s
        return 0 if left_s < 0 else 1 + int(left_s / (self._further_s or self._alone_s))

    def imagine(self, problem: Problem, points: Float[Tensor, "B K"]) -> Generated:
        """What is imagined from points; how long it takes is kept in mind."""
        began = self._now()
        generated = problem.imagine(problem.space.intention(points))
        took_s, num_further = self._now() - began, len(points) - 1
        if num_further:
            further_s = max((took_s - self._alone_s) / num_further, took_s / len(points) / 2)
            self._further_s = slower(self._further_s or further_s, further_s)
        else:
            self._alone_s = slower(self._alone_s, took_s)
        self.num_imagined += len(points)
        return generated


def slower(known_s: float, took_s: float) -> float:
    """What something is taken to last the next time (s): not less than it just did, and more where it was slow before."""
    return max(took_s, (known_s + took_s) / 2, 1e-9)


@dataclass(frozen=True, eq=False)
class Solution:
    """A point of the intention space, and what is imagined from it."""

    points: Float[Tensor, "1 K"]
    generated: Generated


Improve = Callable[[Problem, Objective, Solution, Clock], Solution | None]
"""From a solution to a better one in the time that is left, to the same where that is too short, to None where none is better."""


class ByGaussNewton:
    """Gauss-Newton for an intention of few numbers.

    What a change of each number does is measured a few numbers at a time, as time allows, and kept: it is what is imagined that is kept,
    from which the residuals of any window and arrival follow.
    """

    def __init__(self) -> None:
        self._problem: Problem | None = None
        self._base: Solution | None = None
        self._probes: list[Generated] = []

    def __call__(self, problem: Problem, objective: Objective, here: Solution, clock: Clock) -> Solution | None:
        """One iteration, as far as time allows."""
        if self._base is None or self._problem is not problem:
            self._problem, self._base, self._probes = problem, here, []
        if not self._measure(self._base, problem, clock) or clock.room < len(DAMPINGS):
            return here
        before = objective.errors(here.generated)[0].item()
        there, error = self._step(self._base, problem, objective, here, clock)
        worthwhile, was_measured_here = error < (1 - WORTHWHILE) * before, self._base is here
        if not worthwhile:
            self._base = None  # measured anew, from where it is then
        if was_measured_here and error > (1 - LEAST_GAIN) * before:
            return None
        return there if error < before else here

    def _measure(self, base: Solution, problem: Problem, clock: Clock) -> bool:
        """Change each number in turn; whether all are done."""
        num_numbers = base.points.shape[1]
        while (known := sum(len(each.pixels) for each in self._probes)) < num_numbers and clock.room > 0:
            directions = torch.eye(num_numbers).to(base.points)[known : known + clock.room]
            self._probes.append(clock.imagine(problem, base.points + PROBE * directions))
        return known == num_numbers

    def _step(self, base: Solution, problem: Problem, objective: Objective, here: Solution, clock: Clock) -> tuple[Solution, float]:
        """The best of the steps that are tried side by side, and its error."""
        probes = Generated(*(torch.cat([getattr(each, part) for each in self._probes]) for part in ("pixels", "log_codes")))
        error, arrival = objective.errors(here.generated)
        now = Iterate(here.points, error, arrival, residuals_of(objective, here.generated, arrival), here.generated)
        changed = residuals_of(objective, probes, arrival.expand(len(probes.pixels)))
        jacobian = (changed - residuals_of(objective, base.generated, arrival)) / PROBE
        points = steps_from(now, jacobian[None], problem.config.intention_cost)[0]
        tried = clock.imagine(problem, points)
        errors = objective.errors(tried)[0].nan_to_num(nan=torch.inf)
        best = errors.argmin()[None]
        return Solution(points[best], Generated(tried.pixels[best], tried.log_codes[best])), errors[best].item()


def by_adam(problem: Problem, objective: Objective, here: Solution, clock: Clock) -> Solution | None:
    """An iteration of the paper's search, for intentions of many numbers."""
    if clock.room < DESCENT_COST:
        return here
    with torch.enable_grad():
        found = descend(problem, objective, here.points, 1)
    there = Solution(found.points, clock.imagine(problem, found.points))
    return there if bool(objective.errors(there.generated)[0] < objective.errors(here.generated)[0]) else None
