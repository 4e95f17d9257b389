"""Laws of the intention tables and of the space that planning searches."""

import math

import pytest
import torch

from preimage.network.intention import FreeTable, IntentionTable, LatentTable, unflatten

SHAPES = {"top": (2, 4, 4), "motor1": (5,)}


def table(kind: str, num_sequences: int = 6) -> IntentionTable:
    generator = torch.Generator().manual_seed(0)
    if kind == "free":
        return FreeTable(SHAPES, num_sequences=num_sequences, noise=0.0, generator=generator)
    return LatentTable(SHAPES, num_sequences=num_sequences, dimensions=3, generator=generator)


@pytest.mark.parametrize("kind", ["free", "latent"])
def test_the_contract_of_a_table(kind: str) -> None:
    one = table(kind)
    assert len(one) == len(one.intentions()) == 6
    assert {name: tuple(values.shape[1:]) for name, values in one.intentions().layers.items()} == {
        name: (2, *shape) for name, shape in SHAPES.items()
    }
    assert one.prior_mean(2).flatten().abs().max() == 0
    drawn, charge = one.draw(torch.tensor([1, 1]), torch.Generator().manual_seed(0))
    assert len(drawn) == 2
    (drawn.flatten().square().sum() + charge.sum()).backward()
    assert all(p.grad is not None for p in one.parameters())


@pytest.mark.parametrize("kind", ["free", "latent"])
def test_training_coordinates_stand_for_the_training_intentions(kind: str) -> None:
    one = table(kind)
    space = one.space(dimensions=5)
    torch.testing.assert_close(space.intention(space.training).flatten(), one.intentions().flatten(), atol=1e-4, rtol=1e-3)


def test_coordinates_of_free_intentions_have_unit_variance() -> None:
    space = table("free").space(dimensions=4)
    torch.testing.assert_close(space.training.std(0), torch.ones(4), atol=1e-3, rtol=0)


def test_no_dimensions_are_all_in_which_the_intentions_differ() -> None:
    for kind, kept in (("free", 5), ("latent", 3)):  # six sequences span five directions, three numbers three
        one = table(kind)
        space = one.space(dimensions=None)
        assert space.training.shape == (6, kept)
        torch.testing.assert_close(space.training.std(0), torch.ones(kept), atol=1e-3, rtol=0)
        torch.testing.assert_close(space.training.mean(0), torch.zeros(kept), atol=1e-5, rtol=0)
        torch.testing.assert_close(space.intention(space.training).flatten(), one.intentions().flatten(), atol=1e-5, rtol=1e-4)


def test_of_fewer_dimensions_those_are_kept_in_which_intentions_differ_most() -> None:
    one = table("free")
    rows = one.intentions().flatten()
    missed = [(one.space(kept).intention(one.space(kept).training).flatten() - rows).square().sum().item() for kept in range(1, 6)]
    sizes = torch.linalg.svdvals(rows - rows.mean(0)).square()
    assert missed == pytest.approx([sizes[kept:].sum().item() for kept in range(1, 6)], abs=1e-4)


def test_noise_on_a_free_intention_is_distributed_as_the_training_intentions_are() -> None:
    one = FreeTable({"motor1": (3,)}, num_sequences=5, noise=0.5, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        one.rows[:, 4] = 1.0  # all alike
        one.rows[:, 1] *= 10
    count = 20_000
    drawn, _ = one.draw(torch.full((count,), 2), torch.Generator().manual_seed(1))
    noise = drawn.flatten().detach() - one.rows[2].detach()
    assert noise[:, 4].abs().max() < 1e-5, "where they do not differ there is none"
    shown = 0.5**2 * one.rows.detach().T.cov()
    torch.testing.assert_close(noise.T.cov(), shown, atol=0.05 * float(shown.max()), rtol=0.05)
    assert noise.mean(0).abs().max() < 0.05 * float(shown.diagonal().sqrt().max())


def test_a_free_intention_without_noise_is_itself_and_charged_its_squared_size() -> None:
    one = table("free")
    drawn, charge = one.draw(torch.tensor([4, 1]), torch.Generator())
    assert drawn.flatten().equal(one.rows[[4, 1]])
    assert charge.tolist() == pytest.approx(one.rows[[4, 1]].square().sum(1).tolist())


def test_noise_of_a_single_free_intention_is_none() -> None:
    one = FreeTable(SHAPES, num_sequences=1, noise=0.5, generator=torch.Generator().manual_seed(0))
    assert one.draw(torch.tensor([0, 0]), torch.Generator())[0].flatten().equal(one.rows[[0, 0]])


@pytest.mark.parametrize("kind", ["free", "latent"])
def test_one_sequence_spans_no_space_and_is_searched_around_as_it_is(kind: str) -> None:
    one = table(kind, num_sequences=1)
    space, plain = one.space(dimensions=4), one.space(dimensions=None)
    assert torch.equal(space.training, plain.training)
    elsewhere = space.training + 1
    assert torch.equal(space.intention(elsewhere).flatten(), plain.intention(elsewhere).flatten())


def test_a_latent_is_charged_its_divergence_from_the_standard_normal() -> None:
    one = table("latent")
    with torch.no_grad():
        one.mean[0] = torch.tensor([0.0, 2.0, 0.0])
        one.log_deviation[0] = torch.tensor([0.0, 0.0, math.log(0.5)])
    _, charge = one.draw(torch.tensor([0]), torch.Generator())
    by_hand = 0.0 + 2.0**2 / 2 + ((0.25 - 1) / 2 + math.log(2))
    assert charge.item() == pytest.approx(by_hand, rel=1e-5)


def test_noise_is_drawn_from_the_generator_alone() -> None:
    one, rows = table("latent"), torch.tensor([0, 3])
    first, second, other = (one.draw(rows, torch.Generator().manual_seed(seed))[0].flatten() for seed in (1, 1, 2))
    assert torch.equal(first, second)
    assert not torch.equal(first, other)


def test_unflatten_undoes_flatten() -> None:
    rows = torch.randn(3, 2 * (32 + 5))
    assert torch.equal(unflatten(rows, SHAPES).flatten(), rows)
