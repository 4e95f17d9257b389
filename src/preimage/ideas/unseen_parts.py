"""Parts of a goal's picture that nothing accounts for: a thing that was never there, a hand as no hand ever looked.

A network imagines an arm a little blurred and a little beside itself, so that pixel by pixel its edges differ more than a small thing does
that it does not imagine at all. So each place of a picture is looked for in other pictures, a little to all sides, and what is left of it,
where it is found best, is measured by the contrasts that the place has of its own: of an arm that is out of place little is left then, of a
thing that is missing most of it, unless it is very faint. And what stands apart from all that is imagined should not be there.

>>> table, thing = torch.zeros(2, 1, 32, 32)
>>> thing[0, 14:17, 14:17] = 0.8
>>> round(float(unseen_part(thing, thing.roll(2, dims=2)[None])), 2), float(unseen_part(thing, table[None])) > 0.7
(0.0, True)
>>> float(unimagined_thing(thing, table, table[None])) > 0, float(unimagined_thing(thing, thing.roll(2, dims=2), table[None]))
(True, 0.0)
"""

import torch
from jaxtyping import Bool, Float, Int
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
FINE_ROWS = 64
"""Things are looked for in more rows: between an arm and what lies beside it there may be a pixel."""


def unseen_part(picture: Float[Tensor, "C H W"], others: Float[Tensor, "N C H W"]) -> Float[Tensor, ""]:
    """The most of what is to be seen at any place of a picture that none of the others shows there or nearby; about 0 to 1, or more."""
    height, width = picture.shape[1:]
    aside, side = max(1, round(BESIDE * height)), max(2, round(PLACE * height))
    framed = torch.nn.functional.pad(others, (aside,) * 4, mode="replicate")
    shifts = [framed[..., row : row + height, column : column + width] for row in range(2 * aside + 1) for column in range(2 * aside + 1)]
    left = torch.stack([means_over_places((shifted - picture).square().mean(1), side).amin(0) for shifted in shifts]).amin(0)
    contrast = (means_over_places(picture.square(), side) - means_over_places(picture, side).square()).mean(0)
    return (left / (contrast + FAINT)).max()


def unimagined_thing(
    picture: Float[Tensor, "C H W"], imagined: Float[Tensor, "C H W"], before: Float[Tensor, "N C H W"]
) -> Float[Tensor, ""]:
    """The mean square over the picture (half ranges, squared) of the most striking thing that is not imagined.

    A thing is what hangs together of all that differs from every picture from before. It is imagined where at least half of its pixels are
    among those at which the imagined picture differs likewise, or beside them: an arm in its place, a little aside, or as a blur.

    Args:
        before: of the table with nothing on it, and of how it was at the start.
    """
    there, expected = ((each - before).abs().amax(1).amin(0) for each in (picture, imagined))
    covered = torch.nn.functional.max_pool2d((expected > THERE).to(there)[None], 3, 1, 1).flatten()
    things = hanging_together(there > THERE).flatten()
    of_each = (torch.ones_like(covered), covered, there.flatten().square())
    pixels, imagined_pixels, squares = (torch.bincount(things, each, minlength=len(things) + 1)[1:] for each in of_each)
    return torch.where(imagined_pixels < pixels / 2, squares, 0).max() / len(things)


def hanging_together(there: Bool[Tensor, "H W"]) -> Int[Tensor, "H W"]:
    """A number for each group of pixels that touch, at a side or a corner; 0 where nothing is there."""
    numbers = torch.arange(1.0, there.numel() + 1, dtype=torch.float64, device=there.device).reshape(there.shape) * there
    while not torch.equal(numbers, largest := torch.nn.functional.max_pool2d(numbers[None], 3, 1, 1)[0] * there):
        numbers = largest
    return numbers.long()


def means_over_places(pictures: Float[Tensor, "*batch H W"], side: int) -> Float[Tensor, "*batch h w"]:
    """The mean of each place, which overlap by three quarters; two small products take half the time of a pooling."""
    rows, columns = (torch.eye(size).to(pictures).unfold(0, side, max(1, side // 4)).mean(-1) for size in pictures.shape[-2:])
    return rows @ pictures @ columns.T


def in_few_rows(pictures: Float[Tensor, "*batch C H W"], rows: int = ROWS) -> Float[Tensor, "*batch C h w"]:
    """Pictures in so many rows or a few more, in single precision."""
    return torch.nn.functional.avg_pool2d(pictures.float(), max(1, pictures.shape[-2] // rows))
