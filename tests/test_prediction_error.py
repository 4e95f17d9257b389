"""The prediction error, against numbers worked out by hand."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from preimage.method.prediction_error import SequenceError, arrival_step, sequence_error
from preimage.network.divergence import VISUAL_WEIGHT, proprioceptive_error, visual_error
from preimage.network.pdvmrnn import Generated

distributions = st.lists(st.floats(0.01, 1), min_size=4, max_size=4).map(lambda shares: distribution_of(torch.tensor(shares).double()))


def distribution_of(shares: torch.Tensor) -> torch.Tensor:
    """They in proportion, with a sum of one to the last digits of double precision, as the inequalities below ask for."""
    return shares / shares.sum()


@given(distributions)
def test_what_is_drawn_is_a_distribution(code):
    assert float(code.sum()) == pytest.approx(1, abs=1e-15)


def test_visual_error_is_the_squared_error_summed_over_4096_pixels():
    target = torch.zeros(1, 64, 64)
    assert float(visual_error(torch.full_like(target, 0.5), target)) == 4096 * 0.25
    one_pixel = target.clone()
    one_pixel[0, 3, 5] = 2.0
    assert float(visual_error(one_pixel, target)) == 4.0


@pytest.mark.parametrize("shape", [(1, 32, 32), (1, 128, 128), (3, 64, 64), (3, 16, 48)])
def test_frames_of_any_size_and_colour_are_charged_alike(shape):
    target = torch.zeros(shape)
    assert float(visual_error(target + 0.5, target)) == pytest.approx(4096 * 0.25)


def test_proprioceptive_error_is_the_divergence_from_target_to_predicted():
    target, predicted = torch.tensor([[0.5, 0.5]]), torch.tensor([[0.25, 0.75]])
    by_hand = 0.5 * math.log(0.5 / 0.25) + 0.5 * math.log(0.5 / 0.75)  # 0.1438; the other way round 0.1308
    assert float(proprioceptive_error(predicted.log(), target)) == pytest.approx(by_hand, abs=1e-6)


def test_proprioceptive_error_sums_over_joints():
    target, predicted = torch.tensor([[0.5, 0.5]] * 3), torch.tensor([[0.25, 0.75], [0.5, 0.5], [0.75, 0.25]])
    assert float(proprioceptive_error(predicted.log(), target)) == pytest.approx(2 * 0.143841, abs=1e-6)


def test_a_code_with_zeros_has_a_finite_error():
    assert float(proprioceptive_error(torch.tensor([[0.5, 0.5]]).log(), torch.tensor([[1.0, 0.0]]))) == pytest.approx(math.log(2))


@given(distributions)
def test_no_divergence_from_itself(code):
    assert float(proprioceptive_error(code[None].log(), code[None])) == pytest.approx(0, abs=1e-12)


@given(distributions, distributions)
def test_divergence_is_zero_only_between_equals(one, other):
    divergence = float(proprioceptive_error(one[None].log(), other[None]))
    # Pinsker's inequality: twice the squared total variation is a lower bound.
    assert divergence >= 0.5 * float((one - other).abs().sum()) ** 2 - 1e-12


def sequences(*, padding: float = 0.0):
    """Two sequences of three steps; the last step of the second is padded, and predicted wrongly by `padding`."""
    pixels, codes = torch.zeros(2, 3, 1, 64, 64), torch.full((2, 3, 1, 2), 0.5)
    predicted, log_codes = pixels.clone(), codes.log()
    predicted[0, :, 0, 0, 0] = torch.tensor([1.0, 2.0, 3.0])
    predicted[1, :2, 0, 0, 0] = torch.tensor([1.0, 2.0])
    predicted[1, 2] = padding
    log_codes[1, 1, 0] = torch.tensor([0.25, 0.75]).log()
    mask = torch.tensor([[1.0, 1.0, 1.0], [1.0, 1.0, 0.0]])
    return Generated(predicted, log_codes), pixels, codes, mask


def test_sequence_error_is_the_mean_over_the_steps_that_count():
    error = sequence_error(*sequences())
    assert error.visual.tolist() == pytest.approx([(1 + 4 + 9) / 3, (1 + 4) / 2])
    assert error.proprioceptive.tolist() == pytest.approx([0, 0.143841 / 2], abs=1e-6)


def test_padded_steps_do_not_count():
    clean, padded = sequence_error(*sequences()), sequence_error(*sequences(padding=0.9))
    torch.testing.assert_close(clean.visual, padded.visual)


def test_the_total_weighs_vision_against_the_joints():
    error = SequenceError(torch.tensor([80.0]), torch.tensor([0.5]))
    assert float(error.total) == pytest.approx(80 * VISUAL_WEIGHT + 0.5)


def test_arrival_step_by_hand():
    errors = torch.tensor(
        [
            [2.0, 1.000, 0.995, 0.970],  # times 1.01^t: 2, 1.010, 1.015, 0.9994
            [2.0, 1.000, 0.995, 0.985],  # times 1.01^t: 2, 1.010, 1.015, 1.0148
            [0.5, 1.000, 0.900, 0.800],
        ]
    )
    assert arrival_step(errors, delay_penalty=1.01).tolist() == [3, 1, 0]
    assert arrival_step(errors, delay_penalty=1.0).tolist() == [3, 3, 0]


def test_of_two_equal_errors_the_earlier_wins():
    assert arrival_step(torch.tensor([[3.0, 1.0, 1.0]]), delay_penalty=1.0).tolist() == [1]


@given(st.lists(st.floats(0.01, 100), min_size=1, max_size=12), st.floats(1.0, 1.2))
def test_a_delay_penalty_never_postpones_the_arrival(errors, penalty):
    at = torch.tensor([errors], dtype=torch.float64)
    assert int(arrival_step(at, delay_penalty=penalty)) <= int(arrival_step(at, delay_penalty=1.0))
