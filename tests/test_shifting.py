"""Laws of shifting: whole pixels move as they are, nothing moves by nothing, and a glance is taken to all eight sides."""

import pytest
import torch

from preimage.ideas.test_time_augmentation import glances, shifted


def pictures(count: int = 1) -> torch.Tensor:
    return torch.rand(count, 2, 6, 8, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize(("right", "down"), [(0, 0), (1, 0), (0, 2), (2, 1), (3, 3)])
def test_a_shift_by_whole_pixels_moves_them_as_they_are(right: int, down: int) -> None:
    one = pictures()
    moved = shifted(one, torch.tensor([[float(right), float(down)]]))
    torch.testing.assert_close(moved[..., down:, right:], one[..., : 6 - down, : 8 - right])
    torch.testing.assert_close(moved[0, :, :down, right:], one[0, :, :1, : 8 - right].expand(-1, down, -1))  # the edge goes on


def test_each_picture_is_moved_by_its_own_shift() -> None:
    two = pictures(2)
    together = shifted(two, torch.tensor([[0.5, -1.0], [-2.0, 0.25]]))
    apart = torch.cat([shifted(two[:1], torch.tensor([[0.5, -1.0]])), shifted(two[1:], torch.tensor([[-2.0, 0.25]]))])
    torch.testing.assert_close(together, apart)


def test_a_glance_sees_the_picture_first_and_then_from_all_eight_sides() -> None:
    one = pictures()[0]
    seen = glances(one, 1 / 6)  # a pixel
    torch.testing.assert_close(seen[0], one)
    inner = {tuple(look[:, 1:-1, 1:-1].flatten().tolist()) for look in seen}
    around = {tuple(one[:, 1 + y : 5 + y, 1 + x : 7 + x].flatten().tolist()) for x in (-1, 0, 1) for y in (-1, 0, 1)}
    assert len(seen) == len(inner) == 9
    torch.testing.assert_close(torch.tensor(sorted(inner)), torch.tensor(sorted(around)))
    assert torch.equal(glances(one, 0), one[None])
