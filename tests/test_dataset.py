"""What is saved is what is loaded, and what others recorded is looked at as the view says."""

import io
import itertools
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from preimage.dataset import fingerprint, load, save
from preimage.records import Demonstration, Scene
from preimage.view import View
from recordings import *

@pytest.fixture
def folder(tmp_path) -> Path:
    save_noise(tmp_path / "data")
    return tmp_path / "data"


@pytest.fixture
def demonstrations(folder) -> list[Demonstration]:
    return [noise(seed=seed, num_steps=3 + seed, scene=SCENE) for seed in range(3)]


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


def test_fingerprint_names_frames_joints_and_rate(demonstrations):
    first = demonstrations[0]
    frames, joints = first.frames.copy(), first.joints.copy()
    frames[0, 0, 0, 0] ^= 1
    joints[-1, -1] += 1e-3
    others = [
        demonstrations[1:],
        demonstrations[::-1],
        [Demonstration(frames, first.joints, first.rate_hz, first.joint_names), *demonstrations[1:]],
        [Demonstration(first.frames, joints, first.rate_hz, first.joint_names), *demonstrations[1:]],
        [Demonstration(first.frames, first.joints, 5.0, first.joint_names), *demonstrations[1:]],
    ]
    names = {fingerprint(each) for each in [demonstrations, *others]}
    assert len(names) == 1 + len(others)
    assert fingerprint(list(demonstrations)) in names


