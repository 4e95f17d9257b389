"""What is encoded is read back: joint angles within a small error over their whole range, pixels exactly."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from jaxtyping import TypeCheckError

from preimage.network.coding import JointCoding, to_frames, to_pixels

ROUND_TRIP = 0.003
"""Largest error, as a share of [-1, 1] scaled angles."""

limits = st.floats(-10, 10).flatmap(lambda lower: st.tuples(st.just(lower), st.floats(0.01, 10).map(lambda size: lower + size)))


def coding_of(lower: float, upper: float, units: int = 10) -> JointCoding:
    return JointCoding(torch.tensor([lower], dtype=torch.float64), torch.tensor([upper], dtype=torch.float64), units)


@given(limits=limits, share=st.floats(0, 1))
def test_decode_undoes_encode_over_the_whole_range(limits, share):
    lower, upper = limits
    joint = torch.tensor([lower + share * (upper - lower)], dtype=torch.float64)
    coding = coding_of(lower, upper)
    assert 2 * float((coding.decode(coding.encode(joint)) - joint).abs()) / (upper - lower) < ROUND_TRIP


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_decode_undoes_encode_on_a_fine_grid_with_its_rims(dtype):
    coding = JointCoding(torch.tensor([-1.0], dtype=dtype), torch.tensor([1.0], dtype=dtype))
    joints = torch.linspace(-1, 1, 10_001, dtype=dtype)[:, None]
    assert float((coding.decode(coding.encode(joints)) - joints).abs().max()) < ROUND_TRIP


@given(limits=limits, joint=st.floats(-100, 100), units=st.integers(2, 40))
def test_codes_are_distributions_wherever_the_joint_is(limits, joint, units):
    codes = coding_of(*limits, units=units).encode(torch.tensor([joint], dtype=torch.float64))
    assert codes.shape == (1, units)
    assert float(codes.sum()) == pytest.approx(1)
    assert bool((codes >= 0).all())


def test_the_unit_nearest_to_the_angle_answers_most():
    coding = coding_of(-1, 1)
    assert coding.encode(coding.centres[3:4])[0].argmax() == 3
    assert coding.encode(coding.centres[3:4] + 0.2)[0].argmax() == 4  # the spacing is 2.5 / 9


def test_an_angle_in_the_middle_is_coded_symmetrically():
    codes = coding_of(2, 4).encode(torch.tensor([3.0], dtype=torch.float64))[0]
    torch.testing.assert_close(codes, codes.flip(0))


def test_joints_have_their_own_limits_and_any_batch():
    coding = JointCoding(torch.tensor([-1.0, 0.0, 5.0]), torch.tensor([1.0, 0.5, 9.0]))
    joints = torch.tensor([-1.0, 0.0, 5.0]).expand(2, 7, 3)
    codes = coding.encode(joints)
    assert codes.shape == (2, 7, 3, 10)
    torch.testing.assert_close(codes[..., 0, :], codes[..., 1, :])  # each at its own lower limit
    torch.testing.assert_close(coding.decode(codes), joints, atol=0.02, rtol=0)


def test_limits_ride_with_the_weights():
    assert set(coding_of(0, 1).state_dict()) == {"lower", "upper", "centres"}


def test_limits_in_the_wrong_order_are_refused():
    with pytest.raises(ValueError, match=r"upper \[1.0\] must lie above lower \[1.0\]"):
        coding_of(1, 1)


@given(arrays.arrays(np.uint8, arrays.array_shapes(min_dims=3, max_dims=5, max_side=5)))
def test_pixels_round_trip_exactly(frames):
    pixels = to_pixels(torch.from_numpy(frames))
    assert pixels.shape == (*frames.shape[:-3], frames.shape[-1], *frames.shape[-3:-1])  # channels first
    assert float(pixels.min()) >= -1
    assert float(pixels.max()) <= 1
    np.testing.assert_array_equal(to_frames(pixels).numpy(), frames)


def test_every_grey_level_survives_and_the_ends_are_minus_one_and_one():
    levels = torch.arange(256, dtype=torch.uint8).view(1, 256, 1)
    pixels = to_pixels(levels)
    assert pixels[0, 0, 0] == -1
    assert pixels[0, 0, -1] == 1
    assert bool((to_frames(pixels) == levels).all())


def test_pixels_beyond_the_range_are_clipped():
    assert to_frames(torch.tensor([[[-3.0, 3.0]]])).flatten().tolist() == [0, 255]


def test_shapes_are_checked_while_testing():
    with pytest.raises(TypeCheckError):
        to_pixels(torch.zeros(4, 4, dtype=torch.uint8))
