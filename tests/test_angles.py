"""Angles that wrap: found, unwrapped within and between episodes, or refused; `check` and `train` agree."""

import numpy as np
import pytest

from planar_arm import EIGHT, NAMES, assert_refused_alike, checked, recorded, write_v2, write_v3
from preimage.data.angles import find_wraps, unwrapped
from preimage.data.dataset import load, open_recordings
from preimage.data.view import View
from preimage.examination import Kind

TURNS = {"degrees": (180 / np.pi, 360.0), "radians": (1.0, 2 * np.pi)}


@pytest.mark.parametrize("unit", TURNS)
@pytest.mark.parametrize("joints", [[0], [1], [0, 1]])
@pytest.mark.parametrize("lowest", [-0.5, 0.0])
@pytest.mark.parametrize("seam", [0.0, 0.75])
def test_angles_that_wrap_are_unwrapped(unit, joints, lowest, seam):
    """Some episodes cross the seam, and some start on either side of it."""
    factor, turn = TURNS[unit]
    rng = np.random.default_rng(1)
    ways = [factor * (way + rng.uniform(-0.3, 0.3, 2)) for _, way in recorded(24)]
    readings = [way.copy() for way in ways]
    for each in readings:
        each[:, joints] = (each[:, joints] - factor * seam) % turn + lowest * turn
    wraps = find_wraps(readings, NAMES)
    assert [(wrap.joint, wrap.impossible) for wrap in wraps] == [(NAMES[joint], "") for joint in joints]
    found = [unwrapped(each, NAMES, wraps) for each in readings]
    assert_same_but_for_a_turn(found, ways)
    for wrap, joint in zip(wraps, joints, strict=True):
        changed = [number for number, each in enumerate(found) if not np.array_equal(each[:, joint], readings[number][:, joint])]
        assert list(wrap.episodes) == changed


@pytest.mark.parametrize("unit", TURNS)
def test_episodes_on_either_side_of_the_seam_are_brought_together(unit):
    """No episode crosses it; or each was unwrapped by its recorder and starts a turn away from others."""
    factor, turn = TURNS[unit]
    ways = [factor * (way - way[0] + np.array([0.4 if number % 3 else -0.4, 0.0])) for number, (_, way) in enumerate(recorded(24))]
    small = [np.c_[0.2 * way[:, 0] + 0.3 * way[0, 0], way[:, 1]] for way in ways]
    apart = [np.c_[(way[:, 0] - 0.0) % turn - turn / 2, way[:, 1]] for way in small]
    begun = [np.c_[way[:, 0] + turn * (number % 2), way[:, 1]] for number, way in enumerate(ways)]
    for readings, meant in ((apart, small), (begun, ways)):
        wraps = find_wraps(readings, NAMES)
        assert [wrap.joint for wrap in wraps] == ["shoulder"]
        assert_same_but_for_a_turn([unwrapped(each, NAMES, wraps) for each in readings], meant)


def assert_same_but_for_a_turn(found: list[np.ndarray], meant: list[np.ndarray]) -> None:
    """All of them are off by one and the same angle in each joint."""
    off = np.concatenate(found) - np.concatenate(meant)
    np.testing.assert_allclose(off, np.broadcast_to(off[0], off.shape), atol=1e-9)


def test_what_only_looks_like_a_wrap_stays_as_it_is():
    """A gripper that snaps, one in percent, a joint that goes all the way and back, a glitch, and an encoder that counts turns."""
    way = np.linspace(0, 1, 40)
    snap = np.where(way > 0.5, 1.0, 0.0)
    glitch = np.where(np.arange(40) == 20, -170.0, 10 * way)
    columns = [5.0 * snap, 100 * snap, 300 * snap, 350 * np.sin(np.pi * way) - 175, 6 * way - 3, 800 * way, glitch]
    readings = [np.stack(columns, 1) * (1 - 0.01 * number) for number in range(10)]
    assert find_wraps(readings, [f"joint_{number}" for number in range(len(columns))]) == []


