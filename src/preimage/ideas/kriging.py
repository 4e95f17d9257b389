"""Kriging: what goes with the picture of a goal, predicted from how sequences end that are known to the end.

The picture of a goal between those of some demonstrations is, seen coarsely, nearly a blend of theirs, and what goes with it, the joints
or an intention, nearly the same blend of what goes with them. Kriging finds the blend: a Gaussian process whose kernel, the rational
quadratic, falls off slowly, with a constant mean. Several scales and noises are tried, and each counts by how well it predicts each ending
from all others (leave one out; Rasmussen and Williams 2006, chapter 5), which also says how far to trust the prediction. A few dozen
demonstrations do not tell which of them is best, and a mean of those that do well is nearer than the best of them (docs/log.md).

>>> features, values = torch.arange(6.0)[:, None], 10 * torch.arange(6.0)[:, None]
>>> predicted = krige([(torch.tensor([2.5]), Endings(features))], values)
>>> round(predicted.mean.item()), bool(predicted.deviation < 5)
(25, True)
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Self

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

SCALES = (1.0, 3.0, 10.0, 30.0)
"""Squared lengths of the kernel that are tried, in median squared distances of the endings."""
NOISES = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
"""Variances of the noise that are tried, beside the kernel's 1."""
IN_COMMON = 25
"""Endings that tell kernels apart as one would that has nothing in common with the others: a residual of one is that of its neighbours."""
MAX_FIT_POINTS = 200
"""Endings by which all kernels are tried, some of all where there are more: it takes their number cubed."""
LEAST_COUNT = 0.05
"""Of 1; where there are more endings than that, a kernel that counts for less is not asked about all of them."""


@dataclass(frozen=True, eq=False)
class Kernel:
    """How alike endings are, by one length and one noise."""

    length: float
    noise: float
    inverse: Float[Tensor, "M M"]
    """Of the kernel between all endings, with its noise and its border (`bordered`)."""

    def towards(self, distances: Float[Tensor, " N"]) -> Float[Tensor, " M"]:
        """How alike the endings are to what is so far from them (squared), with the border."""
        return torch.cat([1 / (1 + distances / self.length), torch.ones(1).double()])

    def variance(self, towards: Float[Tensor, " M"]) -> Float[Tensor, ""]:
        """Of a prediction for what the endings are so alike to."""
        return 1 + self.noise - towards @ self.inverse @ towards


@dataclass(frozen=True, eq=False)
class Endings:
    """Features of N endings. What predictions need of them, whatever is asked for, is worked out once, in double precision."""

    features: Float[Tensor, "N F"]
    _known: dict[tuple[float, float], Kernel] = field(default_factory=dict, repr=False)

    @cached_property
    def few(self) -> Self:
        """At most MAX_FIT_POINTS of them, evenly drawn."""
        return type(self)(self.features[some_of(len(self.features))]) if len(self.features) > MAX_FIT_POINTS else self

    @cached_property
    def points(self) -> Float[Tensor, "N F"]:
        return self.features.double().cpu()  # the matrices are too small for a GPU

    @cached_property
    def distances(self) -> Float[Tensor, "N N"]:
        """Squared."""
        return torch.cdist(self.points, self.points).square()

    @cached_property
    def kernels(self) -> "Kernels":
        """Those that are tried."""
        return Kernels.of([self.kernel(scale * float(usual(self.distances)), noise) for scale in SCALES for noise in NOISES])

    def chosen(self, which: Bool[Tensor, " G"]) -> "Kernels":
        """Those that few of them chose, of all. They are kept, for they are likely to be chosen again."""
        those = [(one.length, one.noise) for one, is_chosen in zip(self.few.kernels.each, which.tolist(), strict=True) if is_chosen]
        for each in those:
            if each not in self._known:
                self._known[each] = self.kernel(*each)
        return Kernels.of([self._known[each] for each in those])

    def kernel(self, length: float, noise: float) -> Kernel:
        own = torch.cat([torch.ones(len(self.points)), torch.zeros(1)]).double().diag()
        return Kernel(length, noise, torch.linalg.inv(bordered(1 / (1 + self.distances / length)) + noise * own))


