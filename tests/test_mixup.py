"""Laws of mixup: a demonstration by itself stays as it is, a sum is the weighted mean of its parts, and weights sum to one."""

import pytest
import torch

from preimage.data.sequences import Sequences
from preimage.ideas.image_features import BLUR, blurred
from preimage.ideas.mixup import Mixup, coarse
from preimage.method.batches import plain_batch
from preimage.method.seam import Batch


def sequences() -> Sequences:
    draw = torch.Generator().manual_seed(0)
    frames = torch.randint(50, 200, (4, 6, 8, 8, 1), generator=draw).to(torch.uint8)
    return Sequences(frames, torch.rand(4, 6, 2, generator=draw), torch.tensor([3, 4, 5, 6]), rest_steps=0)


def mixed(mixup: Mixup, rows: list[int], shown: Sequences | None = None) -> Batch:
    shown = shown or sequences()
    return mixup(plain_batch(torch.tensor(rows), shown), shown, torch.Generator().manual_seed(0))


@pytest.mark.parametrize(("share", "num_mixed"), [(0.0, 0), (0.5, 2), (0.9, 3)])
def test_a_share_of_the_sequences_are_sums_of_different_demonstrations(share: float, num_mixed: int) -> None:
    batch = mixed(Mixup(share), [3, 1, 0, 2])
    assert batch.blurred.tolist() == [False] * (4 - num_mixed) + [True] * num_mixed
    assert batch.rows[:, 0].tolist() == [3, 1, 0, 2]
    assert all(len(set(parts)) == 3 for parts in batch.rows.tolist())
    assert batch.weights.sum(1) == pytest.approx(torch.ones(4).numpy(), abs=1e-6)


@pytest.mark.parametrize(("arity", "extrapolation"), [(3, 1.3), (4, 1.8), (3, 1.0)])
def test_sums_reach_as_far_beyond_their_demonstrations_as_they_should(arity: int, extrapolation: float) -> None:
    rows, draw = torch.zeros(4000, dtype=torch.long), torch.Generator().manual_seed(0)
    _, weights = Mixup(0.5, arity, extrapolation).draw(rows, sequences(), draw)
    assert weights.min().item() == pytest.approx((1 - extrapolation) / arity, abs=0.02)
    assert weights.mean(0) == pytest.approx(torch.full((arity,), 1 / arity).numpy(), abs=0.02)


def test_a_demonstration_by_itself_stays_as_it_is() -> None:
    batch, shown = mixed(Mixup(0.5), [0, 3, 1, 2]), sequences()
    alone = batch[~batch.blurred]
    assert alone.weights.tolist() == [[1.0, 0.0, 0.0]] * 2
    assert torch.equal(alone.sequences.frames, shown.frames[[0, 3]])
    assert torch.equal(alone.sequences.joints, shown.joints[[0, 3]])
    assert torch.equal(alone.sequences.lengths, shown.lengths[[0, 3]])


def test_a_sum_is_the_weighted_mean_of_its_parts() -> None:
    batch, shown = mixed(Mixup(0.5), [0, 3, 1, 2]), sequences()
    of_parts = "bp...,bp->b..."
    joints = torch.einsum(of_parts, shown.joints[batch.rows], batch.weights)
    torch.testing.assert_close(batch.sequences.joints, joints)
    frames = torch.einsum(of_parts, shown.frames[batch.rows].float(), batch.weights)
    assert (batch.sequences.frames - frames.clamp(0, 255)).abs().max() <= 0.5 + 1e-4  # whole grey levels
    longest = shown.lengths[batch.rows].amax(1)
    assert batch.sequences.lengths[batch.blurred].equal(longest[batch.blurred])


def test_a_single_demonstration_has_nothing_to_be_mixed_with() -> None:
    alone = Sequences(torch.zeros(1, 6, 8, 8, 1, dtype=torch.uint8), torch.zeros(1, 6, 2), torch.tensor([6]), rest_steps=0)
    batch = mixed(Mixup(0.5), [0, 0], alone)
    assert batch.rows.tolist() == [[0], [0]]
    assert batch.weights.tolist() == [[1.0], [1.0]]


def test_what_is_smooth_counts_through_the_blur_as_much_as_without() -> None:
    waves = torch.sin(torch.linspace(0, 6.28, 64)).expand(1, 1, 64, 64)
    through, small = coarse(waves), blurred(waves, BLUR)
    assert through.shape == small.shape
    assert through.shape[-1] < 64
    flat = torch.ones(1, 1, 512, 512)  # of which the edges are but a little
    assert coarse(flat).square().sum().item() == pytest.approx(flat.square().sum().item() * coarse(flat).shape[-1] ** 2 / 512**2, rel=0.5)


def test_the_most_alike_come_first() -> None:
    joints = torch.tensor([0.0, 1.0, 5.0, 5.5])[:, None, None].expand(4, 6, 1)
    shown = Sequences(torch.zeros(4, 6, 8, 8, 1, dtype=torch.uint8), joints, torch.full((4,), 6), rest_steps=0)
    assert shown.alike.tolist() == [[1, 2, 3], [0, 2, 3], [3, 1, 0], [2, 1, 0]]