def test_the_six_episodes_that_cross_180_degrees_are_named(tmp_path):
    def wrapped(joints: np.ndarray) -> np.ndarray:
        return np.c_[(np.rad2deg(joints[:, 0]) + 213 + 180) % 360 - 180, np.rad2deg(joints[:, 1])]

    episodes = [(frames, wrapped(joints)) for frames, joints in recorded(24)]
    crossing = [number for number, (_, joints) in enumerate(episodes) if np.abs(np.diff(joints[:, 0])).max() > 180]
    folder = write_v3(tmp_path / "data", episodes)
    (finding,) = [finding for finding in checked(folder).findings if finding.kind is Kind.WRAPS]
    assert 0 < len(crossing) < 24
    assert list(finding.episodes) == crossing
    opened = open_recordings(folder)
    assert max(np.abs(np.diff(one.joints, axis=0)).max() for one in opened.demonstrations) < 20
    (alone,) = load(folder, view=opened.view, only=crossing[:1])  # a start or a goal alone stands where it stood among all
    np.testing.assert_array_equal(alone.joints, opened.demonstrations[crossing[0]].joints)


def test_an_angle_that_nothing_can_unwrap_is_refused(tmp_path):
    """The joint starts anywhere on the circle and turns all the way round."""
    rng = np.random.default_rng(0)

    def anywhere(joints: np.ndarray) -> np.ndarray:
        return np.c_[(rng.uniform(0, 360) + np.linspace(0, 420, len(joints))) % 360, np.rad2deg(joints[:, 1])]

    folder = write_v3(tmp_path / "data", [(frames, anywhere(joints)) for frames, joints in recorded(24)])
    assert_refused_alike(folder, "shoulder starts and turns all the way round, .*: leave it out by --view.joints elbow")
    assert load(folder, view=View(joints=("elbow",)))[0].joint_names == ("elbow",)


OTHERS = {
    "ticks": (4096.0, 0.0),
    "half a turn": (180.0, -90.0),
    "turns": (1.0, 0.0),
    "-1 to 1": (2.0, -1.0),
    "-100 to 100": (200.0, -100.0),
}


@pytest.mark.parametrize("unit", OTHERS)
@pytest.mark.parametrize("seam", [0.0, 0.1])
def test_a_turn_in_another_unit_is_unwrapped_too(unit, seam):
    turn, lowest = OTHERS[unit]
    ways = [np.c_[turn * (way[:, 0] / (2 * np.pi) + seam), way[:, 1]] for _, way in recorded(24)]
    readings = [np.c_[(way[:, 0] % turn) + lowest, way[:, 1]] for way in ways]
    crossing = [number for number, each in enumerate(readings) if np.abs(np.diff(each[:, 0])).max() > turn / 2]
    (wrap,) = find_wraps(readings, NAMES)
    assert (wrap.joint, wrap.turn, list(wrap.episodes)) == ("shoulder", turn, crossing)
    assert 0 < len(crossing) < 24
    assert_same_but_for_a_turn([unwrapped(each, NAMES, [wrap]) for each in readings], ways)


@pytest.mark.parametrize("low_and_high", [(0.0, 1.0), (-1.0, 1.0), (-100.0, 100.0), (-90.0, 90.0)])
def test_a_gripper_that_snaps_while_it_trembles_does_not_wrap(low_and_high):
    rng, low, high = np.random.default_rng(0), *low_and_high
    snaps = [np.where(np.arange(40) > rng.integers(9, 31), high, low) + rng.normal(0, 0.003 * (high - low), 40) for _ in range(24)]
    assert find_wraps([each[:, None] for each in snaps], ["gripper"]) == []


def test_a_joint_that_wraps_in_one_episode_and_goes_evenly_in_all_is_no_counter(tmp_path):
    turning = [
        (frames, np.c_[joints, (np.linspace(0, 15, 20) + (350 if number == 3 else 2)) % 360])
        for number, (frames, joints) in enumerate(EIGHT)
    ]
    folder = write_v2(tmp_path / "data", turning, names=[*NAMES, "wrist"])
    assert checked(folder).trainable
    assert np.abs(np.diff(open_recordings(folder).demonstrations[3].joints, axis=0)).max() < 1
