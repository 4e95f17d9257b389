"""Pictures moved by a part of a pixel or a few: how a thing looks that lies a little elsewhere, or a camera that was touched.

A network that has seen a hundred first frames knows each of them to a pixel and not what lies between. Moved a little, anew each time, they
teach it to look where things lie beside one another.

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
    here = torch.eye(2, 3).to(by).expand(len(by), 2, 3)
    moved = torch.cat([here[..., :2], -2 * (by / by.new_tensor([width, height]))[..., None]], dim=-1)
    places = nn.functional.affine_grid(moved, list(pictures.shape), align_corners=False)
    return nn.functional.grid_sample(pictures, places, padding_mode="border", align_corners=False)


def draw_shifts(count: int, largest: float, generator: torch.Generator) -> Float[Tensor, "B 2"]:
    """So many shifts, each direction evenly between minus and plus the largest (pixels)."""
    return largest * (2 * torch.rand(count, 2, generator=generator) - 1)


def glances(picture: Float[Tensor, "C H W"], by: float) -> Float[Tensor, "looks C H W"]:
    """A picture as it is, first, and, unless `by` is 0, moved to its eight sides by so many heights of it."""
    if by == 0:
        return picture[None]
    sides = sorted(itertools.product((-1.0, 0.0, 1.0), repeat=2), key=any)  # to no side first
    return shifted(picture.expand(len(sides), *picture.shape), by * picture.shape[1] * picture.new_tensor(sides))
