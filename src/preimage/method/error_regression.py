"""Error regression: move an intention until what is imagined from it has the least prediction error, the weights frozen.

Two ways down. `descend` is the paper's: the error is carried back through the whole imagined sequence and Adam moves the intention.
`leap` makes use of an intention of few numbers: it learns how every pixel would move with each of them, and solves for the change that
brings all pixels nearest to where they should be (Gauss-Newton, damped as by Levenberg and Marquardt). It needs no gradient and arrives
in a handful of iterations. Slopes come cheaply from what is known: at first from a regression on what is imagined already for other
intentions, then from what a leap itself teaches (Broyden 1965), so that most iterations imagine three sequences and no more. They are
measured, by changing a number a little, only at first and where a leap brings too little, and only in the few directions that matter most.

Several intentions are regressed side by side, for the error has many valleys; those that fall behind are dropped.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from preimage.network.intention import IntentionSpace, IntentionState
from preimage.network.pdvmrnn import Generated
from preimage.records import Stopped

Imagine = Callable[[IntentionState, int | None], Generated]
"""What follows from intentions, for so many steps; None: up to the horizon."""


@dataclass(frozen=True)
class RegressionConfig:
    """How an intention is regressed."""

    method: Literal["leap", "descend"] = "leap"
    """leap: Gauss-Newton, for intentions of few numbers; descend: Adam on the gradient through time, the paper's."""
    candidates: int = 1
    """Intentions regressed side by side."""
    iterations: int | None = None
    """Iterations at the most; by default 12 leaps or 60 steps of Adam."""
    learning_rate: float = 0.05
    """Adam's rate, in units of the intention space; only where descending."""
    probe: float = 0.15
    """How far each number is changed to see what it does; only where leaping."""
    dimensions: int | None = 32
    """Directions that are searched, those in which the training intentions differ most; None: the numbers of the intention as they are."""
    intention_cost: float = 0.001
    """Charge for the squared size of the intention: unlikely ways to a goal cost more than likely ones."""
    precision: Literal["bfloat16", "float32"] = "bfloat16"
    """Precision of the layers' arithmetic while searching."""

    @property
    def most_iterations(self) -> int:
        return self.iterations if self.iterations is not None else {"leap": 12, "descend": 60}[self.method]


@runtime_checkable
class Objective(Protocol):
    """What is to become small: an error, and the same as a sum of squares at a fixed aim (the arrival step, of a plan)."""

    def errors(self, generated: Generated) -> tuple[Float[Tensor, " B"], Int[Tensor, " B"]]:
        """The prediction error of each sequence, and the aim it was taken at."""
        ...

    def residuals(self, generated: Generated, aims: Int[Tensor, " B"]) -> Float[Tensor, "B R"]:
        """Numbers whose squares sum to about the error, as it would be at these aims."""
        ...

    def steps_until(self, aims: Int[Tensor, " B"]) -> int | None:
        """How many steps `residuals` looks at; None: all up to the horizon."""
        ...


@dataclass(frozen=True, eq=False)
class Regression:
    """Where a regression of B intentions ended: for each the best iterate seen, with its own error."""

    intention: IntentionState
    error: Float[Tensor, " B"]
    errors: Float[Tensor, " iterations"]
    """The lowest error of all candidates, iteration by iteration."""
    stopped: Stopped

    @property
    def best(self) -> IntentionState:
        return self.intention[self.error.argmin()[None]]


def regress_intention(
    space: IntentionSpace,
    coordinates: Float[Tensor, "B K"],
    imagine: Imagine,
    objective: Objective,
    *,
    config: RegressionConfig,
    library: Generated | None = None,
    enough: float = 0.0,
) -> Regression:
    """Lower the error from each of B places in the intention space. The weights are not touched.

    A library, what is imagined from each of the space's training intentions, tells the first slopes, where there are more of them than
    coordinates; else these are measured. Only a leap needs them. An error of `enough` is not lowered further.

    The error that is returned is that of the intention that is returned, the best seen: the last value of a loop belongs to the step
    before.
    """
    if config.method == "leap":
        return leap(space, coordinates, imagine, objective, config, library, enough)
    return descend(space, coordinates, imagine, objective, config, enough)


