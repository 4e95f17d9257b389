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


def test_no_dimensions_leave_a_free_intention_as_it_is() -> None:
    one = table("free")
    space = one.space(dimensions=None)
    assert space.training.shape == (6, 2 * (32 + 5))
    torch.testing.assert_close(space.intention(space.training).flatten(), one.intentions().flatten())


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
