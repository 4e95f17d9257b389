"""Recordings as the network takes them: at its rate, padded, with a mask that says which steps count."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from preimage.data.sequences import at_rate, pad, sensors_of
from preimage.records import Demonstration
from shared import make_demonstration

SMALL = (8, 8, 1)


def counting(num_steps: int, rate_hz: float = 10.0) -> Demonstration:
    """A recording whose only joint counts the steps."""
    return Demonstration(np.zeros((num_steps, *SMALL), np.uint8), np.arange(float(num_steps))[:, None], rate_hz, ("yaw",))


def steps_of(demonstration: Demonstration) -> list[float]:
    return demonstration.joints[:, 0].tolist()


def test_its_own_rate_changes_nothing():
    assert steps_of(at_rate(counting(5), 10.0)) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("num_steps", "rate_hz", "kept"),
    [(7, 5.0, [0, 2, 4, 6]), (6, 5.0, [0, 2, 4, 5]), (2, 1.0, [0, 1]), (9, 2.5, [0, 4, 8]), (10, 4.0, [0, 2, 4, 7, 9])],
)
def test_a_coarser_rate_keeps_the_steps_on_its_clock_and_the_last(num_steps, rate_hz, kept):
    resampled = at_rate(counting(num_steps), rate_hz)
    assert steps_of(resampled) == kept
    assert resampled.rate_hz == rate_hz


@given(num_steps=st.integers(2, 80), recorded=st.floats(1, 60), share=st.floats(0.05, 1))
def test_any_rate_keeps_order_start_and_end(num_steps, recorded, share):
    kept = steps_of(at_rate(counting(num_steps, recorded), recorded * share))
    assert kept[0] == 0
    assert kept[-1] == num_steps - 1
    assert kept == sorted(kept)
    assert max(np.diff(kept)) <= np.ceil(1 / share) + 1e-9


@given(num_steps=st.integers(2, 200), recorded=st.floats(1, 60), share=st.floats(0.03, 1))
def test_no_step_is_repeated_and_steps_are_evenly_spaced(num_steps, recorded, share):
    """30 to 4 Hz once gave the steps 0, 8, 8."""
    assert steps_of(at_rate(counting(9, 30.0), 4.0)) == [0, 8]
    between = np.diff(steps_of(at_rate(counting(num_steps, recorded), recorded * share)))
    assert (between > 0).all()
    if between[:-1].size and between[-1] < between[:-1].min():  # a clock that ticks on the steps themselves ends before its next tick
        between = between[:-1]
    assert np.ptp(between) <= 1


def test_a_rate_above_the_recording_is_refused():
    with pytest.raises(ValueError, match="the model runs at 20 Hz, the recording at 10 Hz: record faster or lower rate_hz"):
        at_rate(counting(5), 20.0)


def test_sensors_are_those_of_the_data_with_room_beyond_the_joints_range():
    one, other = make_demonstration(0, size=(8, 16, 3)), make_demonstration(1, size=(8, 16, 3))
    sensors = sensors_of([one, other])
    assert (sensors.height, sensors.width, sensors.channels, sensors.joint_names) == (8, 16, 3, one.joint_names)
    joints = np.concatenate([one.joints, other.joints])
    span = joints.max(0) - joints.min(0)
    np.testing.assert_allclose(sensors.joint_lower, joints.min(0) - 0.1 * span)
    np.testing.assert_allclose(sensors.joint_upper, joints.max(0) + 0.1 * span)


def test_a_joint_that_never_moves_still_has_a_range():
    still = Demonstration(np.zeros((3, *SMALL), np.uint8), np.ones((3, 1)), 10.0, ("yaw",))
    sensors = sensors_of([still])
    assert sensors.joint_lower[0] < 1 < sensors.joint_upper[0]


@pytest.mark.parametrize(
    ("other", "sentence"),
    [
        ({"size": (8, 16, 1)}, r"demonstration 1 has frames of \(8, 16, 1\), the first of \(8, 8, 1\)"),
        ({"num_joints": 5}, "demonstration 1 has joints .*joint 4.*, the first "),
    ],
)
def test_recordings_of_different_kinds_are_refused(other, sentence):
    with pytest.raises(ValueError, match=sentence):
        sensors_of([make_demonstration(0, size=SMALL), make_demonstration(1, **{"size": SMALL} | other)])


def test_no_recording_is_refused():
    with pytest.raises(ValueError, match="there is no demonstration: give one or more"):
        pad([], rate_hz=5.0)


def test_padding_repeats_the_last_step_and_the_mask_counts_some_rest():
    sequences = pad([counting(6), counting(3)], rate_hz=10.0, rest_steps=1)
    assert len(sequences) == 2
    assert sequences.lengths.tolist() == [6, 3]
    assert sequences.joints[1, :, 0].tolist() == [0, 1, 2, 2, 2, 2]
    assert sequences.mask.tolist() == [[1, 1, 1, 1, 1, 1], [1, 1, 1, 1, 0, 0]]


def test_a_later_start_leaves_out_what_was_before_and_rests_as_long():
    sequences = pad([counting(6), counting(4)], rate_hz=10.0, rest_steps=1)
    later = sequences.begun_at(torch.tensor([0, 1, 1]), torch.tensor([4, 0, 2]))
    assert later.joints[..., 0].tolist() == [[4, 5, 5, 5, 5, 5], [0, 1, 2, 3, 3, 3], [2, 3, 3, 3, 3, 3]]
    assert later.mask.sum(1).tolist() == [3, 5, 3]


def test_padding_brings_recordings_of_different_rates_together():
    sequences = pad([counting(9, 10.0), counting(5, 5.0)], rate_hz=5.0)
    assert sequences.lengths.tolist() == [5, 5]
    assert sequences.joints[0, :, 0].tolist() == [0, 2, 4, 6, 8]
