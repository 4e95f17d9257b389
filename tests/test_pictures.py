"""One decoder for goals and recordings: whatever a picture holds is seen as a viewer shows it, or refused."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from planar_arm import EIGHT, PLAIN, SIZE, assert_refused_alike, checked, write_plain
from preimage.data.dataset import load, open_recordings
from preimage.data.sources import read_image
from preimage.data.view import View
from preimage.examination import Kind
from preimage.network.config import Sensors


def save_turned(frame: np.ndarray, path: Path, orientation: int) -> None:
    """As a camera that was held otherwise writes it: what is stored, turned as EXIF says, is the frame."""
    stored = {
        1: frame,
        2: frame[:, ::-1],
        3: frame[::-1, ::-1],
        4: frame[::-1],
        5: frame.swapaxes(0, 1),
        6: np.rot90(frame),
        7: frame[::-1, ::-1].swapaxes(0, 1),
        8: np.rot90(frame, -1),
    }[orientation]
    exif = Image.Exif()
    exif[0x0112] = orientation
    options = {"quality": 95} if path.suffix in (".jpg", ".webp") else {}
    Image.fromarray(np.ascontiguousarray(stored)).save(path, exif=exif, **options)


SENSORS = Sensors(*SIZE, 3, ("shoulder", "elbow"), (-3.0, -3.0), (3.0, 3.0))


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp", ".tiff"])
def test_goals_and_takes_are_seen_as_a_viewer_shows_them(tmp_path, orientation, suffix):
    frame = EIGHT[4][0][-1]
    save_turned(frame, tmp_path / f"goal{suffix}", orientation)
    assert np.abs(read_image(tmp_path / f"goal{suffix}", SENSORS).astype(int) - frame).mean() < 4
    take = tmp_path / "data/take"
    take.mkdir(parents=True)
    (tmp_path / "data/rate_hz").write_text("10")
    (take / "joints.csv").write_text(PLAIN(EIGHT[4][1][-2:]))
    for step in (0, 1):
        save_turned(frame, take / f"{step}{suffix}", orientation if step else 1)
    first, second = load(tmp_path / "data")[0].frames.astype(int)
    assert np.abs(first - second).mean() < 4


COLOUR, GREY = np.uint8([200, 100, 50]), np.uint8([90])


def flat(mode: str) -> Image.Image:
    """One colour, or one grey, in a mode of Pillow."""
    colour = Image.new("RGB", (64, 48), tuple(COLOUR.tolist()))
    if mode in ("I;16", "I;16B"):
        return Image.fromarray(np.full((48, 64), 90 * 256 + 17, ">u2" if mode.endswith("B") else "<u2"))
    if mode == "P with transparency":
        image = colour.quantize(4)
        image.info["transparency"] = 3
        return image
    return {
        "RGB": colour,
        "P": colour.quantize(4),
        "RGBA": colour.convert("RGBA"),
        "CMYK": colour.convert("CMYK"),
        "YCbCr": colour.convert("YCbCr"),
        "L": Image.new("L", (64, 48), 90),
        "LA": Image.new("LA", (64, 48), (90, 255)),
        "1": Image.new("1", (64, 48), 1),
    }[mode]


@pytest.mark.parametrize(
    ("mode", "suffix", "seen"),
    [
        ("RGB", ".png", COLOUR),
        ("P", ".png", COLOUR),
        ("P", ".bmp", COLOUR),
        ("P with transparency", ".png", COLOUR),
        ("RGBA", ".png", COLOUR),
        ("RGBA", ".webp", COLOUR),
        ("CMYK", ".jpg", COLOUR),
        ("CMYK", ".tiff", COLOUR),
        ("YCbCr", ".jpg", COLOUR),
        ("L", ".png", GREY),
        ("LA", ".png", GREY),
        ("I;16", ".png", GREY),
        ("I;16", ".tiff", GREY),
        ("1", ".png", np.uint8([255])),
    ],
)
def test_every_mode_is_seen_by_one_rule_in_goals_and_recordings(tmp_path, mode, suffix, seen):
    take = tmp_path / "data/take"
    take.mkdir(parents=True)
    (tmp_path / "data/rate_hz").write_text("10")
    (take / "joints.csv").write_text(PLAIN(EIGHT[0][1][:2]))
    flat(mode).save(take / f"0{suffix}")
    flat(mode).save(take / f"1{suffix}")
    goal = read_image(take / f"1{suffix}", SENSORS)
    recorded_frame = load(tmp_path / "data", view=View(colour="colour"))[0].frames[-1]
    for frame in (goal, recorded_frame):
        assert frame.shape == (48, 64, 3)
        assert np.abs(frame.astype(int) - seen).max() <= 4


def test_no_other_program_is_started_for_a_picture(tmp_path, monkeypatch):
    monkeypatch.setattr("subprocess.Popen", lambda *_, **__: pytest.fail("a program was started"))
    (tmp_path / "goal.png").write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 64 48\nshowpage\n")
    with pytest.raises(ValueError, match="it cannot be decoded as PNG, JPEG, WebP, BMP or TIFF"):
        read_image(tmp_path / "goal.png", SENSORS)


def test_a_picture_that_would_fill_the_memory_is_refused_before_it_is_unpacked(tmp_path, monkeypatch):
    bomb = io.BytesIO()
    Image.new("1", (13_000, 13_000)).save(bomb, "PNG")
    (tmp_path / "goal.png").write_bytes(bomb.getvalue())
    monkeypatch.setattr("PIL.ImageFile.ImageFile.load", lambda *_: pytest.fail("it was unpacked"))
    with pytest.raises(ValueError, match="it has 13000x13000 pixels, more than 64 million"):
        read_image(tmp_path / "goal.png", SENSORS)


def test_takes_that_differ_in_channels_alone_are_seen_alike(tmp_path):
    """An opaque fourth channel, a palette, grey with and without opacity: nothing is lost and nothing made up."""
    folder = write_plain(tmp_path / "data")
    for number, mode in enumerate(["RGB", "RGBA", "P", "RGB", "L", "LA"]):
        for path in (folder / f"take {number}").glob("*.png"):
            with Image.open(path) as image:
                (image.quantize(64) if mode == "P" else image.convert(mode)).save(path)
    assert checked(folder).trainable
    seen = open_recordings(folder).demonstrations
    assert {one.frames.shape[-1] for one in seen} == {3}
    np.testing.assert_array_equal(seen[1].frames, EIGHT[1][0])
    assert (seen[4].frames == seen[4].frames[..., :1]).all()


def test_colour_among_grey_is_told_and_seen_in_grey_where_asked(tmp_path):
    folder = write_plain(tmp_path / "data")
    for path in (folder / "take 0").glob("*.png"):
        with Image.open(path) as image:
            image.convert("L").save(path)
    assert_refused_alike(folder, "take 1, step 0 has a frame in colour, the first is in grey: look at all alike, by --view.colour grey")
    assert {one.frames.shape[-1] for one in load(folder, view=View(colour="grey"))} == {1}


@pytest.mark.parametrize("opacity", [0, 128, 255])
def test_a_goal_that_is_transparent_in_places_is_refused(tmp_path, opacity):
    cut = np.dstack([EIGHT[0][0][-1], np.full(SIZE, 255, np.uint8)])
    cut[:10, :, 3] = opacity
    Image.fromarray(cut).save(tmp_path / "goal.png")
    if opacity == 255:
        np.testing.assert_array_equal(read_image(tmp_path / "goal.png", SENSORS), EIGHT[0][0][-1])
    else:
        with pytest.raises(ValueError, match="is transparent in places"):
            read_image(tmp_path / "goal.png", SENSORS)


def test_twelve_bits_in_files_of_sixteen_are_told(tmp_path):
    folder = write_plain(tmp_path / "data")
    for path in folder.rglob("*.png"):
        with Image.open(path) as image:
            grey = np.asarray(image.convert("L")).astype(np.uint16)
        Image.fromarray(16 * grey).save(path)
    (finding,) = [finding for finding in checked(folder).findings if finding.kind is Kind.BLANK]
    assert "it wrote fewer bits than its files have: the brightest pixel is 1" in finding.help
