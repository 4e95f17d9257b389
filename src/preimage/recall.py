"""Memory of endings: what goes with the picture of a goal, judged from how sequences end that are known to the end.

The picture of a goal between those of some demonstrations is, seen coarsely, nearly a blend of theirs, and what goes with it, the joints
or an intention, nearly the same blend of what goes with them. Kriging finds the blend: a Gaussian process whose kernel, the rational
quadratic, falls off slowly, with a constant mean. Its scale and noise are those under which each ending is told best by all others, and
how well it is told so says how far to trust what is recalled (leave one out; Rasmussen and Williams 2006, chapter 5).

>>> features, values = torch.arange(6.0)[:, None], 10 * torch.arange(6.0)[:, None]
>>> recalled = recall(torch.tensor([2.5]), features, values)
>>> round(recalled.mean.item()), bool(recalled.deviation < 5)
(25, True)
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

SCALES = (1.0, 3.0, 10.0, 30.0)
"""Squared lengths of the kernel that are tried, in median squared distances of the endings."""
NOISES = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
"""Variances of the noise that are tried, beside the kernel's 1."""


@dataclass(frozen=True, eq=False)
class Recalled:
    """What goes with a goal."""

    mean: Float[Tensor, " V"]
    deviation: Float[Tensor, " V"]
    """How far it may be off: as much as where one ending is recalled from all others, and more the further away those are that tell it."""


def recall(wanted: Float[Tensor, " F"], features: Float[Tensor, "N F"], values: Float[Tensor, "N V"]) -> Recalled:
    """The values that go with the wanted features, blended from those of N endings; of a single one nothing can be told but itself."""
    count = len(features)
    if count == 1:
        return Recalled(values[0], torch.full_like(values[0], torch.inf))
    points, targets = features.double(), torch.cat([values, values.new_zeros(1, values.shape[1])]).double()
    distances = torch.cdist(points, points).square()
    asked = torch.cdist(wanted[None].double(), points).square()
    distances, asked, targets = (each.cpu() for each in (distances, asked, targets))  # matrices too small for a GPU
    unit = distances[distances > 0].median() if bool((distances > 0).any()) else distances.new_ones(())
    tried: list[tuple[float, Recalled]] = []
    for scale in SCALES:
        kernel, towards = (1 / (1 + each / (scale * unit)) for each in (distances, asked))
        for noise in NOISES:
            inverse = torch.linalg.inv(bordered(kernel + noise * torch.eye(count).to(kernel)))
            weights = inverse @ targets  # of the endings, and the mean
            variances = 1 / inverse.diagonal()[:count, None]  # of each ending, the others known
            off = variances * weights[:count]
            towards_all = torch.cat([towards, torch.ones_like(towards[:, :1])], 1)
            variance = 1 + noise - towards_all @ inverse @ towards_all.T
            mean = (towards_all @ weights)[0]
            deviation = (variance[0] * (off.square() / variances).mean(0)).clamp(min=0).sqrt()
            tried.append((float(off.square().mean(0).clamp(min=1e-24).log().sum()), Recalled(mean.to(values), deviation.to(values))))
    return min(tried, key=lambda one: one[0])[1]


def bordered(kernel: Float[Tensor, "N N"]) -> Float[Tensor, "M M"]:
    """The kernel with a row and a column of ones: what the weights have to sum to zero for, so that the mean is free."""
    border = kernel.new_ones(len(kernel), 1)
    return torch.cat([torch.cat([kernel, border], 1), torch.cat([border.T, kernel.new_zeros(1, 1)], 1)])
