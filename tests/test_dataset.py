"""What is saved is what is loaded, and what others recorded is looked at as the view says."""

import itertools
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from preimage.data.dataset import fingerprint, load, open_recordings, read_episodes
from preimage.data.view import View
from preimage.records import Demonstration
from preimage.storage.reading import record_of
from preimage.storage.recordings import save
from recordings import (
    CAMERA,
    DATA,
    SCENE,
    WRITERS,
    assert_equal,
    edit_rows,
    joints_of,
    noise,
    shade,
    shades,
    write_v21,
    write_video,
)

numbers = itertools.count()


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    height=st.integers(1, 9),
    width=st.integers(1, 9),
    channels=st.sampled_from([1, 3]),
    lengths=st.lists(st.integers(2, 6), min_size=1, max_size=4),
    num_joints=st.integers(1, 5),
    rate_hz=st.sampled_from([2.5, 10.0, 29.97]),
    scene=st.sampled_from([None, SCENE]),
)
def test_load_undoes_save(tmp_path, height, width, channels, lengths, num_joints, rate_hz, scene):
    saved = [
        noise(seed=seed, num_steps=length, size=(height, width, channels), num_joints=num_joints, rate_hz=rate_hz, scene=scene)
        for seed, length in enumerate(lengths)
    ]
    folder = tmp_path / str(next(numbers))
    save(saved, folder, task="anything")
    loaded = load(folder)
    assert_equal(loaded, saved)
    assert fingerprint(loaded) == fingerprint(saved)


def test_joints_are_rounded_to_float32_and_only_once(tmp_path):
    demonstration = Demonstration(np.zeros((2, 4, 4, 1), np.uint8), np.array([[0.1], [np.pi]]), 10.0, ("yaw",))
    save([demonstration], tmp_path / "once", task="t")
    once = load(tmp_path / "once")
    np.testing.assert_allclose(once[0].joints, demonstration.joints, rtol=6e-8)
    save(once, tmp_path / "twice", task="t")
    assert_equal(load(tmp_path / "twice"), once)


def test_colour_stays_colour_where_one_pixel_of_one_episode_has_it(tmp_path):
    frames = np.zeros((2, 4, 4, 3), np.uint8)
    joints = np.zeros((2, 1))
    coloured = frames.copy()
    coloured[1, 2, 3, 0] = 1
    saved = [Demonstration(each, joints, 10.0, ("yaw",)) for each in (frames, coloured)]
    save(saved, tmp_path / "colour", task="t")
    assert_equal(load(tmp_path / "colour"), saved)
    save(saved[:1], tmp_path / "grey", task="t")
    assert load(tmp_path / "grey")[0].frames.shape == (2, 4, 4, 1)


def test_fingerprint_names_frames_joints_and_rate(noisy):
    first = noisy[0]
    frames, joints = first.frames.copy(), first.joints.copy()
    frames[0, 0, 0, 0] ^= 1
    joints[-1, -1] += 1e-3
    others = [
        noisy[1:],
        noisy[::-1],
        [Demonstration(frames, first.joints, first.rate_hz, first.joint_names), *noisy[1:]],
        [Demonstration(first.frames, joints, first.rate_hz, first.joint_names), *noisy[1:]],
        [Demonstration(first.frames, first.joints, 5.0, first.joint_names), *noisy[1:]],
    ]
    names = {fingerprint(each) for each in [noisy, *others]}
    assert len(names) == 1 + len(others)
    assert fingerprint(list(noisy)) in names


# What the view leaves open


@pytest.fixture(params=WRITERS)
def foreign(request, tmp_path) -> Path:
    return WRITERS[request.param](tmp_path / "foreign")


def test_every_kind_of_folder_holds_the_same(tmp_path):
    """One recording in three formats; of videos, which are lossy, nearly the same."""
    first, *others = (open_recordings(write(tmp_path / name, lengths=(5, 4))) for name, write in WRITERS.items())
    for other in others:
        assert other.view == first.view
        for one, same in zip(first.demonstrations, other.demonstrations, strict=True):
            np.testing.assert_allclose(one.joints, same.joints, atol=1e-6)
            np.testing.assert_allclose(one.frames.astype(int), same.frames, atol=12)
            assert (one.rate_hz, one.joint_names) == (same.rate_hz, same.joint_names)


def test_frozen_joints_are_dropped_and_said_so(foreign):
    opened = open_recordings(foreign)
    assert opened.view.joints == opened.demonstrations[0].joint_names == ("pan", "lift")
    assert opened.summary[-1] == "2 of 3 joints: pan, lift; left out, for it does not move: frozen"


def test_frozen_joints_of_our_own_are_kept(tmp_path):
    still = Demonstration(np.zeros((3, 4, 4, 1), np.uint8), np.array([[0.0, 1], [1, 1], [2, 1]]), 10.0, ("moves", "rests"))
    save([still], tmp_path / "ours", task="t")
    assert_equal(load(tmp_path / "ours"), [still])


