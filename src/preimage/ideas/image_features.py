"""Pictures seen coarsely: through a wide Gaussian, and thinned out, for what is left of neighbouring pixels is alike.

Two pictures of a small thing in two places differ by the same amount wherever the places are, once it does not overlap. Seen coarsely they
differ the more the further apart the places, which is what learning and planning need to know where to go.

>>> dots = torch.zeros(3, 1, 32, 32)
>>> dots[0, 0, 16, 8] = dots[1, 0, 16, 12] = dots[2, 0, 16, 16] = 1.0
>>> near, far = (blurred(dots[0] - other, 0.2).square().sum() for other in dots[1:])
>>> bool(far > 2 * near)
True
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

BLUR = 0.125
"""The usual deviation of the Gaussian, in heights of a frame: 8 pixels of 64, about as wide as the arm."""
WIDE = 0.15
"""The same where pictures are compared to tell where something stands."""
CHANGED = 0.1
"""A pixel that changed by as much, in half ranges, counts in full."""


def blurred(pictures: Float[Tensor, "*batch C H W"], blur: float) -> Float[Tensor, "*batch C h w"]:
    """Pictures, or differences of pictures, through a Gaussian whose deviation is `blur` heights of a frame; 0: as they are.

    What is smooth keeps its sum of squares: thinning out is made up for.
    """
    if blur == 0:
        return pictures
    height, width = pictures.shape[-2:]
    deviation = blur * height
    rows, columns = (smoothing(size, deviation, pictures.device).to(pictures) for size in (height, width))
    return rows @ pictures @ columns.T


def arrived(
    before: Float[Tensor, "*#batch C H W"], after: Float[Tensor, "*batch C H W"], background: Float[Tensor, "C H W"]
) -> Float[Tensor, "*batch D h w"]:
    """What has come to stand in a picture, coarsely seen: where it changed, how much brighter or darker it is than the background.

    Whatever lay about and stayed does not count, nor does the place that something has left. What is brighter and what is darker are told
    apart, D being 2 C: seen coarsely, one would make up for the other.
    """
    changed = ((after - before).abs().amax(-3, keepdim=True) / CHANGED).clamp(max=1)
    return apart(changed * (after - background))


def apart(difference: Float[Tensor, "*batch C H W"]) -> Float[Tensor, "*batch D h w"]:
    """What is brighter and what is darker, D = 2 C, coarsely seen."""
    return blurred(torch.cat([difference.clamp(min=0), difference.clamp(max=0)], dim=-3), WIDE)


def smoothing(size: int, deviation: float, device: torch.device) -> Float[Tensor, "kept size"]:
    """The matrix that smooths a row of pixels and keeps one of as many as the largest power of two below the deviation (pixels)."""
    step = 2 ** max(0, int(math.log2(deviation)))
    kept = torch.arange(0, size, step, device=device) + step / 2
    distance = (torch.arange(size, device=device) + 0.5 - kept[:, None]) / deviation
    return torch.exp(-distance.square() / 2) * step**0.5 / (deviation * math.tau**0.5)
