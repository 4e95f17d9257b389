"""Laws of parts that another picture does not show: nothing of a picture is missing in itself, beside itself, or where it is repeated."""

import pytest
import torch

from preimage.ideas.unseen_parts import BESIDE, in_few_rows, unseen_part

SIZE = 64
WITHIN = round(BESIDE * SIZE)


def scene(*, thing: float = 0.0, hand: float = 0.9, at: int = 30) -> torch.Tensor:
    """A table on which a hand stands, and a thing of some contrast."""
    picture = torch.full((1, SIZE, SIZE), -0.1)
    picture[0, 10:34, 12:18] += hand
    picture[0, 44:49, at : at + 4] += thing
    return picture


def missing(picture: torch.Tensor, other: torch.Tensor) -> float:
    """How much of a picture's places another does not show."""
    return float(unseen_part(picture, other[None]))


@pytest.mark.parametrize("aside", [0, 1, WITHIN])
def test_what_stands_nearby_is_seen(aside: int) -> None:
    assert missing(scene(thing=0.8), scene(thing=0.8).roll(aside, dims=2)) < 1e-6


def test_what_stands_further_away_is_not() -> None:
    near, far = (missing(scene(thing=0.8), scene(thing=0.8, at=30 + aside)) for aside in (WITHIN, 2 * WITHIN))
    assert near < 0.5 * far


def test_a_thing_that_is_not_there_is_missing_the_more_the_less_faint_it_is() -> None:
    nothing, faint, dark, bright = (missing(scene(thing=contrast), scene()) for contrast in (0.0, 0.3, -0.8, 0.8))
    assert nothing < 1e-6
    assert 0.2 < faint < min(dark, bright)


def test_a_thing_is_stranger_than_edges_that_are_blurred() -> None:
    blurred = torch.nn.functional.avg_pool2d(scene(), 3, 1, padding=1, count_include_pad=False)
    assert missing(scene(), blurred) < 0.5 * missing(scene(thing=0.4), scene())
    assert (scene() - blurred).abs().max() > 0.4, "pixel by pixel the edges differ more than the thing"


def test_a_large_picture_says_what_a_small_one_does() -> None:
    large = [torch.nn.functional.interpolate(each[None], scale_factor=4.0)[0] for each in (scene(thing=0.4), scene())]
    small = [in_few_rows(each) for each in (scene(thing=0.4), scene())]
    assert missing(*(in_few_rows(each) for each in large)) == pytest.approx(missing(*small), rel=1e-4)