def test_joints_come_in_the_order_they_are_asked_for(foreign):
    asked = load(foreign, view=View(joints=("lift", "frozen")))
    np.testing.assert_allclose(asked[1].joints, joints_of(1, len(asked[1]))[:, [2, 1]], atol=1e-6)
    with pytest.raises(ValueError, match="has no joint elbow: it has pan, frozen, lift"):
        load(foreign, view=View(joints=("elbow",)))
    with pytest.raises(ValueError, match="joints are lift, lift: name one or more, each once"):
        load(foreign, view=View(joints=("lift", "lift")))


def test_what_was_resolved_shows_the_same_again(foreign):
    """A view with nothing left open is a fixed point, and survives JSON."""
    opened = open_recordings(foreign)
    kept = record_of(View, json.loads(json.dumps(asdict(opened.view))))
    again = open_recordings(foreign, view=kept)
    assert kept == opened.view == again.view
    assert_equal(again.demonstrations, opened.demonstrations)


def test_crop_size_and_grey(foreign):
    (first, *_) = load(foreign, view=View(crop=(16, 80, 64, 80), size=(16, 32), colour="grey"))  # only the right half is looked at
    assert first.frames.shape[1:] == (16, 32, 1)
    np.testing.assert_allclose(first.frames[:, 2:-2, 4:-4].mean((1, 2, 3)), [shade(0, step) for step in range(len(first))], atol=3)


def test_a_crop_outside_of_the_picture_is_told(foreign):
    with pytest.raises(ValueError, match=r"the crop \(50, 0, 50, 50\).* does not lie in a picture of 96x160"):
        load(foreign, view=View(crop=(50, 0, 50, 50)))


def test_grey_can_be_made_colour(tmp_path):
    save([noise(size=(6, 8, 1))], tmp_path / "grey", task="t")
    (one,) = load(tmp_path / "grey", view=View(colour="colour"))
    np.testing.assert_array_equal(one.frames, np.repeat(noise().frames, 3, axis=-1))


def test_few_lines_tell_what_was_chosen(tmp_path):
    opened = open_recordings(write_v21(tmp_path / "data"), view=View(crop=(0, 32, 96, 96)))
    assert opened.summary == (
        "LeRobotDataset v2.1: 2 episodes, 9 steps at 10 Hz",
        f"camera {CAMERA}: 160x96, of which 96x96 from row 0 and column 32, seen at 96x96, in colour",
        "2 of 3 joints: pan, lift; left out, for it does not move: frozen",
    )


# Patient reading


def test_the_patient_reader_hands_out_what_there_is(tmp_path):
    folder = write_v21(tmp_path / "data", lengths=(5, 4, 3))
    videos = folder / f"videos/chunk-000/{CAMERA}"
    (videos / "episode_000000.mp4").unlink()
    write_video(videos / "episode_000001.mp4", shades(1, 6, (96, 160)))
    (folder / "data/chunk-000/episode_000002.parquet").unlink()
    missing_video, extra_frames, missing_joints = read_episodes(folder)
    assert (len(missing_video.frames), len(missing_video.joints), missing_video.declared_length) == (0, 5, 5)
    assert "episode_000000.mp4 is missing" in missing_video.faults[0]
    assert (len(extra_frames.frames), len(extra_frames.joints), extra_frames.faults) == (6, 4, ())
    assert (len(missing_joints.frames), len(missing_joints.joints), missing_joints.declared_length) == (3, 0, 3)
    assert "episode_000002.parquet is missing" in missing_joints.faults[0]


def test_the_patient_reader_hands_out_all_joints_times_and_the_task(foreign):
    for episode in read_episodes(foreign):
        assert episode.joint_names == ("pan", "frozen", "lift")
        assert (len(episode.joints), episode.rate_hz, episode.faults) == (episode.declared_length, 10.0, ())
        if episode.task is not None:  # a plain folder knows neither
            assert episode.task == "pick"
            np.testing.assert_allclose(episode.timestamps_s, np.arange(len(episode.joints)) / 10, atol=1e-6)


def test_joints_that_are_named_are_those_of_every_episode(foreign):
    for whole, episode in zip(read_episodes(foreign), read_episodes(foreign, view=View(joints=("lift", "pan"))), strict=True):
        assert episode.joint_names == ("lift", "pan")
        np.testing.assert_array_equal(episode.joints, whole.joints[:, [2, 0]])
    with pytest.raises(ValueError, match="has no joint wrist: it has pan, frozen, lift"):
        next(iter(read_episodes(foreign, view=View(joints=("wrist",)))))


def test_a_frame_that_cannot_be_decoded_is_left_out_and_told(folder, noisy):
    edit_rows(folder / DATA, lambda rows: rows[4].update({CAMERA: {"bytes": b"no picture", "path": None}}))
    episode = list(read_episodes(folder))[1]
    np.testing.assert_array_equal(episode.frames[..., :1], noisy[1].frames[[0, 2, 3]])
    assert len(episode.faults) == 1
    assert "step 1 has a frame that cannot be decoded" in episode.faults[0]


def test_an_episode_that_is_not_there_is_told(foreign):
    with pytest.raises(ValueError, match="has no episode 7: it has 0"):
        load(foreign, only=(0, 7))
