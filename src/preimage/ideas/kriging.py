"""Kriging: what goes with the picture of a goal, predicted from how sequences end that are known to the end.

The picture of a goal between those of some demonstrations is, seen coarsely, nearly a blend of theirs, and what goes with it, the joints
or an intention, nearly the same blend of what goes with them. Kriging finds the blend: a Gaussian process whose kernel, the rational
quadratic, falls off slowly, with a constant mean. Its scale and noise are those under which each ending is predicted best by all others,
and how well it is says how far to trust the prediction (leave one out; Rasmussen and Williams 2006, chapter 5).

>>> features, values = torch.arange(6.0)[:, None], 10 * torch.arange(6.0)[:, None]
>>> predicted = krige([(torch.tensor([2.5]), Endings(features))], values)
>>> round(predicted.mean.item()), bool(predicted.deviation < 5)
(25, True)
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

SCALES = (1.0, 3.0, 10.0, 30.0)
"""Squared lengths of the kernel that are tried, in median squared distances of the endings."""
NOISES = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
"""Variances of the noise that are tried, beside the kernel's 1."""
IN_COMMON = 25
"""Endings that tell kernels apart as one would that has nothing in common with the others: a residual of one is that of its neighbours."""
MAX_FIT_POINTS = 200
"""Endings by which view, length and noise are chosen, the nearest where there are more: to try all takes their number cubed, each time."""


@dataclass(frozen=True, eq=False)
class Kernel:
    """How alike endings are, by one length and one noise, or by each of several."""

    length: Float[Tensor, "*several"]
    noise: Float[Tensor, "*several"]
    inverse: Float[Tensor, "*several M M"]
    """Of the kernel between all endings, with its noise and its border (`bordered`)."""

    def __getitem__(self, which: int) -> "Kernel":
        return Kernel(self.length[which], self.noise[which], self.inverse[which])

    def towards(self, distances: Float[Tensor, " N"]) -> Float[Tensor, "*several M"]:
        """How alike the endings are to what is so far from them (squared), with the border."""
        alike = 1 / (1 + distances / self.length[..., None])
        return torch.cat([alike, torch.ones_like(alike[..., :1])], -1)

    def variance(self, towards: Float[Tensor, "*several M"]) -> Float[Tensor, "*several"]:
        """Of a prediction for what the endings are so alike to."""
        return 1 + self.noise - (towards * (self.inverse @ towards[..., None])[..., 0]).sum(-1)


@dataclass(frozen=True, eq=False)
class Endings:
    """Features of N endings. What predictions need of them, whatever is asked for, is worked out once, in double precision."""

    features: Float[Tensor, "N F"]

    @cached_property
    def points(self) -> Float[Tensor, "N F"]:
        return self.features.double().cpu()  # the matrices are too small for a GPU

    @cached_property
    def distances(self) -> Float[Tensor, "N N"]:
        """Squared."""
        return torch.cdist(self.points, self.points).square()

    @cached_property
    def kernels(self) -> Kernel:
        """Those that are tried."""
        scales, noises = torch.tensor(list(itertools.product(SCALES, NOISES))).double().T
        return self.kernel(scales * usual(self.distances), noises)

    def kernel(self, length: Float[Tensor, "*several"], noise: Float[Tensor, "*several"]) -> Kernel:
        own = torch.cat([torch.ones(len(self.points)), torch.zeros(1)]).double().diag()
        alike = bordered(1 / (1 + self.distances / length[..., None, None]))
        return Kernel(length, noise, torch.linalg.inv(alike + noise[..., None, None] * own))


