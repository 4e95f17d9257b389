"""Parts of a goal's picture that nothing accounts for: a thing that was never there, a hand as no hand ever looked.

A network imagines an arm a little blurred and a little beside itself, so that pixel by pixel its edges differ more than a small thing does
that it does not imagine at all. So each place of a picture is looked for in other pictures, a little to all sides, and what is left of it,
where it is found best, is measured by the contrasts that the place has of its own: of an arm that is out of place little is left then, of a
thing that is missing most of it, unless it is very faint. And where nothing is imagined, far from all that is, nothing should be seen.

>>> table, thing = torch.zeros(2, 1, 32, 32)
>>> thing[0, 14:17, 14:17] = 0.8
>>> round(float(unseen_part(thing, thing.roll(2, dims=2)[None])), 2), float(unseen_part(thing, table[None])) > 0.7
(0.0, True)
>>> float(thing_in_the_open(thing, table, table)) > 0.1, float(thing_in_the_open(thing, thing.roll(2, dims=2), table))
(True, 0.0)
"""

import torch
from jaxtyping import Float
from torch import Tensor

ROWS = 32
"""Pictures are looked at in so many rows, or a few more: each of their pixels costs all shifts and all other pictures."""
PLACE = 1 / 4
"""Side of a place, in heights of a frame: a hand with its surroundings."""
BESIDE = 1 / 8
"""How far aside a place is looked for, in heights of a frame: as far as there is from one demonstrated hand to the next."""
FAINT = 0.02
"""Squared contrast (half ranges, squared) of a place in which little is to be seen: a seventh of half the range."""
THERE = 0.1
"""Where a picture differs by more than this from the background (half ranges), something is there."""
SMALL = 1 / 16
"""Side of the smallest thing that is looked for, in heights of a frame."""


def unseen_part(picture: Float[Tensor, "C H W"], others: Float[Tensor, "N C H W"]) -> Float[Tensor, ""]:
    """The most of what is to be seen at any place of a picture that none of the others shows there or nearby; about 0 to 1, or more."""
    height, width = picture.shape[1:]
    aside, side = max(1, round(BESIDE * height)), max(2, round(PLACE * height))
    framed = torch.nn.functional.pad(others, (aside,) * 4, mode="replicate")
    shifts = [framed[..., row : row + height, column : column + width] for row in range(2 * aside + 1) for column in range(2 * aside + 1)]
    left = torch.stack([means_over_places((shifted - picture).square().mean(1), side).amin(0) for shifted in shifts]).amin(0)
    contrast = (means_over_places(picture.square(), side) - means_over_places(picture, side).square()).mean(0)
    return (left / (contrast + FAINT)).max()


def thing_in_the_open(
    picture: Float[Tensor, "C H W"], imagined: Float[Tensor, "C H W"], background: Float[Tensor, "C H W"]
) -> Float[Tensor, ""]:
    """The largest mean squared difference from the background of a small place that is far from all that is imagined."""
    side, aside = max(1, round(SMALL * picture.shape[1])), max(1, round(BESIDE * picture.shape[1]))
    there = ((imagined - background).abs().amax(0) > THERE).to(picture)
    covered = torch.nn.functional.max_pool2d(there[None], 2 * aside + 1, 1, aside)[0]
    return torch.nn.functional.avg_pool2d(((picture - background).square().mean(0) * (1 - covered))[None], side, 1).max()


def means_over_places(pictures: Float[Tensor, "N H W"], side: int) -> Float[Tensor, "N h w"]:
    """The mean of each place, which overlap by three quarters."""
    return torch.nn.functional.avg_pool2d(pictures[:, None], side, max(1, side // 4))[:, 0]


def in_few_rows(pictures: Float[Tensor, "*batch C H W"]) -> Float[Tensor, "*batch C h w"]:
    """Pictures in ROWS rows or a few more, in single precision."""
    return torch.nn.functional.avg_pool2d(pictures.float(), max(1, pictures.shape[-2] // ROWS))
