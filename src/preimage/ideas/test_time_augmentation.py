"""Pictures moved by a part of a pixel or a few, to be looked at again.

What a network makes of a picture that it never saw is a little off, and off otherwise where the picture lies a little elsewhere. Moved to
all sides alike, what is told of it differs by as much to one side as to the other, so that the mean of all looks is nearer than one.

>>> dot = torch.zeros(1, 1, 4, 4)
>>> dot[0, 0, 1, 1] = 1.0
>>> shifted(dot, torch.tensor([[0.5, 1.0]]))[0, 0].tolist()  # half a pixel to the right, one down
[[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0], [0.0, 0.5, 0.5, 0.0], [0.0, 0.0, 0.0, 0.0]]
"""

import itertools

import torch
from jaxtyping import Float
from torch import Tensor, nn


def shifted(pictures: Float[Tensor, "B C H W"], by: Float[Tensor, "B 2"]) -> Float[Tensor, "B C H W"]:
    """Each picture moved to the right and down by so many pixels, between pixels linearly; at the edges it goes on as it ends.

    Args:
        by: pixels to the right and down.
    """
    height, width = pictures.shape[-2:]
    here = torch.eye(2, device=by.device, dtype=by.dtype).expand(len(by), 2, 2)
    moved = torch.cat([here, -2 * torch.stack([by[:, 0] / width, by[:, 1] / height], dim=-1)[..., None]], dim=-1)
    places = nn.functional.affine_grid(moved, list(pictures.shape), align_corners=False)
    return nn.functional.grid_sample(pictures, places, padding_mode="border", align_corners=False)


def glances(picture: Float[Tensor, "C H W"], by: float) -> Float[Tensor, "looks C H W"]:
    """A picture as it is, first, and, unless `by` is 0, moved to its eight sides by so many heights of it."""
    if by == 0:
        return picture[None]
    sides = sorted(itertools.product((-1.0, 0.0, 1.0), repeat=2), key=any)  # to no side first
    return shifted(picture.expand(len(sides), *picture.shape), by * picture.shape[1] * picture.new_tensor(sides))
