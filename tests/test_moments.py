"""Pictures and joints that were not taken at the same moments, or are not what is to be learned, in recordings otherwise healthy."""

import re
from dataclasses import replace

import numpy as np
import pytest

from planar_arm import seen_from_above
from preimage.examination import Examination, Kind, Severity, examine
from preimage.examination.timing import BLUNT_S
from preimage.records import Episode
from test_examination import FAULT, ILL, NAMES, NUM_EPISODES, WARNING, found, healthy, repeated


def late(one: Episode, steps: int) -> Episode:
    """Each picture shows what was there so many steps before."""
    frames = np.concatenate([np.repeat(one.frames[:1], steps, 0), one.frames[: len(one.frames) - steps]])
    return replace(one, frames=frames)


def stale(episodes: list[Episode], count: int = 1) -> list[Episode]:
    """The first pictures are the last of the episode before."""
    earlier = [episodes[-1], *episodes[:-1]]
    return [
        replace(one, frames=np.concatenate([before.frames[-count:], one.frames[count:]]))
        for one, before in zip(episodes, earlier, strict=True)
    ]


def waiting(one: Episode, steps: int) -> Episode:
    """The recorder was started long before the hand set out."""
    noise = np.random.default_rng(one.index).normal(0, 1e-4, (steps, one.joints.shape[1]))
    frames, joints = np.repeat(one.frames[:1], steps, 0), one.joints[:1] + noise
    grain = np.random.default_rng(one.index).integers(0, 2, frames.shape, np.uint8)
    num_steps = len(one.joints) + steps
    return replace(
        one,
        frames=np.concatenate([frames + grain, one.frames]),
        joints=np.concatenate([joints, one.joints]),
        timestamps_s=np.arange(num_steps) / one.rate_hz,
        declared_length=num_steps,
    )


def only(examination: Examination, kind: Kind):
    (finding,) = [finding for finding in examination.findings if finding.kind is kind]
    return finding


@pytest.mark.parametrize("count", [1, 2, 3])
def test_first_pictures_of_the_episode_before_are_found(count):
    finding = only(examine(stale(healthy(), count)), Kind.STALE)
    assert finding.severity is WARNING
    assert len(finding.episodes) > 0.8 * NUM_EPISODES
    assert {step for _, step in finding.places} <= set(range(count))


@pytest.mark.parametrize("steps", [1, 2, 3, 5])
def test_a_camera_that_lags_is_found_and_by_how_many_steps(steps):
    finding = only(examine([late(one, steps) for one in healthy()]), Kind.LAG)
    assert finding.severity is WARNING
    assert f"the picture lags the joints by {steps} step" in finding.what
    assert f"({100 * steps} ms)" in finding.what


def at_30_hz(one: Episode) -> Episode:
    """The same way three times as dense, as a camera of 30 Hz would see it."""
    return replace(repeated(one, 3), rate_hz=30.0, timestamps_s=np.arange(3 * len(one.joints)) / 30)


def test_on_video_of_30_hz_what_moves_is_as_large_as_at_10():
    dense = [at_30_hz(one) for one in healthy()]
    assert "nothing in the picture ever changes" not in only(examine(dense), Kind.SCENE).what
    sizes = [float(only(examine(some), Kind.SCENE).what.split("what moves is ")[1].split()[0]) for some in (healthy(), dense)]
    assert sizes[1] == pytest.approx(sizes[0], abs=2)


@pytest.mark.parametrize("rate_hz", [10, 15, 30, 50])
@pytest.mark.parametrize("steps", [0, 1, 3, 4])
def test_a_lag_is_told_as_the_steps_that_it_may_be(rate_hz, steps):
    """Where a step is short against what the correlation can tell, these are several; none is told where there is none."""
    found = [each.what for each in examine(way_of_a_planar_arm(rate_hz, late=steps)).findings if each.kind is Kind.LAG]
    if steps / rate_hz <= BLUNT_S:
        assert not found
        return
    least, *rest = re.findall(r"by (\d+)(?: to (\d+))? steps? \(", found[0])[0]
    assert int(least) <= steps <= int(rest[0] or least)


