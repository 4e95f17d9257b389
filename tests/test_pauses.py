"""Laws of pauses: what counts is the slowest moment between setting out and coming to rest."""

import pytest
import torch

from preimage.ideas.pauses import slowest_steps

REST = [0.0, 0.0, 0.0]


def way(changes: list[float]) -> torch.Tensor:
    """One demonstration of one joint that moves by these from step to step."""
    return torch.tensor([0.0, *changes]).cumsum(0)[None, :, None]


@pytest.mark.parametrize(
    ("changes", "slowest"),
    [
        ([1.0, 0.1, 0.1, 1.0], 2),
        ([*REST, 1.0, 0.1, 0.1, 1.0, *REST], 5),
        ([0.05, 1.0, 0.5, 0.4, 1.0, 0.05], 3),
        ([1.0, 0.2, 0.2, -1.0], 2),
    ],
)
def test_rest_at_either_end_is_no_pause(changes: list[float], slowest: int) -> None:
    assert slowest_steps(way(changes)).tolist() == [slowest]


def test_padding_changes_nothing() -> None:
    short, long = way([1.0, 0.1, 0.1, 1.0, *REST]), way([1.0, 1.0, 1.0, 1.0, 0.1, 0.1, 1.0])
    assert slowest_steps(torch.cat([short, long])).tolist() == [slowest_steps(short).item(), slowest_steps(long).item()] == [2, 5]


@pytest.mark.parametrize("changes", [[1.0], REST])
def test_a_way_too_short_or_without_motion_has_its_first_step(changes: list[float]) -> None:
    assert slowest_steps(way(changes)).tolist() == [0]
