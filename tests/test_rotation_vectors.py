"""Rotation vectors that leap near half a turn are read as the way that the hand went; `check` and `train` agree."""

import numpy as np
import pytest

from planar_arm import checked, recorded, write_v2
from preimage.data.attitudes import followed
from preimage.data.dataset import open_recordings
from preimage.data.rotation_vectors import find_rotation_vectors
from preimage.data.view import read_through
from preimage.examination import Kind

NAMES = ("x", "rx", "ry", "rz")


def attitudes(number: int, num_steps: int = 30, *, most: float = 3.6, about=(0.9, 0.4, 0.1)) -> np.ndarray:
    """A tool that points down, and turns on past half a turn about an axis that tilts by and by."""
    rng = np.random.default_rng(number)
    axis = np.array(about) + rng.normal(0, 0.05, 3) + np.linspace(0, 0.2, num_steps)[:, None] * np.array([0, 1, -1])
    angle = np.linspace(2.7 + 0.02 * number, most, num_steps)[:, None]
    return np.concatenate([angle / 4, angle * axis / np.linalg.norm(axis, axis=1, keepdims=True)], 1)


def as_a_robot_says(way: np.ndarray, half: float = np.pi) -> np.ndarray:
    """Between 0 and half a turn, whichever way round that is."""
    way, angle = way.copy(), np.linalg.norm(way[:, 1:], axis=1, keepdims=True)
    way[:, 1:] = np.where(angle > half, way[:, 1:] * (1 - 2 * half / angle), way[:, 1:])
    return way


@pytest.mark.parametrize("names", [NAMES, ("a", "b", "c", "d"), ("x", "rotvec_0", "rotvec_1", "rotvec_2")])
@pytest.mark.parametrize("scale", [1.0, 180 / np.pi], ids=["radians", "degrees"])
def test_the_way_that_the_hand_went_is_read(names, scale):
    ways = [scale * attitudes(number, most=3.6 if number % 2 else 3.0) for number in range(6)]
    readings = [as_a_robot_says(way, scale * np.pi) for way in ways]
    (found,) = find_rotation_vectors(readings, names)
    assert (found.columns, found.episodes) == (names[1:], (1, 3, 5))
    for reading, way in zip(readings, ways, strict=True):
        np.testing.assert_allclose(followed(reading, names, [found]), way, atol=1e-9 * scale)


@pytest.mark.parametrize("names", [("x", "y", "z", "rx", "ry", "rz", "gripper"), "abcdefg"], ids=["called so", "not called so"])
@pytest.mark.parametrize("about", [(0.9, 0.4, 0.1), (0.0, 1.0, 0.05), (0.05, 0.0, 1.0)], ids=str)
def test_small_numbers_beside_it_are_no_part_of_it(names, about):
    """A place in metres before it and a gripper after it would fit as well, as far as they themselves go."""
    ways = [attitudes(number, about=about) for number in range(4)]
    beside = [np.outer(np.sin(way[:, 0]), (0.3, -0.2, 0.1)) for way in ways]
    readings = [
        np.concatenate([place, as_a_robot_says(way)[:, 1:], 0.04 * place[:, :1]], 1) for place, way in zip(beside, ways, strict=True)
    ]
    (found,) = find_rotation_vectors(readings, names)
    assert found.columns == tuple(names[3:6])
    read = [followed(reading, names, [found]) for reading in readings]
    assert max(np.abs(np.diff(each, axis=0)).max() for each in read) < 0.2
    assert np.ptp([each[0, 3:6] for each in read], axis=0).max() < 2, "all begin on one side"


def test_episodes_that_begin_on_either_side_are_read_alike():
    ways = [attitudes(number, most=3.1) for number in range(6)]
    begun = [3.3 / 2.7 * way if number in (2, 3) else way for number, way in enumerate(ways)]
    readings = [as_a_robot_says(way) for way in begun]
    assert all(np.linalg.norm(np.diff(each, axis=0), axis=1).max() < 1 for each in readings), "none leaps by itself"
    (found,) = find_rotation_vectors(readings, NAMES)
    for reading, way in zip(readings, begun, strict=True):
        np.testing.assert_allclose(followed(reading, NAMES, [found])[:, 1:], way[:, 1:], atol=1e-9)


def test_what_is_no_rotation_vector_that_leaps_stays_as_it_is():
    """Joints of which one wraps, attitudes that stay on one side, a gripper that snaps, and a number that is missing."""
    way, missing = attitudes(0, most=3.0), as_a_robot_says(attitudes(0))
    angle = np.linspace(2.8, 3.5, 30)
    joints = np.stack([0 * angle, (angle + np.pi) % (2 * np.pi) - np.pi, 0.1 * angle, -0.2 * angle], 1)
    snaps = np.stack([0 * angle, np.where(angle > 3, 2.0, -2.0), 0.1 * angle, 0 * angle], 1)
    missing[3, 2] = np.nan
    for one in (way, joints, snaps, missing):
        assert not find_rotation_vectors([one, one[::-1]], NAMES if one is way else "abcd")


@pytest.fixture
def data(tmp_path):
    """Recordings of an arm that say, beside its angles, how the hand is held."""
    ways = [as_a_robot_says(attitudes(number, 20, most=3.6 if number in (2, 5) else 3.0))[:, 1:] for number in range(8)]
    recordings = [(frames, np.concatenate([joints, way], 1)) for (frames, joints), way in zip(recorded(), ways, strict=True)]
    return write_v2(tmp_path / "data", recordings, names=["shoulder", "elbow", *NAMES[1:]])


def test_check_and_train_tell_of_it_alike(data):
    opened = open_recordings(data)
    (line,) = [line for line in opened.summary if "rotation vector" in line]
    found = [each for each in checked(data).findings if each.kind in (Kind.LEAPS, Kind.JUMP, Kind.WRAPS)]
    assert [(each.kind, each.what, each.episodes) for each in found] == [(Kind.LEAPS, f"{line}, in training too", (2, 5))]
    assert max(np.abs(np.diff(one.joints, axis=0)).max() for one in opened.demonstrations) < 1


def test_a_start_is_read_on_the_side_of_the_run(data):
    """The view that a run keeps reads a single step, and an episode, as they were learned."""
    opened = open_recordings(data)
    again = open_recordings(data, view=opened.view, only=[5])
    np.testing.assert_array_equal(again.demonstrations[0].joints, opened.demonstrations[5].joints)
    start, names = opened.demonstrations[0].joints[:1], opened.view.joints or ()
    other = start.copy()
    other[:, -3:] *= 1 - 2 * np.pi / np.linalg.norm(start[:, -3:])
    np.testing.assert_allclose(read_through(opened.view, other, names), start, atol=1e-6)