@pytest.mark.parametrize(("rate_hz", "frames"), [(10, 5), (30, 5), (30, 8)])
def test_a_picture_that_stands_for_some_frames_once_is_found(rate_hz, frames):
    """And one of a camera that takes every third frame is not, however often it stands."""
    episodes, begin = way_of_a_planar_arm(rate_hz, late=0), rate_hz
    assert Kind.STUCK not in found(examine(episodes))
    held = np.arange(3 * rate_hz)
    slow = [replace(one, frames=one.frames[held // 3 * 3]) for one in episodes]
    assert Kind.STUCK not in found(examine(slow))
    held[begin : begin + frames] = begin
    episodes[ILL] = replace(episodes[ILL], frames=episodes[ILL].frames[held])
    finding = only(examine(episodes), Kind.STUCK)
    assert (finding.severity, finding.episodes, finding.places) == (Severity.WARNING, (ILL,), ((ILL, begin),))


def way_of_a_planar_arm(rate_hz: int, *, late: int) -> list[Episode]:
    """Eight ways of three seconds, seen so many steps too late."""
    rng, episodes, count = np.random.default_rng(1), [], 3 * rate_hz
    for index in range(8):
        goal, steps = rng.uniform((-0.9, -1.2), (0.4, 0.6)), np.arange(-late, count)
        way = np.clip(steps / (0.75 * count), 0, 1)[:, None]
        joints = np.array([0.6, 0.9]) + (10 * way**3 - 15 * way**4 + 6 * way**5) * (goal - (0.6, 0.9))
        frames = np.stack([seen_from_above(each) for each in joints])[:count]
        frames = np.clip(frames + rng.normal(0, 1, frames.shape), 0, 255).astype(np.uint8)
        joints = joints[late:] + rng.normal(0, 1e-3, (count, 2))
        episodes.append(Episode(index, frames, joints, ("shoulder", "elbow"), np.arange(count) / rate_hz, count, float(rate_hz), None))
    return episodes


def test_a_long_rest_at_the_start_is_found():
    finding = only(examine([waiting(one, 25) if one.index < 5 else one for one in healthy()]), Kind.WAITS)
    assert finding.episodes == (0, 1, 2, 3, 4)
    assert "s, median) before a joint moves" in finding.what


def test_two_tasks_in_one_set_are_found():
    finding = only(examine([replace(one, task="push" if one.index >= 12 else "reach") for one in healthy()]), Kind.TASKS)
    assert "the set holds 2 tasks: 'reach' (episodes 0 to 11), 'push' (episodes 12 to 19)" in finding.what
    assert "--episodes" in finding.help


def test_numbers_that_are_passed_over_are_told_and_no_fault():
    examination = examine([one for one in healthy() if one.index not in (2, 5)])
    assert only(examination, Kind.GAPS).what.startswith("episodes 2, 5 are not among them")
    assert examination.trainable


@pytest.mark.parametrize("turn", [360.0, 2 * np.pi])
@pytest.mark.parametrize("start", [0.0, 0.5])
def test_angles_that_wrap_are_found_and_are_no_jumps(turn, start):
    """Degrees or radians, read from 0 or from minus half a turn on; two joints."""

    def wrapped(one: Episode) -> Episode:
        joints = one.joints.copy()
        joints[:, :2] *= turn / (2 * np.pi)
        joints[:, :2] = (joints[:, :2] + turn * np.array([0.0, 0.9])) % turn - start * turn
        joints[:, 0] = (joints[:, 0] + start * turn * 2) % turn - start * turn
        return replace(one, joints=joints)

    examination = examine([wrapped(one) for one in healthy()])
    assert {finding.joints for finding in examination.findings if finding.kind is Kind.WRAPS} >= {("yaw",)} if start == 0 else True
    assert Kind.JUMP not in found(examination)
    assert not found(examination, FAULT, WARNING), [str(finding) for finding in examination.findings]


def test_a_counter_among_the_joints_is_asked_about():
    def counting(one: Episode) -> Episode:
        count = 7.0 + np.arange(len(one.joints))
        return replace(one, joints=np.column_stack([one.joints, count]), joint_names=(*NAMES, "row"))

    finding = only(examine([counting(one) for one in healthy()]), Kind.COUNTER)
    assert finding.severity is FAULT
    assert finding.what == "row rises evenly in every episode, as a clock or a counter does"
    assert "--view.joints yaw shoulder gripper" in finding.help
    assert Kind.COUNTER not in found(examine([counting(one) for one in healthy()], joints_chosen=True))
