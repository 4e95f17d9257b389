"""The intention: what a sequence is generated from, and what learning and planning look for.

An `IntentionState` is what is added to the shared initial states of the chosen layers. Two tables hold one intention per training
sequence, learned with the weights:

* `FreeTable`, the paper's: every value of the chosen initial states is a number of its own.
* `LatentTable`, the paper's outlook (section IV, variational Bayes): an intention is a few Gaussian numbers per sequence, each with a
  mean and a deviation of its own, projected linearly onto the chosen initial states. The information in a number
  is charged by its divergence from a standard normal, so that the intention holds what cannot be seen at the start, and no more.

Planning searches in an `IntentionSpace`: coordinates of about unit variance over the training intentions.

>>> import torch
>>> table = LatentTable({"top": (2, 4, 4)}, num_sequences=3, dimensions=2, generator=torch.Generator().manual_seed(0))
>>> drawn, charge = table.draw(torch.tensor([0, 2]), torch.Generator().manual_seed(0))
>>> drawn.layers["top"].shape, charge.shape
(torch.Size([2, 2, 2, 4, 4]), torch.Size([2]))
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

Shapes = Mapping[str, tuple[int, ...]]
"""Shape of each chosen layer's hidden state, without the batch."""


@dataclass(frozen=True, eq=False)
class IntentionState:
    """Intentions of B sequences: per chosen layer what is added to its shared initial state, (B, 2, *layer), h first, then c."""

    layers: Mapping[str, Tensor]

    def __len__(self) -> int:
        return len(next(iter(self.layers.values())))

    def __getitem__(self, rows: Tensor) -> "IntentionState":
        return IntentionState({name: values[rows] for name, values in self.layers.items()})

    def flatten(self) -> Float[Tensor, "B D"]:
        """One row a sequence, the layers side by side."""
        return torch.cat([values.flatten(1) for values in self.layers.values()], dim=1)


def unflatten(rows: Float[Tensor, "B D"], shapes: Shapes) -> IntentionState:
    """The intentions whose `flatten` these rows are."""
    sizes = [2 * torch.Size(shape).numel() for shape in shapes.values()]
    parts = zip(shapes.items(), rows.split(sizes, dim=1), strict=True)
    return IntentionState({name: part.unflatten(1, (2, *shape)) for (name, shape), part in parts})


@dataclass(frozen=True, eq=False)
class IntentionSpace:
    """Where planning searches: the training intentions as coordinates, and the way from coordinates to an intention."""

    training: Float[Tensor, "N K"]
    """Coordinates of the training intentions."""
    intention: Callable[[Float[Tensor, "B K"]], IntentionState]

    def coordinates_of(self, intentions: Float[Tensor, "B D"]) -> Float[Tensor, "B K"]:
        """The points from which intentions come (`IntentionState.flatten`), or the nearest to them."""
        count = self.training.shape[1]
        corners = torch.cat([torch.zeros(1, count), torch.eye(count)]).to(self.training)
        flat = self.intention(corners).flatten().double()
        return torch.linalg.lstsq((flat[1:] - flat[0]).T, (intentions.to(flat) - flat[0]).T).solution.T.to(self.training)


class FreeTable(nn.Module):
    """One free intention per training sequence, the paper's.

    While training, noise is added that is distributed as the intentions themselves are: what lies between them is learned as well, and
    directions in which they do not differ stay free of it.

    Args:
        noise: standard deviation of the noise, in those of the training intentions.
    """

    def __init__(self, shapes: Shapes, *, num_sequences: int, noise: float, generator: torch.Generator) -> None:
        super().__init__()
        self.shapes, self.noise = dict(shapes), noise
        size = sum(2 * torch.Size(shape).numel() for shape in shapes.values())
        self.rows = nn.Parameter(0.1 * torch.randn(num_sequences, size, generator=generator))

    def __len__(self) -> int:
        return len(self.rows)

    def intentions(self) -> IntentionState:
        """Those of all training sequences."""
        return unflatten(self.rows, self.shapes)

    def prior_mean(self, num_sequences: int) -> IntentionState:
        """The intention that adds nothing to the shared initial states."""
        return unflatten(self.rows.new_zeros(num_sequences, self.rows.shape[1]), self.shapes)

    def draw(self, rows: Tensor, generator: torch.Generator) -> tuple[IntentionState, Float[Tensor, " B"]]:
        """Intentions of some training sequences as training uses them, and the charge for each."""
        chosen = self.rows[rows]
        drawn = torch.randn(len(rows), len(self.rows), generator=generator).to(chosen)
        spread = (self.rows - self.rows.mean(0)).detach()
        noise = self.noise / max(1, len(self.rows) - 1) ** 0.5 * drawn @ spread
        return unflatten(chosen + noise, self.shapes), chosen.square().sum(1)

    @torch.no_grad()
    def start_from(self, scores: Float[Tensor, "N K"], generator: torch.Generator) -> None:
        """Alike sequences become neighbours: their scores, projected onto the layers at random."""
        self.rows.copy_(scores @ projection(scores.shape[1], self.rows.shape[1], generator))

    def space(self, dimensions: int | None) -> IntentionSpace:
        """The directions in which the training intentions differ most, in standard deviations; None: all in which they differ."""
        return space_of(self.rows.detach(), dimensions, lambda rows: unflatten(rows, self.shapes))


