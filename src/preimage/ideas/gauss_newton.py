"""Gauss-Newton: solve for the change of an intention that brings all pixels and codes nearest to where they should be.

Damped as by Levenberg and Marquardt. It serves an intention of few numbers, needs no gradient and arrives in a handful of iterations. The
Jacobian comes cheaply from what is known: at first from a regression on what is imagined already from other intentions, then from what a
step itself shows (Broyden 1965), so that most iterations imagine three sequences and no more. It is measured, by finite differences,
only at first and where a step brings too little, and only in the few directions that matter most: those of the Jacobian known so far, at
first those in which the endings of the training sequences differ, where these are known.

Several intentions are regressed side by side, for the error has many valleys; those that fall behind are dropped.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from preimage.ideas.residuals import num_steps, residuals_of
from preimage.method.seam import Objective, Problem, Regression
from preimage.network.pdvmrnn import Generated
from preimage.records import Stopped


@dataclass(frozen=True, eq=False)
class Iterate:
    """B points of the intention space, and the error of what is imagined from them."""

    points: Float[Tensor, "B K"]
    error: Float[Tensor, " B"]
    arrival: Int[Tensor, " B"]
    residuals: Float[Tensor, "B R"]
    generated: Generated
    """What is imagined from them."""

    def __getitem__(self, rows: Tensor) -> "Iterate":
        return Iterate(self.points[rows], self.error[rows], self.arrival[rows], self.residuals[rows], self.generated[rows])


DAMPINGS = (0.03, 1.0, 30.0)
"""Shares of the mean curvature that are added to it: how far each of the steps goes that are tried side by side."""
LEADING = 8
"""Directions in which the Jacobian is measured anew."""
BEHIND = 1.3
"""A candidate whose error is more than this many times the lowest after an iteration is dropped."""
WORTHWHILE = 0.2
"""A step that lowers the error by less than this share of it is not worth another with the same Jacobian."""
NEIGHBOURS = 100
"""Rollouts from which a first Jacobian is estimated: what is imagined from them has to be held at once."""


@dataclass(frozen=True)
class GaussNewton:
    """The search; its best iterate comes back with its own error."""

    iterations: int = 12
    """At the most."""
    finite_difference_step: float = 0.15
    """How far each number is changed to see what it does, in standard deviations of the training intentions."""
    tolerance: float = 0.0
    """Share of the error of staying at the start at which the search ends: what is left is in single pixels."""
    endings: Callable[[Problem], Float[Tensor, "N E"]] | None = None
    """How the training sequences end, in any numbers that change as they do; without, a first Jacobian is measured in all directions."""

    @torch.no_grad()
    def __call__(self, problem: Problem, objective: Objective, guesses: Float[Tensor, "B K"]) -> Regression:
        space, cost = problem.space, problem.config.intention_cost
        tolerance = self.tolerance * objective.to_explain if self.tolerance else 0.0
        here = evaluate(guesses, problem, objective)
        jacobian, stale = None, True
        lowest = [here.error.min()]
        stopped = Stopped.ITERATIONS
        for _ in range(self.iterations):
            if lowest[-1] <= tolerance:
                stopped = Stopped.ENOUGH
                break
            rollouts = problem.rollouts_at_hand
            if jacobian is None and rollouts and len(space.training) > guesses.shape[1]:
                jacobian = jacobian_from(here, space.training, rollouts, objective)
            fresh = stale
            if jacobian is None or stale:
                hint = slopes(here.points, space.training, self.endings(problem)) if jacobian is None and self.endings else jacobian
                jacobian = measured_jacobian(here, jacobian, hint, problem, objective, self.finite_difference_step)
            tried = evaluate(steps_from(here, jacobian, cost).flatten(0, 1), problem, objective)
            there = better_of(here, tried)
            jacobian = broyden_update(jacobian, here, there)
            near = there.error <= BEHIND * there.error.min()
            here, jacobian = there[near], jacobian[near]
            lowest.append(here.error.min())
            stale = bool(lowest[-1] > (1 - WORTHWHILE) * lowest[-2])
            if stale and fresh and lowest[-1] > tolerance:
                stopped = Stopped.CONVERGED
                break
        return Regression(space.intention(here.points), here.error, torch.stack(lowest), stopped, here.generated)


def evaluate(points: Float[Tensor, "B K"], problem: Problem, objective: Objective) -> Iterate:
    """What is imagined from points, and how far it is off."""
    generated = problem.imagine(problem.space.intention(points))
    error, arrival = objective.errors(generated)
    return Iterate(points, error, arrival, residuals_of(objective, generated, arrival), generated)


def jacobian_from(here: Iterate, points: Float[Tensor, "N K"], rollouts: Generated, objective: Objective) -> Float[Tensor, "B K R"]:
    """How the residuals change with each coordinate, estimated from what is imagined from other points."""

    def at(row: int) -> Tensor:
        ways, nearness, near = ways_to(points, here.points[row])
        changes = residuals_of(objective, rollouts[near], here.arrival[row].expand(len(near))) - here.residuals[row]
        return regressed(ways, nearness, changes)

    return torch.stack([at(row) for row in range(len(here.points))])


def slopes(here: Float[Tensor, "B K"], points: Float[Tensor, "N K"], values: Float[Tensor, "N E"]) -> Float[Tensor, "B K E"]:
    """How values that are known at points change with each coordinate about others."""

    def at(point: Tensor) -> Tensor:
        ways, nearness, near = ways_to(points, point)
        means = (nearness @ part / nearness.sum() for part in (ways, values[near]))
        return regressed(ways - next(means), nearness, values[near] - next(means))

    return torch.stack([at(point) for point in here])


def ways_to(points: Float[Tensor, "N K"], point: Float[Tensor, " K"]) -> tuple[Tensor, Tensor, Tensor]:
    """The ways to the nearest of some points (M, K), how much each counts in a regression (M), and which they are (M)."""
    ways = points - point
    distances = ways.square().sum(1)
    near = distances.argsort()[:NEIGHBOURS]
    return ways[near], 1 / (1 + distances[near] / distances[near].median().clamp(min=1e-9)), near


def regressed(ways: Float[Tensor, "M K"], nearness: Float[Tensor, " M"], changes: Float[Tensor, "M R"]) -> Float[Tensor, "K R"]:
    """The linear map from ways to changes; damped, for there may be hardly more of them than coordinates."""
    weighed = ways.T * nearness
    curvature = weighed @ ways
    damping = 1e-3 * curvature.diagonal().mean() + 1e-9
    return torch.linalg.solve(curvature + damping * torch.eye(len(weighed)).to(weighed), weighed @ changes)


def measured_jacobian(
    here: Iterate,
    known: Float[Tensor, "B K R"] | None,
    hint: Float[Tensor, "B K E"] | None,
    problem: Problem,
    objective: Objective,
    step: float,
) -> Float[Tensor, "B K R"]:
    """How the residuals change with each coordinate, the arrival steps held. Nothing later than the last of them need be imagined.

    Args:
        known: the Jacobian at points nearby, which is measured anew in the leading directions alone; None: nothing of it is known.
        hint: what changes with the coordinates much as the residuals do. Its leading directions are those in which it changes most, the
            others hardly matter to a step; None: all directions.
    """
    count, dimensions = here.points.shape
    known = here.residuals.new_zeros(count, dimensions, here.residuals.shape[1]) if known is None else known
    if hint is None or dimensions <= LEADING:
        directions = torch.eye(dimensions).to(here.points).expand(count, -1, -1)
    else:
        directions = torch.linalg.eigh(hint @ hint.mT).eigenvectors.mT[:, -LEADING:]  # (B, D, K)
    probes = here.points[:, None] + step * directions
    changed = problem.imagine(problem.space.intention(probes.flatten(0, 1)), num_steps(objective, here.arrival))
    residuals = residuals_of(objective, changed, here.arrival.repeat_interleave(probes.shape[1]))
    measured = (residuals.view(*probes.shape[:2], -1) - here.residuals[:, None]) / step
    return known + directions.mT @ (measured - directions @ known)


def broyden_update(jacobian: Float[Tensor, "B K R"], here: Iterate, there: Iterate) -> Float[Tensor, "B K R"]:
    """The Jacobian that agrees with what a step did to the residuals, and changes as little as possible (Broyden's rank-one update)."""
    way = there.points - here.points
    unexpected = there.residuals - here.residuals - (way[:, :, None] * jacobian).sum(1)
    return jacobian + way[:, :, None] * unexpected[:, None] / way.square().sum(1).clamp(min=1e-9)[:, None, None]


def steps_from(here: Iterate, jacobian: Float[Tensor, "B K R"], cost: float) -> Float[Tensor, "B L K"]:
    """Where the linearised residuals are least, for each of the dampings."""
    curvature = jacobian @ jacobian.mT  # (B, K, K)
    downhill = (jacobian @ here.residuals[:, :, None])[..., 0] + cost * here.points
    identity = torch.eye(here.points.shape[1]).to(curvature)
    mean = curvature.diagonal(dim1=1, dim2=2).mean(1)[:, None, None]
    steps = [torch.linalg.solve(curvature + (cost + damping * mean + 1e-9) * identity, downhill) for damping in DAMPINGS]
    return here.points[:, None] - torch.stack(steps, 1)


def better_of(here: Iterate, tried: Iterate) -> Iterate:
    """For each point the best of itself and the steps tried from it."""
    count = len(here.points)
    generated = Generated(*(torch.cat([getattr(each.generated, name) for each in (here, tried)]) for name in ("pixels", "log_codes")))
    values = (torch.cat([getattr(each, name) for each in (here, tried)]) for name in ("points", "error", "arrival", "residuals"))
    both = Iterate(*values, generated=generated)
    rows = torch.cat([torch.arange(count)[:, None], count + torch.arange(len(tried.points)).view(count, -1)], 1).to(here.arrival.device)
    return both[rows.gather(1, both.error.nan_to_num(nan=torch.inf)[rows].argmin(1, keepdim=True))[:, 0]]