@dataclass(frozen=True, eq=False)
class Kernels:
    """G kernels of the same endings, asked together."""

    each: Sequence[Kernel]
    lengths: Float[Tensor, "G 1"]
    noises: Float[Tensor, " G"]
    inverses: Float[Tensor, "G M M"]

    @classmethod
    def of(cls, each: Sequence[Kernel]) -> Self:
        lengths, noises = (torch.tensor([getattr(one, name) for one in each]).double() for name in ("length", "noise"))
        return cls(each, lengths[:, None], noises, torch.stack([one.inverse for one in each]))


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
    """What G kernels make of a view."""

    means: Float[Tensor, "G V"]
    deviations: Float[Tensor, "G V"]
    """How far each may be off (`Prediction.deviation`)."""
    residuals: Float[Tensor, " G"]
    """How badly each ending is predicted by all others: the sum of the logarithms of the mean squared leave-one-out residuals."""


def krige(views: Sequence[View], values: Float[Tensor, "N V"]) -> Prediction:
    """The values that go with the wanted features: what all kernels make of all views, each weighed by how well it predicts the N endings.

    Of a single ending nothing can be said but itself. Of more than MAX_FIT_POINTS so many choose kernels and views, by which all are asked.
    """
    if len(values) == 1:
        return Prediction(values[0], torch.full_like(values[0], torch.inf))
    few = values[some_of(len(values))]
    tried = [fits(wanted, endings.few, few) for wanted, endings in views]
    if len(few) < len(values):
        counts = (counts_of(tried, len(few)) > LEAST_COUNT).split([len(each.residuals) for each in tried])
        those = [(wanted, endings, which) for (wanted, endings), which in zip(views, counts, strict=True) if which.any()]
        tried = [fits(wanted, endings, values, kernels=endings.chosen(which)) for wanted, endings, which in those]
    predicted = mixture(tried, len(values))
    return Prediction(predicted.mean.to(values), predicted.deviation.to(values))


def mixture(tried: Sequence[Fits], num_endings: int) -> Prediction:
    """Mean and deviation of all predictions together."""
    weights = counts_of(tried, num_endings)[:, None]
    means, deviations = (torch.cat([getattr(each, name) for each in tried]) for name in ("means", "deviations"))
    mean = (weights * means).sum(0)
    return Prediction(mean, (weights * (deviations.square() + (means - mean).square())).sum(0).sqrt())


def counts_of(tried: Sequence[Fits], num_endings: int) -> Float[Tensor, " _"]:
    """How much each kernel of each view counts, of 1: as likely as the endings are by it, the others known. That is pseudo Bayesian model
    averaging (Yao, Vehtari, Simpson and Gelman 2018), tempered."""
    residuals = torch.cat([each.residuals for each in tried])
    return (-num_endings / IN_COMMON * residuals / 2).softmax(0)


def some_of(number: int) -> Int[Tensor, " few"]:
    """MAX_FIT_POINTS rows of so many, evenly drawn; all where there are no more."""
    return torch.linspace(0, number - 1, min(number, MAX_FIT_POINTS)).round().long()


def fits(wanted: Float[Tensor, " F"], endings: Endings, values: Float[Tensor, "N V"], *, kernels: Kernels | None = None) -> Fits:
    """What each kernel makes of a view, in double precision."""
    kernels = kernels or endings.kernels
    asked, known = (each.double().cpu() for each in (wanted[None], values))
    ways = torch.cdist(asked, endings.points).square()  # (1, N)
    towards = torch.cat([1 / (1 + ways / kernels.lengths), ways.new_ones(len(kernels.noises), 1)], 1)
    weights = kernels.inverses @ torch.cat([known, known.new_zeros(1, known.shape[1])])  # of the endings, and the mean
    variances = 1 / kernels.inverses.diagonal(dim1=1, dim2=2)[:, :-1, None]  # of each ending, the others known
    left_out = variances * weights[:, :-1]
    variance = 1 + kernels.noises - torch.einsum("gm,gmn,gn->g", towards, kernels.inverses, towards)
    deviations = (variance[:, None] * (left_out.square() / variances).mean(1)).clamp(min=0).sqrt()
    residuals = left_out.square().mean(1).clamp(min=1e-12).log().sum(1)
    return Fits(torch.einsum("gm,gmv->gv", towards, weights), deviations, residuals)


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
