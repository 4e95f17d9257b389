"""Memory of endings: what goes with the picture of a goal, judged from how sequences end that are known to the end.

The picture of a goal between those of some demonstrations is, seen coarsely, nearly a blend of theirs, and what goes with it, the joints
or an intention, nearly the same blend of what goes with them. Kriging finds the blend: a Gaussian process whose kernel, the rational
quadratic, falls off slowly, with a constant mean. Its scale and noise are those under which each ending is told best by all others, and
how well it is told so says how far to trust what is recalled (leave one out; Rasmussen and Williams 2006, chapter 5).

>>> features, values = torch.arange(6.0)[:, None], 10 * torch.arange(6.0)[:, None]
>>> recalled = recall([(torch.tensor([2.5]), features)], values)
>>> round(recalled.mean.item()), bool(recalled.deviation < 5)
(25, True)
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

SCALES = (1.0, 3.0, 10.0, 30.0)
"""Squared lengths of the kernel that are tried, in median squared distances of the endings."""
NOISES = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
"""Variances of the noise that are tried, beside the kernel's 1."""
JUDGES = 200
"""Endings by which view, length and noise are chosen, the nearest where there are more: to try all takes their number cubed, each time."""

View = tuple[Float[Tensor, " _"], Float[Tensor, "N _"]]
"""What is looked at: the wanted features, and those of the endings."""


@dataclass(frozen=True, eq=False)
class Recalled:
    """What goes with a goal."""

    mean: Float[Tensor, " V"]
    deviation: Float[Tensor, " V"]
    """How far it may be off: as much as where one ending is recalled from all others, and more the further away those are that tell it."""


@dataclass(frozen=True, eq=False)
class Kriged:
    """What one length of the kernel and one noise make of a view."""

    length: float
    noise: float
    recalled: Recalled
    off: float
    """How badly each ending is told by all others: the sum of the logarithms of the mean squares."""


def recall(views: Sequence[View], values: Float[Tensor, "N V"]) -> Recalled:
    """The values that go with the wanted features, blended from those of N endings by that of the views that tells the endings best.

    Of a single ending nothing can be told but itself.
    """
    if len(values) == 1:
        return Recalled(values[0], torch.full_like(values[0], torch.inf))
    tried = [(told, view) for view in views for told in krige(*nearest(*view, values))]
    best, view = min(tried, key=lambda each: each[0].off)
    if len(values) > JUDGES:
        (best,) = krige(*view, values, lengths=(best.length,), noises=(best.noise,))
    return Recalled(best.recalled.mean.to(values), best.recalled.deviation.to(values))


def nearest(
    wanted: Float[Tensor, " F"], features: Float[Tensor, "N F"], values: Float[Tensor, "N V"]
) -> tuple[Float[Tensor, " F"], Float[Tensor, "M F"], Float[Tensor, "M V"]]:
    """The endings that look most like what is wanted, as many as may choose."""
    rows = torch.cdist(wanted[None], features)[0].argsort()[:JUDGES] if len(values) > JUDGES else slice(None)
    return wanted, features[rows], values[rows]


def krige(
    wanted: Float[Tensor, " F"],
    features: Float[Tensor, "N F"],
    values: Float[Tensor, "N V"],
    *,
    lengths: Sequence[float] | None = None,
    noises: Sequence[float] = NOISES,
) -> Iterator[Kriged]:
    """What each length of the kernel and each noise makes of a view, in double precision."""
    points, asked, told = (each.double().cpu() for each in (features, wanted[None], values))  # the matrices are too small for a GPU
    targets = torch.cat([told, told.new_zeros(1, told.shape[1])])
    distances, ways = torch.cdist(points, points).square(), torch.cdist(asked, points)[0].square()
    own = torch.cat([torch.ones(len(points)), torch.zeros(1)]).double().diag()
    for length in lengths or [scale * float(usual(distances)) for scale in SCALES]:
        alike = bordered(1 / (1 + distances / length))
        towards = torch.cat([1 / (1 + ways / length), torch.ones(1).double()])
        for noise in noises:
            inverse = torch.linalg.inv(alike + noise * own)
            weights = inverse @ targets  # of the endings, and the mean
            variances = 1 / inverse.diagonal()[:-1, None]  # of each ending, the others known
            off = variances * weights[:-1]
            variance = 1 + noise - towards @ inverse @ towards
            deviation = (variance * (off.square() / variances).mean(0)).clamp(min=0).sqrt()
            badness = float(off.square().mean(0).clamp(min=1e-12).log().sum())
            yield Kriged(length, noise, Recalled(towards @ weights, deviation), badness)


def in_own_units(rows: Float[Tensor, "M F"]) -> Float[Tensor, "M F"]:
    """Rows, the first of which is wanted among the others, in the usual distance between those."""
    return rows / usual(torch.cdist(rows[1:], rows[1:]))


def usual(distances: Float[Tensor, "N N"]) -> Float[Tensor, ""]:
    """The median of those that are not 0; 1 if all are."""
    return distances[distances > 0].median() if bool((distances > 0).any()) else distances.new_ones(())


def bordered(kernel: Float[Tensor, "N N"]) -> Float[Tensor, "M M"]:
    """The kernel with a row and a column of ones: what the weights have to sum to zero for, so that the mean is free."""
    border = kernel.new_ones(len(kernel), 1)
    return torch.cat([torch.cat([kernel, border], 1), torch.cat([border.T, kernel.new_zeros(1, 1)], 1)])