def descend(
    space: IntentionSpace,
    coordinates: Float[Tensor, "B K"],
    imagine: Imagine,
    objective: Objective,
    config: RegressionConfig,
    enough: float,
) -> Regression:
    """Gradient descent through the imagined sequence (Adam)."""
    point = coordinates.clone().requires_grad_()
    optimiser = torch.optim.Adam([point], lr=config.learning_rate)
    best_point, best = coordinates.clone(), coordinates.new_full((len(point),), torch.inf)
    lowest: list[Tensor] = []
    stopped = Stopped.ITERATIONS
    for iteration in range(config.most_iterations + 1):
        with torch.enable_grad():
            error, _ = objective.errors(imagine(space.intention(point), None))
            charged = error + config.intention_cost * point.square().sum(1)
        found = error.detach() < best
        best = torch.where(found, error.detach(), best)
        best_point[found] = point.detach()[found]
        lowest.append(best.min())
        if lowest[-1] <= enough:
            stopped = Stopped.ENOUGH
            break
        if len(lowest) > 10 and lowest[-1] > 0.998 * lowest[-11]:
            stopped = Stopped.CONVERGED
            break
        if iteration < config.most_iterations:
            (point.grad,) = torch.autograd.grad(charged.sum(), point)
            optimiser.step()
    with torch.no_grad():
        return Regression(space.intention(best_point), best, torch.stack(lowest), stopped)


@dataclass(frozen=True, eq=False)
class Places:
    """Places in the intention space and what is imagined from them."""

    points: Float[Tensor, "B K"]
    error: Float[Tensor, " B"]
    aims: Int[Tensor, " B"]
    residuals: Float[Tensor, "B R"]

    def __getitem__(self, rows: Tensor) -> "Places":
        return Places(self.points[rows], self.error[rows], self.aims[rows], self.residuals[rows])


DAMPINGS = (0.03, 1.0, 30.0)
"""Shares of the mean curvature that are added to it: how far each of the leaps goes that are tried side by side."""
BEHIND = 1.3
"""A candidate whose error is more than this many times the lowest after a leap is dropped."""
LEADING = 8
"""Directions in which slopes are measured anew."""
NEIGHBOURS = 100
"""How many points of a library tell the slopes: what is imagined from them has to be held at once."""
ENOUGH = 0.2
"""A leap that lowers the error by less than this share of it is not worth another from the same slopes."""


@torch.no_grad()
def leap(
    space: IntentionSpace,
    coordinates: Float[Tensor, "B K"],
    imagine: Imagine,
    objective: Objective,
    config: RegressionConfig,
    library: Generated | None,
    enough: float,
) -> Regression:
    """Gauss-Newton on the residuals."""

    def visit(points: Tensor) -> Places:
        generated = imagine(space.intention(points), None)
        error, aims = objective.errors(generated)
        return Places(points, error, aims, objective.residuals(generated, aims))

    here = visit(coordinates)
    slopes, stale = None, True
    lowest = [here.error.min()]
    stopped = Stopped.ITERATIONS
    for _ in range(config.most_iterations):
        if lowest[-1] <= enough:
            stopped = Stopped.ENOUGH
            break
        if slopes is None and library and len(space.training) > coordinates.shape[1]:
            slopes = slopes_among(here, space.training, library, objective)
        fresh = stale
        if slopes is None or stale:
            slopes = slopes_at(here, slopes, space, imagine, objective, config.probe)
        tried = visit(leaps_from(here, slopes, config.intention_cost).flatten(0, 1))
        there = better_of(here, tried)
        slopes = learn_from_leap(slopes, here, there)
        near = there.error <= BEHIND * there.error.min()
        here, slopes = there[near], slopes[near]
        lowest.append(here.error.min())
        stale = bool(lowest[-1] > (1 - ENOUGH) * lowest[-2])
        if stale and fresh and lowest[-1] > enough:
            stopped = Stopped.CONVERGED
            break
    return Regression(space.intention(here.points), here.error, torch.stack(lowest), stopped)