class LatentTable(nn.Module):
    """A few Gaussian numbers per training sequence, projected linearly onto the initial states of the chosen layers.

    Args:
        dimensions: how many numbers.
        deviation: standard deviation of each at the start of training.
    """

    def __init__(self, shapes: Shapes, *, num_sequences: int, dimensions: int, generator: torch.Generator, deviation: float = 0.1) -> None:
        super().__init__()
        self.shapes = dict(shapes)
        size = sum(2 * torch.Size(shape).numel() for shape in shapes.values())
        self.mean = nn.Parameter(0.5 * torch.randn(num_sequences, dimensions, generator=generator))
        self.log_deviation = nn.Parameter(torch.full((num_sequences, dimensions), deviation).log())
        self.onto_states = nn.Parameter(projection(dimensions, size, generator))

    def __len__(self) -> int:
        return len(self.mean)

    def intentions(self) -> IntentionState:
        """Those of all training sequences, at their means."""
        return self._onto(self.mean)

    def prior_mean(self, num_sequences: int) -> IntentionState:
        """The intention that adds nothing to the shared initial states."""
        return self._onto(self.mean.new_zeros(num_sequences, self.mean.shape[1]))

    def draw(self, rows: Tensor, generator: torch.Generator) -> tuple[IntentionState, Float[Tensor, " B"]]:
        """Samples of some training sequences' intentions, and what each tells: KL from the standard normal (nats)."""
        mean, log_deviation = self.mean[rows], self.log_deviation[rows]
        noise = torch.randn(mean.shape, generator=generator).to(mean)
        divergence = 0.5 * (mean.square() + (2 * log_deviation).exp() - 1) - log_deviation
        return self._onto(mean + log_deviation.exp() * noise), divergence.sum(1)

    @torch.no_grad()
    def start_from(self, scores: Float[Tensor, "N K"], generator: torch.Generator) -> None:
        """Alike sequences become neighbours: their scores are the first means."""
        kept = min(scores.shape[1], self.mean.shape[1])
        self.mean[:, :kept] = scores[:, :kept]

    def space(self, dimensions: int | None) -> IntentionSpace:
        """The directions in which the training intentions differ most, in standard deviations; None: all in which they differ."""
        return space_of(self.mean.detach(), dimensions, lambda numbers: unflatten(numbers @ self.onto_states.detach(), self.shapes))

    def _onto(self, numbers: Float[Tensor, "B K"]) -> IntentionState:
        return unflatten(numbers @ self.onto_states, self.shapes)


IntentionTable = FreeTable | LatentTable


def space_of(
    rows: Float[Tensor, "N D"], dimensions: int | None, intention_of: Callable[[Float[Tensor, "B D"]], IntentionState]
) -> IntentionSpace:
    """The space whose coordinates are principal components of the rows, each of unit variance over them; None: all of them.

    Of a single row, which spans no space of its own, it is the values as they are.
    """
    if len(rows) < 2:
        return IntentionSpace(rows, intention_of)
    mean = rows.mean(0)
    left, sizes, directions = torch.linalg.svd(rows - mean, full_matrices=False)
    kept, freedom = min(dimensions or len(rows), len(rows) - 1, rows.shape[1]), (len(rows) - 1) ** 0.5
    scaled = sizes[:kept, None] / freedom * directions[:kept]  # (K, D)
    return IntentionSpace(left[:, :kept] * freedom, lambda coordinates: intention_of(mean + coordinates @ scaled))


def projection(dimensions: int, size: int, generator: torch.Generator, deviation: float = 0.5) -> Float[Tensor, "K D"]:
    """A random linear map under which unit scores become values of about this deviation."""
    return torch.randn(dimensions, size, generator=generator) * deviation / dimensions**0.5
