"""What a view leaves open is resolved by rules; a goal is looked at as the recordings were."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from preimage.data.view import View, coloured, default_size, look, moving, resolved, scaled, telling_channels

SIDES = st.integers(1, 2000)


@given(SIDES, SIDES)
def test_what_the_network_sees_fits_the_ladder(height, width):
    tall, wide = default_size(height, width)
    if min(height, width) < 16 and max(height, width) <= 64:
        assert (tall, wide) == (height, width)
    else:
        assert tall % 16 == wide % 16 == 0
    assert max(tall, wide) <= (128 if (tall, wide) == (height, width) else 64)
    assert default_size(tall, wide) == (tall, wide)


@given(st.integers(16, 64), st.integers(16, 64))
def test_a_small_picture_keeps_each_side_but_for_half_a_rung(height, width):
    tall, wide = default_size(height, width)
    assert max(abs(tall - height), abs(wide - width)) <= 8


@given(SIDES, SIDES)
def test_a_picture_on_its_side_is_seen_on_its_side(height, width):
    assert default_size(width, height) == default_size(height, width)[::-1]


@given(st.integers(48, 2000), st.integers(48, 2000))
@example(50, 56)
@example(50, 70)
def test_no_other_height_would_stretch_less(height, width):
    """Where the longer side is brought down to 64, the other is the nearest there is; small pictures are not brought to a size."""
    tall, wide = default_size(height, width)
    if width >= height and wide == 64 < width:
        wanted = 64 * height / width
        assert abs(tall - wanted) <= min(abs(other - wanted) for other in (16, 32, 48, 64)) + 1e-9


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("size", [(10, 12), (5, 6), (40, 30)])
def test_scaling_keeps_what_is_even(channels, size):
    colour = np.arange(50, 50 + 60 * channels, 60, dtype=np.uint8)
    small = scaled(np.broadcast_to(colour, (20, 24, channels)), size)
    assert small.shape == (*size, channels)
    assert (small == colour).all()


def test_shrinking_takes_the_mean():
    noise = np.random.default_rng(0).integers(0, 256, (480, 640, 1), np.uint8)
    small = scaled(noise, (48, 64))
    assert abs(small.mean() - noise.mean()) < 1
    assert small.std() < 0.2 * noise.std()


def test_the_crop_grows_and_shrinks_with_the_picture():
    view = resolved(View(crop=(8, 16, 16, 32), size=(16, 32)), 32, 64)
    frame = np.zeros((32, 64, 1), np.uint8)
    frame[8:24, 16:48] = 255
    large = np.repeat(np.repeat(frame, 4, 0), 4, 1)
    assert (look(frame, view, "goal") == 255).all()
    assert (look(large, view, "goal") == 255).all()
    assert (look(np.full((16, 32, 1), 7, np.uint8), view, "goal") == 7).all()  # already as the network sees it: nothing is cropped


@pytest.mark.parametrize("size", [(64, 64), (64, 32), (30, 64)])
def test_other_proportions_are_refused(size):
    view = resolved(View(size=(16, 16)), 32, 64)
    with pytest.raises(ValueError, match=f"goal is {size[1]}x{size[0]} pixels, the model sees 16x16: scale or crop it to that, or to the"):
        look(np.zeros((*size, 1), np.uint8), view, "goal")


def test_grey_copied_into_three_channels_is_one_only_where_all_of_it_is():
    grey = np.repeat(np.arange(24, dtype=np.uint8).reshape(1, 4, 6, 1), 3, -1)
    stained = grey.copy()
    stained[0, 0, 0, 0] += 1
    assert telling_channels([grey, grey]) == 1
    assert telling_channels([grey, stained]) == 3
    opaque = np.full((1, 4, 6, 1), 255, np.uint8)
    assert telling_channels([np.concatenate([grey, opaque], -1)]) == 1
    assert telling_channels([np.concatenate([stained, opaque], -1)]) == 3
    assert telling_channels([np.concatenate([stained, opaque - 1], -1)]) == 4


@given(st.integers(0, 255))
def test_grey_made_colour_made_grey_is_the_same(value):
    frame = np.full((2, 3, 1), value, np.uint8)
    assert (coloured(coloured(frame, "colour"), "grey") == frame).all()


def test_joints_move_where_an_episode_crosses_much_of_their_range():
    rng = np.random.default_rng(0)
    way = np.linspace(0, 1, 20)
    recordings = []
    for episode in range(20):
        arm = 2 * way + rng.normal(scale=5)  # from anywhere, but on the way
        gripper = 0.04 * way  # in metres, beside radians
        sometimes = way if episode % 5 == 0 else 0 * way
        put_elsewhere = rng.normal() + rng.normal(scale=0.01, size=20)
        noisy = rng.normal(scale=1e-3, size=20)
        recordings.append(np.stack([arm, gripper, sometimes, put_elsewhere, noisy, np.ones(20)], 1))
    assert moving(recordings).tolist() == [True, True, True, False, False, False]
    assert moving([1e3 * one for one in recordings]).tolist() == moving(recordings).tolist()
    assert moving([np.ones((3, 2))]).tolist() == [True, True]


@pytest.mark.parametrize("unit", [1.0, 0.04], ids=["ones", "metres"])
def test_a_gripper_moves_beside_degrees(unit):
    """It is a thousandth of what the joints go; what trembles by as little, and what is called otherwise, does not move."""
    rng, steps = np.random.default_rng(0), np.arange(40)
    joints = [np.stack([150 * np.sin(steps / 12), unit * (steps > 20), unit * (steps > 20)], 1) for _ in range(4)]
    trembling = [np.column_stack([each[:, 0], 0.01 * unit * rng.normal(size=(40, 2))]) for each in joints]
    names = ("elbow", "left_gripper", "gripper")
    assert moving(joints, names).tolist() == [True, True, True]
    assert moving(joints, ("elbow", "pump", "lamp")).tolist() == [True, False, False]
    assert moving(trembling, names).tolist() == [True, False, False]
