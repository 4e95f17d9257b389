"""Where starts and goals come from: image files, and steps of recorded demonstrations."""

import json
import shutil

import numpy as np
import pytest
from PIL import Image

from preimage.data.sequences import sensors_of
from preimage.data.sources import find_percept, read_image
from preimage.data.view import seen_by
from preimage.storage.networks import load_model
from preimage.storage.recordings import save
from preimage.storage.runs import read_view
from shared import make_demonstration


@pytest.fixture(scope="module")
def sensors(demonstrations):
    return sensors_of(demonstrations)


NOISE = np.random.default_rng(0).integers(0, 256, (64, 64), np.uint8)


@pytest.fixture
def picture(tmp_path):
    path = tmp_path / "goal.png"
    Image.fromarray(NOISE).save(path)
    return path


def test_an_image_is_a_frame_without_joints(picture, sensors):
    found = find_percept(str(picture), sensors, default_step=-1)
    np.testing.assert_array_equal(found.percept.frame[..., 0], NOISE)
    assert (found.percept.joints, found.scene) == (None, None)


def test_a_frame_from_an_image_can_be_written_to(picture, sensors):
    assert read_image(picture, sensors).flags.writeable  # torch warns of frames that cannot


def test_an_image_of_too_many_pixels_is_refused_before_it_is_unpacked(picture, sensors, monkeypatch):
    monkeypatch.setattr("preimage.data.decoding.MOST_PIXELS", 100)
    with pytest.raises(ValueError, match=r"goal.png is not an image that can be read: it has 64x64 pixels, more than"):
        read_image(picture, sensors)


def test_of_16_bits_the_upper_8_are_seen(tmp_path, sensors):
    Image.fromarray(np.full((64, 64), 9000, np.uint16)).save(tmp_path / "deep.png")
    assert (read_image(tmp_path / "deep.png", sensors) == 9000 // 256).all()


def test_a_colour_image_is_grey_to_a_model_that_sees_grey(tmp_path, sensors):
    Image.new("RGB", (64, 64), (10, 10, 10)).save(tmp_path / "colour.png")
    assert (read_image(tmp_path / "colour.png", sensors) == 10).all()


def test_a_grey_image_has_three_channels_to_a_model_that_sees_colour(tmp_path, picture):
    colour = sensors_of([make_demonstration(size=(64, 64, 3))])
    assert read_image(picture, colour).shape == (64, 64, 3)


@pytest.mark.parametrize(("source", "default_step", "step"), [("{}:1", -1, -1), ("{}:1", 0, 0), ("{}:1:2", -1, 2), ("{}:1:-2", 0, -2)])
def test_a_step_of_an_episode_has_frame_joints_and_scene(data, demonstrations, sensors, source, default_step, step):
    found = find_percept(source.format(data), sensors, default_step=default_step)
    np.testing.assert_array_equal(found.percept.frame, demonstrations[1].frames[step])
    np.testing.assert_allclose(found.percept.joints, demonstrations[1].joints[step], atol=1e-6)
    assert found.scene == demonstrations[1].scene


@pytest.mark.parametrize(
    ("source", "sentence"),
    [
        ("nowhere.png", "nowhere.png is neither an image file nor a step of a data set: give FILE, DATA:EPISODE or DATA:EPISODE:STEP"),
        ("nowhere:3", "nowhere:3 is neither"),
        ("{}", "is neither an image file nor a step of a data set"),
        ("{}:0:1:2", "is neither an image file nor a step of a data set"),
        ("{}:first", "does not name an episode by number"),
        ("{}:0:last", "does not name an episode by number"),
        ("{}:", "does not name an episode by number"),
        ("{}:3", "has episodes 0 to 2, not 3"),
        ("{}:-1", "has episodes 0 to 2, not -1"),
        ("{}:0:6", "has steps 0 to 5, not 6"),
        ("{}:0:-7", "has steps 0 to 5, not -7"),
    ],
)
def test_a_source_that_names_nothing_is_told(data, sensors, source, sentence):
    with pytest.raises(ValueError, match=sentence):
        find_percept(source.format(data), sensors, default_step=-1)


@pytest.mark.parametrize("content", [b"", b"this is no picture", b"\x89PNG\r\n\x1a\n and then nothing"])
def test_a_file_that_is_no_image_is_told(tmp_path, sensors, content):
    (tmp_path / "goal.png").write_bytes(content)
    with pytest.raises(ValueError, match=r"goal.png is not an image that can be read: it cannot be decoded as PNG, JPEG"):
        read_image(tmp_path / "goal.png", sensors)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_an_image_cut_short_is_told(picture, sensors, share):
    whole = picture.read_bytes()
    picture.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ValueError, match="is not an image that can be read"):
        read_image(picture, sensors)


def test_an_image_of_another_size_is_told(tmp_path, sensors):
    Image.new("L", (640, 480)).save(tmp_path / "large.png")
    with pytest.raises(ValueError, match=r"large.png is 640x480 pixels, the model sees 64x64: scale or crop it"):
        read_image(tmp_path / "large.png", sensors)


def test_a_folder_with_a_colon_in_its_name_is_found(demonstrations, sensors, tmp_path):
    save(demonstrations, tmp_path / "take:2", task="reach")
    assert find_percept(f"{tmp_path}/take:2:1", sensors, default_step=0).scene == demonstrations[1].scene


def test_a_run_that_kept_no_view_sees_its_own_size(run_folder, data, demonstrations, tmp_path):
    shutil.copytree(run_folder, tmp_path / "run")
    config = json.loads((tmp_path / "run/config.json").read_text())
    kept = read_view(tmp_path / "run")
    del config["view"]
    (tmp_path / "run/config.json").write_text(json.dumps(config))
    assert read_view(tmp_path / "run") == kept
    assert read_view("reach") == seen_by(load_model("reach").sensors)


def test_a_picture_without_depth_is_refused_by_a_model_that_sees_it(picture):
    deep = sensors_of([make_demonstration(size=(64, 64, 4))])
    with pytest.raises(ValueError, match=r"goal.png has no depth, which the model sees"):
        read_image(picture, deep)
    Image.new("RGBA", (64, 64), (1, 2, 3, 4)).save(picture)
    assert read_image(picture, deep)[0, 0].tolist() == [1, 2, 3, 4]
