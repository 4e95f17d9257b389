"""What was moved on the table: where things that stood there at the start are seen elsewhere than imagined, the start is taken otherwise.

A hand is never quite where it is imagined, so that an error in the picture says little by itself. But a thing that was moved leaves two
marks of its own shape, one where it stood and one where it stands. So the things that stand in the start picture, the dark and the bright
ones, are moved to all sides in turn, as the error would be if they had been: the shift that explains most of what persists in the error is
taken, where it explains more than it adds.

>>> thing = torch.zeros(1, 9, 9)
>>> thing[0, 2:4, 2:4] = -1.0
>>> found = best_shift(thing.roll(2, dims=2) - thing, thing, torch.ones(9, 9, dtype=torch.bool), reach=3)
>>> found.by.tolist(), round(found.agreement, 3), found.is_believed
([2.0, 0.0], 1.0, True)
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from preimage.ideas.memory import DemonstrationMemory

REACH = 0.08
"""How far a thing may have been moved at once, in heights of a frame."""
AGREEMENT = 0.5, 1.2
"""How much of a shift has to be seen in the error to be believed, at the least and the most: 1 where the error shows just that, 0 where it
shows nothing of it, and more where something else is to be seen there."""
LIKENESS = 0.8
"""How like the change the error has to look in those places (a cosine)."""
STANDS_OUT = 0.2
"""What differs from the usual first picture by less (of 2 from black to white) is no thing."""
COVERED = 0.3
"""Where what is imagined differs from the start picture by more than this, something covers it."""
FAINT = 0.1
"""Where a change is less than this, it is not looked for."""


@dataclass(frozen=True, eq=False)
class Shift:
    """A shift that was found, to the right and down."""

    by: Float[Tensor, " 2"]
    """In pixels."""
    agreement: float
    likeness: float

    @property
    def is_believed(self) -> bool:
        return AGREEMENT[0] <= self.agreement <= AGREEMENT[1] and self.likeness >= LIKENESS


@dataclass(frozen=True, eq=False)
class MovedThings:
    """The start picture as it has to be taken after what was seen."""

    memory: DemonstrationMemory

    @torch.no_grad()
    def __call__(
        self, start: Float[Tensor, "C H W"], sensed: Float[Tensor, "F C H W"], imagined: Float[Tensor, "F C H W"]
    ) -> Float[Tensor, "C H W"] | None:
        """The start picture with a thing moved, or None where none was.

        Args:
            sensed: the last frames that came.
            imagined: what was imagined in their place.
        """
        error = (sensed - imagined).median(0).values
        uncovered = (imagined - start).abs().amax((0, 1)) < COVERED  # (H, W)
        standing = start - self.memory.first_background
        things = [standing.clamp(max=0), standing.clamp(min=0)]
        things = [thing.where(thing.abs() > STANDS_OUT, 0.0) for thing in things]
        reach = round(REACH * start.shape[1])
        found = [(best_shift(error, thing, uncovered, reach=reach), thing) for thing in things]
        shift, thing = max(found, key=lambda each: each[0].is_believed * each[0].likeness)
        if not shift.is_believed:
            return None
        return (start - thing + shifted(thing[None], shift.by[None])[0]).clamp(-1, 1)


def best_shift(error: Float[Tensor, "C H W"], thing: Float[Tensor, "C H W"], uncovered: Bool[Tensor, "H W"], *, reach: int) -> Shift:
    """The shift of a thing that explains most of an error: first by whole pixels, then by halves of them."""
    whole = torch.arange(-reach, reach + 1.0).to(error)
    coarse = torch.cartesian_prod(whole, whole)
    best = best_among(coarse[(coarse != 0).any(1)], error, thing, uncovered)  # less than a pixel is no news
    half = torch.tensor([-0.5, 0.0, 0.5]).to(error)
    return best_among(best.by + torch.cartesian_prod(half, half), error, thing, uncovered)


def best_among(
    shifts: Float[Tensor, "S 2"], error: Float[Tensor, "C H W"], thing: Float[Tensor, "C H W"], uncovered: Bool[Tensor, "H W"]
) -> Shift:
    """Of some shifts the one that explains most."""
    changes = (shifted(thing.expand(len(shifts), *thing.shape), shifts) - thing) * uncovered
    wanted, there = changes.square().sum((1, 2, 3)), (changes * error).sum((1, 2, 3))
    best = int((2 * there - wanted).argmax())
    size = float(wanted[best].clamp(min=1e-9))
    looked_at = error.where(changes[best].abs() > FAINT, 0.0)
    likeness = float(there[best]) / (size**0.5 * float(looked_at.norm().clamp(min=1e-9)))
    return Shift(shifts[best], float(there[best]) / size, likeness)


def shifted(pictures: Float[Tensor, "B C H W"], by: Float[Tensor, "B 2"]) -> Float[Tensor, "B C H W"]:
    """Each picture moved to the right and down by so many pixels, between pixels linearly; at the edges it goes on as it ends.

    Args:
        by: pixels to the right and down.

    >>> dot = torch.zeros(1, 1, 4, 4)
    >>> dot[0, 0, 1, 1] = 1.0
    >>> shifted(dot, torch.tensor([[0.5, 1.0]]))[0, 0].tolist()  # half a pixel to the right, one down
    [[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0], [0.0, 0.5, 0.5, 0.0], [0.0, 0.0, 0.0, 0.0]]
    """
    height, width = pictures.shape[-2:]
    here = torch.eye(2, device=by.device, dtype=by.dtype).expand(len(by), 2, 2)
    moved = torch.cat([here, -2 * torch.stack([by[:, 0] / width, by[:, 1] / height], dim=-1)[..., None]], dim=-1)
    places = nn.functional.affine_grid(moved, list(pictures.shape), align_corners=False)
    return nn.functional.grid_sample(pictures, places, padding_mode="border", align_corners=False)
