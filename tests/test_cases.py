"""Small recordings of the kinds that people report, and what is right for each: `check` and `train` agree on all of them.

A planar arm of two links, seen from above, goes to a goal and rests there.
"""

import csv
import io
import json
import os
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image, ImageDraw

from preimage import cli
from preimage.data.angles import find_wraps, unwrapped
from preimage.data.dataset import load, open_recordings, read_episodes
from preimage.data.sources import read_image
from preimage.data.view import View
from preimage.examination import Examination, Kind, examine
from preimage.network.config import Sensors
from recordings import edit_json, write_rows, write_video

TOP, INFO, LINES = "observation.images.top", "meta/info.json", "meta/episodes.jsonl"
NAMES = ["shoulder", "elbow"]
SIZE = 48, 64

Recorded = list[tuple[np.ndarray, np.ndarray]]
"""Frames (T, H, W, C) and joints (T, J) of each episode."""


def seen_from_above(joints: np.ndarray) -> np.ndarray:
    height, width = SIZE
    image = Image.new("RGB", (2 * width, 2 * height), (60, 70, 60))
    draw = ImageDraw.Draw(image)
    draw.rectangle([0, 0, width // 3, height // 4], fill=(120, 60, 20))
    x, y, angle, length = float(width), 1.9 * height, np.pi / 2, 0.8 * height
    for joint in joints:
        angle += joint
        x, y, before = x + length * np.cos(angle), y - length * np.sin(angle), (x, y)
        draw.line([*before, x, y], fill=(230, 210, 60), width=height // 8)
    draw.ellipse([x - height / 8, y - height / 8, x + height / 8, y + height / 8], fill=(220, 30, 30))
    return np.asarray(image.resize((width, height), Image.Resampling.BILINEAR))


@cache
def recorded(count: int = 8, num_steps: int = 20) -> Recorded:
    rng, episodes = np.random.default_rng(0), []
    for _ in range(count):
        start, goal = np.array([0.6, 0.9]), np.array([rng.uniform(-0.9, 0.4), rng.uniform(-1.2, 0.6)])
        way = np.clip(np.arange(num_steps) / (num_steps - 8), 0, 1)[:, None]
        joints = start + (10 * way**3 - 15 * way**4 + 6 * way**5) * (goal - start) + rng.normal(0, 1e-3, (num_steps, 2))
        episodes.append((np.stack([seen_from_above(each) for each in joints]), joints))
    return episodes


EIGHT = recorded()


def encoded(frame: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(frame).save(file, "PNG")
    return file.getvalue()


def with_feature(info: dict, state: str, camera: str, names: object, shape: list[int]) -> dict:
    vector = {"dtype": "float32", "shape": shape, "names": names}
    number = {"dtype": "int64", "shape": [1], "names": None}
    picture = {"dtype": "image", "shape": [*SIZE, 3], "names": ["height", "width", "channels"]}
    numbers = dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), number)
    return info | {"features": {camera: picture, state: vector, "action": vector, "timestamp": number | {"dtype": "float32"}, **numbers}}


def rows_of(episode: int, frames: np.ndarray, joints: np.ndarray, *, state: str, camera: str, shape: list[int]) -> list[dict]:
    vectors = joints.reshape(len(joints), *shape).tolist()
    return [
        {state: vectors[step], "timestamp": step / 10, "frame_index": step, "episode_index": episode}
        | {camera: {"bytes": encoded(frames[step]), "path": None}}
        for step in range(len(joints))
    ]


def write_v2(
    folder: Path,
    episodes: Recorded = EIGHT,
    *,
    version: str = "v2.1",
    names: object = None,
    shape: list[int] | None = None,
    state: str = "observation.state",
    camera: str = TOP,
) -> Path:
    """A set with a file an episode, its pictures among the data."""
    info = {"codebase_version": version, "fps": 10, "total_episodes": len(episodes), "chunks_size": 1000}
    info["data_path"] = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
    info = with_feature(info, state, camera, names or NAMES, shape or [episodes[0][1].shape[1]])
    (folder / "meta").mkdir(parents=True)
    (folder / INFO).write_text(json.dumps(info))
    for number, (frames, joints) in enumerate(episodes):
        rows = rows_of(number, frames, joints, state=state, camera=camera, shape=shape or [joints.shape[1]])
        write_rows(folder / f"data/chunk-000/episode_{number:06d}.parquet", rows)
    lines = [{"episode_index": number, "tasks": ["reach"], "length": len(joints)} for number, (_, joints) in enumerate(episodes)]
    (folder / LINES).write_text("".join(json.dumps(line) + "\n" for line in lines))
    return folder


def into_videos(folder: Path, episodes: Recorded = EIGHT) -> Path:
    """The pictures move out of the data, into a video an episode."""
    path = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
    edit_json(folder / INFO, lambda info: info.update(video_path=path) or info["features"][TOP].update(dtype="video"))
    for number, (frames, _) in enumerate(episodes):
        data = folder / f"data/chunk-000/episode_{number:06d}.parquet"
        pq.write_table(pq.read_table(data).drop_columns([TOP]), data)
        write_video(folder / f"videos/chunk-000/{TOP}/episode_{number:06d}.mp4", list(frames))
    return folder


def write_v3(folder: Path, episodes: Recorded, *, order: list[int] | None = None) -> Path:
    """A set with all episodes in one file."""
    files = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    info = {"codebase_version": "v3.0", "fps": 10, "total_episodes": len(episodes), "data_path": f"data/{files}", "video_path": None}
    (folder / "meta").mkdir(parents=True)
    (folder / INFO).write_text(json.dumps(with_feature(info, "observation.state", TOP, NAMES, [2])))
    rows = [rows_of(number, *each, state="observation.state", camera=TOP, shape=[2]) for number, each in enumerate(episodes)]
    write_rows(folder / "data/chunk-000/file-000.parquet", [row for each in rows for row in each])
    where = {"data/chunk_index": 0, "data/file_index": 0, "tasks": ["reach"]}
    index = [{"episode_index": number, "length": len(joints), **where} for number, (_, joints) in enumerate(episodes)]
    write_rows(folder / "meta/episodes/chunk-000/file-000.parquet", [index[number] for number in order or range(len(index))])
    return folder


def as_table(names: list[str], columns: Callable[[int, np.ndarray], list], separator: str = ",") -> Callable[[np.ndarray], str]:
    def text(joints: np.ndarray) -> str:
        file = io.StringIO()
        writer = csv.writer(file, delimiter=separator)
        writer.writerow(names)
        writer.writerows(columns(step, row) for step, row in enumerate(joints))
        return file.getvalue()

    return text


PLAIN = as_table(NAMES, lambda _, joints: joints.tolist())


def write_plain(
    folder: Path,
    table: Callable[[np.ndarray], str] = PLAIN,
    *,
    rate: str | None = "10",
    suffix: str = ".png",
    encoding: str = "utf-8",
    episodes: Recorded = EIGHT,
) -> Path:
    folder.mkdir(parents=True)
    if rate:
        (folder / "rate_hz").write_text(rate)
    for number, (frames, joints) in enumerate(episodes):
        take = folder / f"take {number}"
        take.mkdir()
        (take / "joints.csv").write_bytes(table(joints).encode(encoding))
        for step, frame in enumerate(frames):
            Image.fromarray(frame).save(take / f"{step:04d}{suffix}")
    return folder


def checked(folder: Path, view: View | None = None, **which) -> Examination:
    return examine(read_episodes(folder, view=view or View(), **which), joints_chosen=view is not None and view.joints is not None)


def kinds(examination: Examination) -> set[Kind]:
    return {finding.kind for finding in examination.findings}


def assert_read_right(folder: Path, names: tuple[str, ...] = ("shoulder", "elbow"), view: View | None = None) -> None:
    """Both `check` and `train` take all eight episodes, as they were recorded."""
    assert checked(folder, view).trainable
    opened = open_recordings(folder, view=view or View())
    assert len(opened.demonstrations) == 8
    for one, (frames, joints) in zip(opened.demonstrations, EIGHT, strict=True):
        assert (one.joint_names, one.rate_hz) == (names, 10.0)
        np.testing.assert_allclose(one.joints, joints, atol=1e-5)
        assert np.abs(one.frames.astype(int) - frames).mean() < 4


def refused_alike(folder: Path, sentence: str, **which) -> None:
    """`train` gives the sentence; `check` gives it too, or finds it at least."""
    with pytest.raises(ValueError, match=sentence):
        open_recordings(folder, **which)
    refusal, examination = None, None
    try:
        examination = checked(folder, which.get("view"))
    except ValueError as error:
        refusal = str(error)
    assert re.search(sentence, refusal) if refusal else examination and not examination.trainable


# Angles that wrap


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
    refused_alike(folder, "shoulder starts and turns all the way round, .*: leave it out by --view.joints elbow")
    assert load(folder, view=View(joints=("elbow",)))[0].joint_names == ("elbow",)


# Clocks


CLOCKS = {
    "timestamp": 1.0,
    "time": 1.0,
    "Time_s": 1.0,
    "stamp": 1.0,
    "t": 1.0,
    "time_ms": 1e3,
    "Time [ms]": 1e3,
    "timestamp_us": 1e6,
    "stamp_ns": 1e9,
    "elapsed_ns": 1e9,
}


@pytest.mark.parametrize("name", CLOCKS)
@pytest.mark.parametrize("column", [0, 1, 2])
@pytest.mark.parametrize("rate", ["10", None])
def test_a_clock_is_no_joint_in_any_column_and_unit(tmp_path, name, column, rate):
    names, now = [*NAMES[:column], name, *NAMES[column:]], 0 if "ns" in name else 1_700_000_000

    def columns(step: int, joints: np.ndarray) -> list:
        values = [f"{value:.6f}" for value in joints]
        return [*values[:column], f"{(now + step / 10) * CLOCKS[name]:.3f}", *values[column:]]

    folder = write_plain(tmp_path / "data", as_table(names, columns), rate=rate, episodes=EIGHT[:1])
    (one,) = load(folder)
    assert (one.joint_names, one.rate_hz) == (("shoulder", "elbow"), 10.0)
    (episode,) = read_episodes(folder)
    np.testing.assert_allclose(np.diff(episode.timestamps_s), 0.1, atol=1e-3)


def test_a_clock_of_ros_in_two_columns_and_a_date_are_clocks(tmp_path):
    ros = as_table(["header.stamp.secs", "header.stamp.nsecs", *NAMES], lambda step, joints: [step // 10, step % 10 * 10**8, *joints])
    assert_read_right(write_plain(tmp_path / "ros", ros, rate=None))
    date = as_table(["time", *NAMES], lambda step, joints: [f"2024-05-01 12:00:{step // 10:02d}.{step % 10}00", *joints])
    assert_read_right(write_plain(tmp_path / "date", date, rate=None))


def test_a_clock_without_a_unit_counts_in_that_which_agrees_with_the_rate(tmp_path):
    table = as_table(["timestamp", *NAMES], lambda step, joints: [100 * step, *joints])
    folder = write_plain(tmp_path / "data", table)
    assert_read_right(folder)
    assert Kind.CLOCK not in kinds(checked(folder))


@pytest.mark.parametrize(("unit", "count"), [("milliseconds", 100), ("microseconds", 100_000), ("nanoseconds", 10**8)])
@pytest.mark.parametrize("name", ["time_s", "timestamp", "time"])
def test_a_rate_that_no_robot_has_is_refused_with_the_unit_to_check(tmp_path, unit, count, name):
    table = as_table([name, *NAMES], lambda step, joints: [1_700_000_000 * 10**6 + count * step, *joints])
    short = {"milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns"}[unit]
    refused_alike(
        write_plain(tmp_path / "data", table, rate=None, episodes=EIGHT[:1]),
        f"as {name} is in seconds: if it counts {unit}, call it time_{short}",
    )


@pytest.mark.parametrize("rate", ["0.01", "33333", "0", "-10", "nan", "fast"])
def test_a_rate_outside_of_what_robots_have_is_refused(tmp_path, rate):
    refused_alike(
        write_plain(tmp_path / "data", rate=rate), "it should hold the number of pictures a second \\(rates are 0.2 to 1000 Hz\\)"
    )
    folder = write_v2(tmp_path / "lerobot", EIGHT[:1])
    edit_json(folder / INFO, lambda info: info.update(fps=float(rate) if rate != "fast" else rate))
    refused_alike(folder, "it should be the number of steps a second; rates are 0.2 to 1000 Hz")


@pytest.mark.parametrize("name", ["frame", "row", "seq", "trigger"])
@pytest.mark.parametrize("layout", ["plain", "v2"])
def test_a_column_that_rises_evenly_is_asked_about(tmp_path, name, layout):
    if layout == "plain":
        folder = write_plain(tmp_path / "data", as_table([*NAMES, name], lambda step, joints: [*joints, 3 * step]))
    else:
        counted = [(frames, np.c_[joints, np.arange(len(joints)) / 7]) for frames, joints in EIGHT]
        folder = write_v2(tmp_path / "data", counted, names=[*NAMES, name])
    refused_alike(folder, f"{name} rises evenly in every episode, .*: leave it out by --view.joints shoulder elbow")
    assert_read_right(folder, view=View(joints=("shoulder", "elbow")))


def test_a_clock_within_the_state_is_left_out(tmp_path):
    timed = [(frames, np.c_[np.arange(len(joints)) / 10, joints]) for frames, joints in EIGHT]
    folder = write_v2(tmp_path / "data", timed, names=["timestamp", *NAMES])
    assert_read_right(folder)
    assert "left out as a clock: timestamp" in open_recordings(folder).summary[-1]
    assert Kind.COUNTER in kinds(checked(folder))


# Pictures


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


# Episodes


@pytest.mark.parametrize("told", [False, True])
def test_episodes_taken_out_of_the_index_are_not_there(tmp_path, told):
    folder = write_v2(tmp_path / "data")
    lines = (folder / LINES).read_text().splitlines(keepends=True)
    (folder / LINES).write_text("".join(line for number, line in enumerate(lines) if number not in (2, 5)))
    if told:
        edit_json(folder / INFO, lambda info: info.update(total_episodes=6))
    opened = open_recordings(folder)
    assert opened.episodes == (0, 1, 3, 4, 6, 7)
    assert [episode.index for episode in read_episodes(folder)] == [0, 1, 3, 4, 6, 7]
    np.testing.assert_allclose(opened.demonstrations[2].joints, EIGHT[3][1], atol=1e-6)
    assert checked(folder).trainable


@pytest.mark.parametrize("version", ["v2", "v3"])
def test_an_index_in_any_order_is_read(tmp_path, version):
    order = [3, 1, 0, 2, 7, 5, 6, 4]
    if version == "v3":
        return assert_read_right(write_v3(tmp_path / "data", EIGHT, order=order))
    folder = write_v2(tmp_path / "data")
    lines = (folder / LINES).read_text().splitlines()
    (folder / LINES).write_text("\ufeff" + "\n".join(lines[number] for number in order) + "\n\n")
    assert_read_right(folder)


def test_rows_in_any_order_are_put_in_order(tmp_path):
    folder = write_v2(tmp_path / "data")
    path = folder / "data/chunk-000/episode_000003.parquet"
    pq.write_table(pq.read_table(path).take(np.random.default_rng(0).permutation(20)), path)
    assert_read_right(folder)


def test_an_episode_that_is_listed_twice_is_refused(tmp_path):
    folder = write_v2(tmp_path / "data")
    lines = (folder / LINES).read_text()
    (folder / LINES).write_text(lines + lines.splitlines()[3] + "\n")
    refused_alike(folder, "lists episode 3 twice")


def one_bad_episode(place: Path) -> Path:
    folder = into_videos(write_v2(place))
    write_video(folder / f"videos/chunk-000/{TOP}/episode_000003.mp4", list(EIGHT[3][0][:-1]))
    return folder


def test_a_bad_episode_can_be_left_out_and_the_sentence_says_how(tmp_path):
    folder = one_bad_episode(tmp_path / "data")
    refused_alike(folder, "episode 3 has 19 frames for 20 steps of joints: .* leave that episode out \\(--without-episodes 3\\)")
    assert "--without-episodes 3" in " ".join(finding.help for finding in checked(folder).findings)
    assert checked(folder, without=(3,)).trainable
    assert open_recordings(folder, without=(3,)).episodes == (0, 1, 2, 4, 5, 6, 7)
    assert open_recordings(folder, only=(1, 2)).episodes == (1, 2)
    with pytest.raises(ValueError, match="has no episode 9: it has 0 to 7"):
        open_recordings(folder, without=(9,))
    with pytest.raises(ValueError, match=r"no episode of .* is left"):
        open_recordings(folder, only=(3,), without=(3,))


def test_the_run_keeps_which_episodes_it_was_given(tmp_path, capsys):
    folder, run = one_bad_episode(tmp_path / "data"), str(tmp_path / "run")
    words = ["--size", "tiny", "--updates", "1"]
    cli.main(["train", str(folder), "--out", run, *words, "--without-episodes", "3", "--hold-out", "3"])
    data = json.loads((tmp_path / "run/config.json").read_text())["data"]
    assert (data["episodes"], data["held_out"]) == ([0, 1, 2, 4, 5, 6, 7], [2, 6])
    cli.main(["train", str(folder), "--out", run, "--resume"])
    capsys.readouterr()
    quick = ["--iterations", "1", "--horizon", "4", "--out", str(tmp_path / "result.json")]
    cli.main(["evaluate", run, "--data", str(folder), *quick])
    assert capsys.readouterr().out.startswith("2 episodes never trained on: 2, 6\n")
    cli.main(["evaluate", run, "--data", str(folder), "--episodes", "5", "6", *quick])
    assert capsys.readouterr().out.startswith("1 episode never trained on: 6\n")
    cli.main(["check", str(folder), "--without-episodes", "3", "--out", str(tmp_path / "check.html")])
    assert json.loads((tmp_path / "run/config.json").read_text())["task"] == "reach"


# Layouts of converters


@pytest.mark.parametrize("version", ["v2.0", "v2.1"])
def test_v20_is_read_as_v21(tmp_path, version):
    assert_read_right(into_videos(write_v2(tmp_path / "data", version=version)))


@pytest.mark.parametrize(
    ("names", "shape", "read"),
    [
        (["state"], [2], ("state_0", "state_1")),
        ({"motors": ["state"]}, [2], ("state_0", "state_1")),
        (["joint", "joint"], [2], ("joint_0", "joint_1")),
        ({"motors": NAMES}, [2], ("shoulder", "elbow")),
        ({"arm": ["shoulder"], "wrist": ["elbow"]}, [2], ("shoulder", "elbow")),
        ({"elbow": 1, "shoulder": 0}, [2], ("shoulder", "elbow")),
        ([["shoulder"], ["elbow"]], [2], ("shoulder", "elbow")),
        (NAMES, [1, 2], ("shoulder", "elbow")),
        ([NAMES], [1, 2], ("shoulder", "elbow")),
        (["state"], [2, 1], ("state_0", "state_1")),
    ],
)
def test_names_and_shapes_of_converters_are_read(tmp_path, names, shape, read):
    assert_read_right(write_v2(tmp_path / "data", names=names, shape=shape), read)


@pytest.mark.parametrize(("state", "asked"), [("state", "state"), ("observation.states.joint.position", "joint.position")])
def test_the_state_may_have_another_name(tmp_path, state, asked):
    folder = write_v2(tmp_path / "data", state=state, camera="image" if state == "state" else TOP)
    refused_alike(folder, f"has no observation.state: choose one or more of {state}, action by --view.state")
    assert_read_right(folder, view=View(state=(asked,)))
    with pytest.raises(ValueError, match=f"has no column of numbers velocity: it has {state}, action"):
        load(folder, view=View(state=("velocity",)))


def test_the_state_may_be_in_parts(tmp_path):
    folder = write_v2(tmp_path / "data")
    for path in folder.glob("data/*/*.parquet"):
        table = pq.read_table(path)
        joints = np.array(table["observation.state"].to_pylist())
        parts = {f"observation.{name}": pa.array(joints[:, [column]].tolist()) for column, name in enumerate(("upper", "lower"))}
        for name, column in parts.items():
            table = table.append_column(name, column)
        pq.write_table(table.drop_columns(["observation.state"]), path)

    def split(info: dict) -> None:
        del info["features"]["observation.state"]
        for name in ("upper", "lower"):
            info["features"][f"observation.{name}"] = {"dtype": "float32", "shape": [1], "names": ["angle"]}

    edit_json(folder / INFO, split)
    assert_read_right(folder, ("upper_angle", "lower_angle"), View(state=("upper", "lower")))


def test_a_camera_has_a_short_name(tmp_path):
    assert_read_right(write_v2(tmp_path / "data"), view=View(camera="top"))


def test_the_words_of_v30_may_stand_in_the_patterns_of_v21(tmp_path):
    folder = into_videos(write_v2(tmp_path / "data"))
    info = folder / INFO
    info.write_text(info.read_text().replace("{episode_chunk:03d}", "{chunk_index:03d}"))
    assert_read_right(folder)


# Causes


@pytest.mark.parametrize("version", ["v2", "v3", "plain"])
def test_a_git_lfs_pointer_is_called_so(tmp_path, version):
    folder = {
        "v2": lambda place: into_videos(write_v2(place)),
        "v3": lambda place: write_v3(place, EIGHT),
        "plain": write_plain,
    }[version](tmp_path / "data")
    for path in (*folder.rglob("*.parquet"), *folder.rglob("*.mp4"), *folder.rglob("*.png")):
        path.write_text(f"version https://git-lfs.github.com/spec/v1\noid sha256:{'7' * 64}\nsize 12345\n")
    refused_alike(folder, "is a Git LFS pointer, .*git lfs pull")


@pytest.mark.parametrize("separator", [";", "\t", ","])
@pytest.mark.parametrize("decimal", [",", "."])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_the_table_of_a_spreadsheet_is_read(tmp_path, separator, decimal, encoding):
    table = as_table(NAMES, lambda _, joints: [f"{joint:.6f}".replace(".", decimal) for joint in joints], separator)
    folder = write_plain(tmp_path / "data", lambda joints: table(joints) + f"{separator}\n  \n", encoding=encoding)
    assert_read_right(folder)


def test_decimal_commas_between_commas_are_told(tmp_path):
    folder = write_plain(tmp_path / "data", lambda _: "shoulder,elbow\n0,5,1,2\n")
    refused_alike(folder, "row 1 has 4 columns, the head 2: .*where commas stand before decimals, semicolons have to separate")


@pytest.mark.parametrize("suffix", [".bmp", ".webp", ".tiff", ".jpg"])
def test_pictures_may_be_of_any_format_of_goals(tmp_path, suffix):
    assert_read_right(write_plain(tmp_path / "data", suffix=suffix))


def test_pictures_in_a_subfolder_are_told(tmp_path):
    folder = write_plain(tmp_path / "data")
    for take in folder.glob("take *"):
        (take / "images").mkdir()
        for path in list(take.glob("*.png")):
            path.rename(take / "images" / path.name)
    refused_alike(folder, "take 0 has no picture beside joints.csv \\(there is a folder images with 20\\)")
    faults = " ".join(finding.what for finding in checked(folder).findings)
    assert "take 0 has no picture beside joints.csv (there is a folder images with 20)" in faults


def test_a_folder_of_notes_is_no_episode(tmp_path):
    folder = write_plain(tmp_path / "data")
    (folder / "notes").mkdir()
    (folder / "notes/friday.txt").write_text("the cup fell over")
    assert_read_right(folder)


def test_a_trained_model_is_no_data_set(tmp_path):
    (tmp_path / "config.json").write_text("{}")
    with pytest.raises(ValueError, match=r"holds a trained model .* and no recordings"):
        load(tmp_path)


@pytest.mark.parametrize("there", [True, False])
def test_pictures_by_path_are_read_or_named(tmp_path, there):
    folder = write_v2(tmp_path / "data")
    for path in folder.glob("data/*/*.parquet"):
        rows = pq.read_table(path).to_pylist()
        for row in rows:
            name = f"images/{TOP}/episode_{row['episode_index']:06d}/frame_{row['frame_index']:06d}.png"
            if there:
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes(row[TOP]["bytes"])
            row[TOP] = {"bytes": None, "path": name}
        write_rows(path, rows)
    if there:
        assert_read_right(folder)
    else:
        refused_alike(folder, "has no picture: the table names a file \\(images/.*\\) instead of holding the picture")


def test_a_picture_outside_of_the_folder_is_not_read(tmp_path):
    (tmp_path / "secret.png").write_bytes(encoded(EIGHT[0][0][0]))
    for place, name in ((tmp_path / "up", "../secret.png"), (tmp_path / "away", str(tmp_path / "secret.png"))):
        folder = write_v2(place)
        for path in folder.glob("data/*/*.parquet"):
            rows = pq.read_table(path).to_pylist()
            for row in rows:
                row[TOP] = {"bytes": None, "path": name}
            write_rows(path, rows)
        refused_alike(folder, "only files in the folder of the data set are read")


# What info.json says is not believed


@pytest.mark.parametrize(
    "pattern",
    [
        "/etc/passwd",
        "../other/{episode_index}.parquet",
        "data/../../{episode_index}.parquet",
        "data/{episode_chunk:0999999999d}.parquet",
        "data/{episode_index:>99999}.parquet",
        "data/{episode_index.__class__}.parquet",
        "data/{episode_index!r}.parquet",
        "data/{0}.parquet",
        "data/{episode_index",
        "data/\0.parquet",
        "d" * 1000,
        "",
        7,
        None,
    ],
)
def test_a_pattern_that_leads_astray_is_refused(tmp_path, pattern):
    folder = write_v2(tmp_path / "data", EIGHT[:1])
    edit_json(folder / INFO, lambda info: info.update(data_path=pattern))
    with pytest.raises(ValueError, match=r"has data_path|is not a regular file"):
        load(folder)


@pytest.mark.parametrize("count", [10**8, 10**18])
def test_a_number_of_episodes_is_not_believed(tmp_path, count):
    folder = write_v2(tmp_path / "data")
    edit_json(folder / INFO, lambda info: info.update(total_episodes=count))
    assert_read_right(folder)


@pytest.mark.parametrize("shape", [[10**9], [10**5, 10**5]])
@pytest.mark.parametrize("names", [None, ["state"]])
def test_a_state_of_a_thousand_million_values_is_refused(tmp_path, shape, names):
    folder = write_v2(tmp_path / "data")
    edit_json(folder / INFO, lambda info: info["features"]["observation.state"].update(shape=shape, names=names))
    refused_alike(folder, "1024 values a step are the most that can be joints")


@pytest.mark.parametrize("name", [INFO, LINES, "data/chunk-000/episode_000002.parquet", "take/joints.csv", "take/0.png"])
def test_a_named_pipe_is_not_waited_for(tmp_path, name):
    folder = write_plain(tmp_path / "data") if "take" in name else write_v2(tmp_path / "data")
    path = folder / name.replace("take", "take 2").replace("0.png", "0000.png")
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(ValueError, match="is not a regular file"):
        load(folder)


def test_json_nested_without_end_is_refused(tmp_path):
    folder = write_v2(tmp_path / "data")
    (folder / INFO).write_text("[" * 100_000)
    refused_alike(folder, "info.json is not JSON")


# What cannot be learned from is refused by both


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda frames, joints: (frames, 0 * joints), "no joint ever moves"),
        (lambda frames, joints: (0 * frames, joints), "no frame shows anything"),
        (lambda frames, joints: (np.repeat(frames[:1], len(frames), 0), joints), "the frames stay the same while the arm moves"),
    ],
)
def test_what_check_calls_a_fault_train_refuses(tmp_path, refused, change, sentence):
    folder = write_v2(tmp_path / "data", [change(frames, joints) for frames, joints in EIGHT])
    assert not checked(folder).trainable
    code, said = refused("train", folder, "--out", tmp_path / "run", "--size", "tiny", "--updates", 1)
    assert code == 2
    assert sentence in said


def test_first_frames_of_the_episode_before_are_named(tmp_path):
    episodes = recorded(24)
    stale = [
        (np.concatenate([episodes[number - 1][0][-1:] if number else frames[:1], frames[1:]]), joints)
        for number, (frames, joints) in enumerate(episodes)
    ]
    (finding,) = [finding for finding in checked(write_v3(tmp_path / "data", stale)).findings if finding.kind is Kind.STALE]
    assert finding.places == tuple((number, 0) for number in range(1, 24))
