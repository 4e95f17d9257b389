"""Laws of kriging: what is known is found again, what lies between is blended, and the deviation tells how far to trust it."""

import pytest
import torch

from preimage.ideas.kriging import MAX_FIT_POINTS, Endings, krige, krige_by_all


def endings(count: int = 40, noise: float = 0.0) -> tuple[torch.Tensor, torch.Tensor]:
    """A curved sheet: features of two hidden numbers, and the values that go with them."""
    draw = torch.Generator().manual_seed(0)
    hidden = torch.rand(count, 2, generator=draw)
    features = torch.stack([hidden[:, 0], hidden[:, 1], hidden[:, 0] * hidden[:, 1], hidden[:, 1] ** 2], 1)
    values = torch.stack([(2 * hidden[:, 0]).sin(), hidden[:, 0] - hidden[:, 1] ** 2], 1)
    return features, values + noise * torch.randn(values.shape, generator=draw)


def test_what_is_known_is_found_again() -> None:
    features, values = endings()
    assert krige([(features[7], Endings(features))], values).mean == pytest.approx(values[7].numpy(), abs=0.01)


def test_what_lies_between_is_nearer_than_the_nearest() -> None:
    features, values = endings()
    others = torch.arange(40) != 7
    predicted = krige([(features[7], Endings(features[others]))], values[others]).mean
    nearest = values[others][(features[others] - features[7]).square().sum(1).argmin()]
    assert (predicted - values[7]).norm() < 0.2 * (nearest - values[7]).norm()


@pytest.mark.parametrize("noise", [0.05, 0.2])
def test_the_deviation_is_that_of_the_noise(noise: float) -> None:
    amid = torch.tensor([0.5, 0.5, 0.25, 0.25])
    features, values = endings(200, noise)
    predicted = krige([(amid, Endings(features))], values)
    assert predicted.deviation == pytest.approx(torch.full((2,), noise).numpy(), rel=0.3)


def test_of_many_endings_those_that_look_alike_choose_how_to_ask_all() -> None:
    """Twice as many as may choose; a view that shows nothing is not taken."""
    features, values = endings(2 * MAX_FIT_POINTS)
    others = torch.arange(2 * MAX_FIT_POINTS) != 7
    shown = features[others]
    predicted = krige([(torch.zeros(4), Endings(torch.zeros_like(shown))), (features[7], Endings(shown))], values[others])
    assert predicted.mean == pytest.approx(values[7].numpy(), abs=1e-3)


def test_views_that_contradict_each_other_are_doubted() -> None:
    """Two views tell all endings equally well, and of what is wanted one says this and the other that."""
    features, values = endings()
    here, there = ((features[row], Endings(features)) for row in (3, 9))
    one, both = krige_by_all([here], values), krige_by_all([here, there], values)
    assert one.mean == pytest.approx(values[3].numpy(), abs=0.01)
    assert both.mean == pytest.approx((values[3] + values[9]).numpy() / 2, abs=0.01)
    assert both.deviation == pytest.approx((values[3] - values[9]).abs().numpy() / 2, abs=0.02)


def test_a_view_that_tells_nothing_hardly_counts() -> None:
    features, values = endings()
    predicted = krige_by_all([(features[3], Endings(features)), (torch.zeros(4), Endings(torch.zeros_like(features)))], values)
    assert predicted.mean == pytest.approx(values[3].numpy(), abs=0.05)


def test_what_lies_beyond_all_endings_is_told_less_surely() -> None:
    features, values = endings()
    amid, beyond = (krige([(torch.tensor([a, a, a * a, a * a]), Endings(features))], values) for a in (0.5, 2.0))
    assert (beyond.deviation > 3 * amid.deviation).all()


def test_a_single_ending_tells_itself_and_is_not_trusted() -> None:
    predicted = krige([(torch.ones(3), Endings(torch.zeros(1, 3)))], torch.tensor([[4.0, 5.0]]))
    assert predicted.mean.tolist() == [4.0, 5.0]
    assert predicted.deviation.isinf().all()


def test_endings_that_look_all_the_same_tell_their_mean() -> None:
    predicted = krige([(torch.zeros(3), Endings(torch.zeros(4, 3)))], torch.tensor([[0.0], [2.0], [4.0], [6.0]]))
    assert predicted.mean.item() == pytest.approx(3.0, abs=1e-4)
    assert predicted.deviation.item() > 2


def test_what_is_asked_before_changes_nothing() -> None:
    """The matrices are kept, and the same answers come of them."""
    features, values = endings()
    once, asked = Endings(features), Endings(features)
    for goal in (features[3], features[9] + 0.1):
        krige([(goal, asked)], values[:, :1])
    first, later = (krige([(features[7], known)], values) for known in (once, asked))
    assert first.mean.tolist() == later.mean.tolist()
    assert first.deviation.tolist() == later.deviation.tolist()