View = tuple[Float[Tensor, " _"], Endings]
"""What is looked at: the wanted features, and those of the endings."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """What goes with a goal."""

    mean: Float[Tensor, " V"]
    deviation: Float[Tensor, " V"]
    """How far it may be off: as much as where one ending is predicted from all others, and more the further away those are."""


@dataclass(frozen=True, eq=False)
class Fits:
    """What each of K kernels makes of a view."""

    kernels: Kernel
    mean: Float[Tensor, "K V"]
    deviation: Float[Tensor, "K V"]
    residual: Float[Tensor, " K"]
    """How badly each ending is predicted by all others: the sum of the logarithms of the mean squared leave-one-out residuals."""


def krige(views: Sequence[View], values: Float[Tensor, "N V"]) -> Prediction:
    """The values that go with the wanted features, by that of the views that predicts the N endings best.

    Of a single ending nothing can be said but itself.
    """
    if len(values) == 1:
        return Prediction(values[0], torch.full_like(values[0], torch.inf))
    tried = [(fits(*nearest(*view, values)), view) for view in views]
    found, view = min(tried, key=lambda each: float(each[0].residual.min()))
    best = int(found.residual.argmin())
    if len(values) > MAX_FIT_POINTS:
        known = found.kernels[best]
        found, best = fits(*view, values, kernels=view[1].kernel(known.length[None], known.noise[None])), 0
    return Prediction(found.mean[best].to(values), found.deviation[best].to(values))


def krige_by_all(views: Sequence[View], values: Float[Tensor, "N V"]) -> Prediction:
    """The same by all kernels of all views, each weighed by how likely the endings are by it, the others known: pseudo Bayesian model
    averaging (Yao, Vehtari, Simpson and Gelman 2018), tempered. Where they contradict each other, the deviation is large.

    It is asked of MAX_FIT_POINTS endings at most, the same at every goal, so that matrices are inverted once.
    """
    tried = [fits(*view, values) for view in views]
    means, deviations, residuals = (torch.cat([getattr(each, name) for each in tried]) for name in ("mean", "deviation", "residual"))
    weights = (-len(values) / IN_COMMON * residuals / 2).softmax(0)[:, None]
    mean = (weights * means).sum(0)
    deviation = (weights * (deviations.square() + (means - mean).square())).sum(0).sqrt()
    return Prediction(mean.to(values), deviation.to(values))


def nearest(
    wanted: Float[Tensor, " F"], endings: Endings, values: Float[Tensor, "N V"]
) -> tuple[Float[Tensor, " F"], Endings, Float[Tensor, "M V"]]:
    """The endings that look most like what is wanted, at most MAX_FIT_POINTS of them."""
    if len(values) <= MAX_FIT_POINTS:
        return wanted, endings, values
    rows = torch.cdist(wanted[None], endings.features)[0].argsort()[:MAX_FIT_POINTS]
    return wanted, Endings(endings.features[rows]), values[rows]


def fits(wanted: Float[Tensor, " F"], endings: Endings, values: Float[Tensor, "N V"], *, kernels: Kernel | None = None) -> Fits:
    """What each of several kernels makes of a view, in double precision."""
    asked, known = (each.double().cpu() for each in (wanted[None], values))
    kernels = kernels or endings.kernels
    towards = kernels.towards(torch.cdist(asked, endings.points)[0].square())
    weights = kernels.inverse @ torch.cat([known, known.new_zeros(1, known.shape[1])])  # of the endings, and the mean
    variances = 1 / kernels.inverse.diagonal(dim1=-2, dim2=-1)[:, :-1, None]  # of each ending, the others known
    residuals = variances * weights[:, :-1]
    deviation = kernels.variance(towards)[:, None] * (residuals.square() / variances).mean(1)
    residual = residuals.square().mean(1).clamp(min=1e-12).log().sum(1)
    return Fits(kernels, (towards[:, None] @ weights)[:, 0], deviation.clamp(min=0).sqrt(), residual)


def in_own_units(rows: Float[Tensor, "M F"]) -> Float[Tensor, "M F"]:
    """Rows, the first of which is wanted among the others, in the usual distance between those."""
    return rows / usual(torch.cdist(rows[1:], rows[1:]))


def usual(distances: Float[Tensor, "N N"]) -> Float[Tensor, ""]:
    """The median of those that are not 0; 1 if all are."""
    return distances[distances > 0].median() if bool((distances > 0).any()) else distances.new_ones(())


def bordered(kernel: Float[Tensor, "*several N N"]) -> Float[Tensor, "*several M M"]:
    """The kernel with a row and a column of ones: what the weights have to sum to zero for, so that the mean is free."""
    framed = torch.nn.functional.pad(kernel, (0, 1, 0, 1), value=1.0)
    framed[..., -1, -1] = 0
    return framed
