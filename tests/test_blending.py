"""Laws of blends: a demonstration by itself stays as it is, a blend is the weighted mean of its parts, and weights sum to one."""

import pytest
import torch

from preimage.data.sequences import Sequences
from preimage.ideas.mixup import Blends, draw_blends
from preimage.network.intention import IntentionState


def sequences() -> Sequences:
    draw = torch.Generator().manual_seed(0)
    frames = torch.randint(50, 200, (4, 6, 8, 8, 1), generator=draw).to(torch.uint8)
    return Sequences(frames, torch.rand(4, 6, 2, generator=draw), torch.tensor([3, 4, 5, 6]), rest_steps=0)


@pytest.mark.parametrize(("share", "num_blends"), [(0.0, 0), (0.5, 2), (0.9, 3)])
def test_a_share_of_the_sequences_are_blends_of_different_demonstrations(share: float, num_blends: int) -> None:
    rows = torch.tensor([3, 1, 0, 2])
    blends = draw_blends(rows, sequences(), torch.Generator().manual_seed(0), share=share)
    assert int(blends.blended.sum()) == num_blends
    assert torch.equal(blends.rows[:, 0], rows)
    assert all(len(set(parts)) == (3 if num_blends else 1) for parts in blends.rows.tolist())
    assert blends.weights.sum(1) == pytest.approx(torch.ones(4).numpy(), abs=1e-6)


@pytest.mark.parametrize(("parts", "reach"), [(3, 1.3), (4, 1.8), (3, 1.0)])
def test_blends_reach_as_far_beyond_their_demonstrations_as_they_should(parts: int, reach: float) -> None:
    rows, draw = torch.zeros(4000, dtype=torch.long), torch.Generator().manual_seed(0)
    weights = draw_blends(rows, sequences(), draw, share=0.999, parts=parts, reach=reach).weights[-3996:]
    assert weights.min().item() == pytest.approx((1 - reach) / parts, abs=0.02)
    assert weights.mean(0) == pytest.approx(torch.full((parts,), 1 / parts).numpy(), abs=0.02)


def test_a_demonstration_by_itself_stays_as_it_is() -> None:
    shown, steps = sequences(), torch.tensor([0, 2])
    alone = Blends(torch.tensor([[0, 1, 2], [3, 2, 1]]), torch.eye(3)[[0, 0]])
    blended, begun = alone.sequences(shown, steps), shown.begun_at(torch.tensor([0, 3]), steps)
    assert torch.equal(blended.frames, begun.frames)
    assert torch.equal(blended.joints, begun.joints)
    assert torch.equal(blended.lengths, begun.lengths)


def test_a_blend_is_the_weighted_mean_of_its_parts() -> None:
    shown, weights = sequences(), torch.tensor([0.5, 0.25, 0.25])
    blends = Blends(torch.tensor([[0, 1, 3]]), weights[None])
    blended = blends.sequences(shown, torch.tensor([0]))
    parts = shown.joints[[0, 1, 3]]
    assert torch.allclose(blended.joints[0], (weights[:, None, None] * parts).sum(0))
    frames = (weights[:, None, None, None, None] * shown.frames[[0, 1, 3]]).sum(0)
    assert (blended.frames[0] - frames).abs().max() <= 0.5
    assert blended.lengths.item() == 6  # as long as its longest part
    values = torch.rand(3, 2, 4)
    assert torch.allclose(blends.intention(IntentionState({"top": values})).layers["top"][0], (weights[:, None, None] * values).sum(0))


def test_a_single_demonstration_has_nothing_to_be_blended_with() -> None:
    alone = Sequences(torch.zeros(1, 6, 8, 8, 1, dtype=torch.uint8), torch.zeros(1, 6, 2), torch.tensor([6]), rest_steps=0)
    blends = draw_blends(torch.tensor([0, 0]), alone, torch.Generator().manual_seed(0), share=0.5)
    assert blends.rows.tolist() == [[0], [0]]
    assert blends.weights.tolist() == [[1.0], [1.0]]


def test_the_most_alike_come_first() -> None:
    joints = torch.tensor([0.0, 1.0, 5.0, 5.5])[:, None, None].expand(4, 6, 1)
    shown = Sequences(torch.zeros(4, 6, 8, 8, 1, dtype=torch.uint8), joints, torch.full((4,), 6), rest_steps=0)
    assert shown.alike.tolist() == [[1, 2, 3], [0, 2, 3], [3, 1, 0], [2, 1, 0]]