def slopes_among(here: Places, points: Float[Tensor, "N K"], library: Generated, objective: Objective) -> Float[Tensor, "B K R"]:
    """How the residuals change with each coordinate, as what is imagined from other points tells.

    A linear regression in which nearer places count more; damped, for there may be hardly more of them than coordinates.
    """

    def at(place: int) -> Tensor:
        ways = points - here.points[place]
        distances = ways.square().sum(1)
        near = distances.argsort()[:NEIGHBOURS]
        ways, nearness = ways[near], 1 / (1 + distances[near] / distances[near].median().clamp(min=1e-9))
        generated = Generated(library.pixels[near], library.log_codes[near])
        changes = objective.residuals(generated, here.aims[place].expand(len(near))) - here.residuals[place]
        weighed = ways.T * nearness
        curvature = weighed @ ways
        damping = 1e-3 * curvature.diagonal().mean() + 1e-9
        return torch.linalg.solve(curvature + damping * torch.eye(len(weighed)).to(weighed), weighed @ changes)

    return torch.stack([at(place) for place in range(len(here.points))])


def slopes_at(
    here: Places, known: Float[Tensor, "B K R"] | None, space: IntentionSpace, imagine: Imagine, objective: Objective, probe: float
) -> Float[Tensor, "B K R"]:
    """How the residuals change with each coordinate, the aims held. Nothing later than the last aim need be imagined.

    Slopes that are known from places nearby are measured anew in their leading directions alone, those in which the residuals change
    most; the others hardly matter to a leap.
    """
    count, dimensions = here.points.shape
    if known is None:
        known = here.residuals.new_zeros(count, dimensions, here.residuals.shape[1])
        directions = torch.eye(dimensions).to(here.points).expand(count, -1, -1)
    else:
        directions = torch.linalg.eigh(known @ known.mT).eigenvectors.mT[:, -LEADING:]  # (B, D, K)
    probes = here.points[:, None] + probe * directions
    changed = imagine(space.intention(probes.flatten(0, 1)), objective.steps_until(here.aims))
    residuals = objective.residuals(changed, here.aims.repeat_interleave(probes.shape[1]))
    measured = (residuals.view(*probes.shape[:2], -1) - here.residuals[:, None]) / probe
    return known + directions.mT @ (measured - directions @ known)


def learn_from_leap(slopes: Float[Tensor, "B K R"], here: Places, there: Places) -> Float[Tensor, "B K R"]:
    """The slopes that agree with what a leap did to the residuals, and change as little as possible (Broyden's rank-one update)."""
    way = there.points - here.points
    unexpected = there.residuals - here.residuals - (way[:, :, None] * slopes).sum(1)
    return slopes + way[:, :, None] * unexpected[:, None] / way.square().sum(1).clamp(min=1e-9)[:, None, None]


def leaps_from(here: Places, slopes: Float[Tensor, "B K R"], cost: float) -> Float[Tensor, "B L K"]:
    """Where the linearised residuals are least, for each of the dampings."""
    curvature = slopes @ slopes.mT  # (B, K, K)
    downhill = (slopes @ here.residuals[:, :, None])[..., 0] + cost * here.points
    identity = torch.eye(here.points.shape[1]).to(curvature)
    mean = curvature.diagonal(dim1=1, dim2=2).mean(1)[:, None, None]
    steps = [torch.linalg.solve(curvature + (cost + damping * mean + 1e-9) * identity, downhill) for damping in DAMPINGS]
    return here.points[:, None] - torch.stack(steps, 1)


def better_of(here: Places, tried: Places) -> Places:
    """For each place the best of itself and the leaps tried from it."""
    count = len(here.points)
    both = Places(*(torch.cat([getattr(here, name), getattr(tried, name)]) for name in ("points", "error", "aims", "residuals")))
    rows = torch.cat([torch.arange(count)[:, None], count + torch.arange(len(tried.points)).view(count, -1)], 1).to(here.aims.device)
    return both[rows.gather(1, both.error.nan_to_num(nan=torch.inf)[rows].argmin(1, keepdim=True))[:, 0]]
