"""Laws of what is seen on the way: at the goal by how much an encoder is off, and before it what was moved on the table."""

import pytest
import torch

from bars import bar, problem_to
from preimage.ideas.last_look import LastLook
from preimage.ideas.memory import DemonstrationMemory
from preimage.ideas.moved_things import MovedThings, shifted
from preimage.network.pdvmrnn import PDVMRNN


def test_at_the_goal_nothing_is_to_be_made_up_for(memory: DemonstrationMemory, trained: PDVMRNN) -> None:
    problem = problem_to(trained, bar(0.7))
    look = LastLook(memory)
    assert look(problem, problem.goal[0]).abs().max() < 1e-6
    short = problem_to(trained, bar(0.5)).goal[0]
    missing = look(problem, short)
    assert missing[0] > 0.05
    assert missing[1] < -0.025


def things(*, at: int) -> torch.Tensor:
    """A grey table with a dark thing on it."""
    picture = torch.zeros(1, 32, 32)
    picture[0, 10:13, at : at + 3] = -0.8
    return picture


@pytest.fixture
def scene() -> MovedThings:
    memory = object.__new__(DemonstrationMemory)
    object.__setattr__(memory, "first_background", torch.zeros(1, 32, 32))
    return MovedThings(memory)


def test_a_thing_that_was_moved_is_found_where_it_stands(scene: MovedThings) -> None:
    hand = torch.zeros(1, 32, 32)
    hand[0, 20:30, 5:9] = 0.9
    wrong = hand.roll(1, dims=2)  # the hand is never quite where it is imagined
    seen = scene(things(at=8), (things(at=10) + hand)[None], (things(at=8) + wrong)[None])
    assert seen is not None
    torch.testing.assert_close(seen, things(at=10), atol=1e-4, rtol=0)


@pytest.mark.parametrize("what", ["nothing", "a hand", "covered"])
def test_where_nothing_was_moved_nothing_is_found(scene: MovedThings, what: str) -> None:
    start = things(at=8)
    hand = torch.zeros(1, 32, 32)
    hand[0, 5:25, 4:20] = 1.8 if what == "covered" else 0.0
    imagined, sensed = start + hand, (things(at=10) if what == "covered" else start) + hand
    if what == "a hand":
        sensed[0, 6:20, 14:18] = 0.9
    assert scene(start, sensed[None], imagined[None]) is None


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
