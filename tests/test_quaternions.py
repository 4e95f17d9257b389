"""Quaternions whose sign flips are read as the way that the hand went; `check` and `train` agree."""

from dataclasses import replace

import numpy as np
import pytest

from planar_arm import checked, recorded, write_v2
from preimage.data.attitudes import followed
from preimage.data.dataset import open_recordings
from preimage.data.quaternions import find_quaternions
from preimage.data.view import read_through
from preimage.examination import Kind

NAMES = ("x", "qx", "qy", "qz", "qw")


def attitudes(number: int, num_steps: int = 30, *, about=(0.3, 0.5, 0.81)) -> np.ndarray:
    """A hand that goes and turns by up to a radian and a half."""
    axis = np.array(about) / np.linalg.norm(about) + np.random.default_rng(number).normal(0, 0.1, 3)
    angle = np.linspace(0.2, 1.0 + 0.05 * number, num_steps)[:, None] / 2
    turned = np.concatenate([np.sin(angle) * axis / np.linalg.norm(axis), np.cos(angle)], 1)
    return np.concatenate([np.linspace(0, 1 + 0.1 * number, num_steps)[:, None], turned], 1)


def flipped(way: np.ndarray, steps: slice) -> np.ndarray:
    way = way.copy()
    way[steps, 1:] *= -1
    return way


@pytest.mark.parametrize("names", [NAMES, ("a", "b", "c", "d", "e")])
@pytest.mark.parametrize("steps", [slice(7, None), slice(None), slice(3, 4), slice(0, None, 2)])
def test_what_is_read_does_not_depend_on_the_signs_that_were_recorded(names, steps):
    ways = [attitudes(number) for number in range(6)]
    readings = [flipped(way, steps) if number in (1, 4) else way for number, way in enumerate(ways)]
    (found,) = find_quaternions(readings, names)
    assert (found.columns, found.episodes) == (names[1:], (1, 4))
    for reading, way in zip(readings, ways, strict=True):
        np.testing.assert_array_equal(followed(reading, names, [found]), way)


def test_what_is_no_quaternion_stays_as_it_is():
    """Joints, an angle as cosine and sine that starts on either side, joints near one, and a quaternion with a number missing."""
    angle = np.linspace(0, 1, 30)[:, None]
    for way in (
        np.concatenate([angle, angle**2, -angle, 0.5 * angle], 1),
        np.concatenate([np.ones_like(angle), 0.05 * angle, 0 * angle, 0 * angle], 1),
        np.where(np.arange(30)[:, None] == 3, np.nan, attitudes(0)[:, 1:]),
    ):
        assert not find_quaternions([way, -way], "abcd")
    cosines = [np.concatenate([np.cos(angle + start), np.sin(angle + start), 0 * angle, 0 * angle], 1) for start in (0, 3)]
    assert not find_quaternions(cosines, "abcd")


def test_a_turn_about_one_axis_is_a_quaternion_where_its_signs_flip():
    """And a cosine and a sine that turn on are none, nor is a signal that snaps from -1 to 1 beside zeros."""
    angle, zero = np.linspace(0.2, 0.9, 30), np.zeros(30)
    way = np.stack([zero, np.sin(angle), zero, zero, np.cos(angle)], 1)
    (found,) = find_quaternions([way, flipped(way, slice(9, None))], "abcde")
    np.testing.assert_array_equal(followed(flipped(way, slice(9, None)), "abcde", [found]), way)
    snaps = np.stack([np.where(angle > 0.5, 1.0, -1.0), zero, zero, zero], 1)
    assert not find_quaternions([way[:, 1:]] * 2, "abcd")
    assert not find_quaternions([snaps] * 2, "abcd")


@pytest.fixture
def data(tmp_path):
    """Recordings of an arm that say, beside its angles, how the hand is held; the tracker flips in two of them."""
    recordings = [(frames, np.concatenate([way, attitudes(number, len(way))[:, 1:]], 1)) for number, (frames, way) in enumerate(recorded())]
    for number, steps in ((2, slice(9, None)), (5, slice(None))):
        recordings[number][1][steps, 2:] *= -1
    return write_v2(tmp_path / "data", recordings, names=["shoulder", "elbow", *NAMES[1:]])


def test_check_and_train_tell_of_it_alike(data, capsys):
    opened = open_recordings(data)
    (line,) = [line for line in opened.summary if "quaternion" in line]
    found = [each for each in checked(data).findings if each.kind in (Kind.SIGN, Kind.JUMP)]
    assert [each.kind for each in found] == [Kind.SIGN]
    assert found[0].what == f"{line}, in training too"
    assert found[0].episodes == (2, 5)


def test_a_start_is_read_on_the_side_of_the_run(data):
    """The view that a run keeps reads a single step, and an episode, as they were learned."""
    opened = open_recordings(data)
    again = open_recordings(data, view=opened.view, only=[5])
    np.testing.assert_array_equal(again.demonstrations[0].joints, opened.demonstrations[5].joints)
    start = opened.demonstrations[5].joints[:1]
    mirrored = start * np.where(np.isin(np.array(opened.view.joints), NAMES), -1, 1)
    np.testing.assert_array_equal(read_through(opened.view, mirrored, opened.view.joints or ()), start)
    assert open_recordings(data, view=replace(opened.view, quaternions=(), poles=())).demonstrations[5].joints[0, 3] < 0
