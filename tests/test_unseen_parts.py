"""Laws of parts that another picture does not show: nothing of a picture is missing in itself, beside itself, or where it is repeated."""

import pytest
import torch

from preimage.ideas.unseen_parts import BESIDE, hanging_together, in_few_rows, unimagined_thing, unseen_part

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


def unimagined(picture: torch.Tensor, imagined: torch.Tensor) -> float:
    """How much is to be seen of a thing that is not imagined, in pixels that differ by half the range; the table was bare before."""
    bare = torch.full((1, SIZE, SIZE), -0.1)
    return float(unimagined_thing(picture, imagined, bare[None])) * SIZE**2


def test_a_thing_beside_the_arm_is_seen_though_the_arm_is_blurred_or_aside() -> None:
    beside, blur = scene(), torch.nn.functional.avg_pool2d(scene(), 5, 1, padding=2, count_include_pad=False)
    beside[0, 20:25, 20:24] -= 0.8  # two pixels from the arm
    for imagined in (scene(), blur, scene().roll(2, dims=2)):
        assert unimagined(scene(), imagined) == 0
        assert unimagined(beside, imagined) == pytest.approx(20 * 0.8**2, rel=1e-4)


def test_a_thing_that_was_there_before_or_is_imagined_is_not_strange() -> None:
    assert unimagined(scene(thing=0.8), scene(thing=0.8)) == unimagined(scene(thing=0.8), scene(thing=0.8).roll(1, dims=2)) == 0
    before = torch.stack([scene(hand=0), scene(hand=0, thing=0.8)])
    assert float(unimagined_thing(scene(thing=0.8), scene(), before)) == 0


def test_of_two_things_the_more_striking_counts() -> None:
    two = scene(thing=0.8)
    two[0, 55:57, 5:7] += 0.5
    assert unimagined(two, scene()) == pytest.approx(20 * 0.8**2, rel=1e-4)


def test_what_touches_at_a_corner_hangs_together() -> None:
    there = torch.tensor([[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=torch.bool)
    numbers = hanging_together(there)
    assert numbers[0, 0] == numbers[1, 1]
    assert len({int(numbers[0, 0]), int(numbers[0, 3]), int(numbers[2, 3]), 0}) == 4
    assert not numbers[~there].any()
