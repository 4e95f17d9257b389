"""Small recordings of a planar arm of two links, seen from above, that goes to a goal and rests there; and what is right for them.

Written as converters and recorders write, and judged as `check` and `train` judge them, which have to agree.
"""

import csv
import io
import json
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image, ImageDraw

from preimage.data.dataset import open_recordings, read_episodes
from preimage.data.view import View
from preimage.examination import Examination, Kind, examine
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


def assert_refused_alike(folder: Path, sentence: str, **which) -> None:
    """`train` gives the sentence; `check` gives it too, or finds it at least."""
    with pytest.raises(ValueError, match=sentence):
        open_recordings(folder, **which)
    refusal, examination = None, None
    try:
        examination = checked(folder, which.get("view"))
    except ValueError as error:
        refusal = str(error)
    assert re.search(sentence, refusal) if refusal else examination and not examination.trainable
