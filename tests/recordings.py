"""Recordings for the tests: noise that any reader must bring back, and folders as others write them."""

import io
import itertools
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from preimage.records import Demonstration, Scene

DATA, INDEX, INFO = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet", "meta/info.json"
CAMERA, WRIST = "observation.images.camera", "observation.images.wrist"
SCENE = Scene("reach", (0.1, -0.2), {"goal": (0.5, 0.25, 0.03), "marker": (0.1, 0.0, 0.0)})
CODEC = next(name for name in ("libx264", "libsvtav1", "mpeg4") if name in av.codecs_available)


def noise(*, seed=0, num_steps=4, size=(6, 8, 1), num_joints=2, rate_hz=10.0, scene=None) -> Demonstration:
    rng = np.random.default_rng(seed)
    frames = rng.integers(0, 256, (num_steps, *size), np.uint8)
    joints = rng.normal(size=(num_steps, num_joints)).astype(np.float32).astype(np.float64)
    return Demonstration(frames, joints, rate_hz, tuple(f"joint {number}" for number in range(num_joints)), scene)


def assert_equal(left: list[Demonstration], right: list[Demonstration]) -> None:
    assert len(left) == len(right)
    for one, other in zip(left, right, strict=True):
        np.testing.assert_array_equal(one.frames, other.frames)
        np.testing.assert_array_equal(one.joints, other.joints)
        assert (one.frames.dtype, one.joints.dtype) == (other.frames.dtype, other.joints.dtype)
        assert (one.rate_hz, one.joint_names, one.scene) == (other.rate_hz, other.joint_names, other.scene)


def edit_json(path: Path, change) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def edit_rows(path: Path, change) -> None:
    """`change` the list of rows of a parquet file in place; columns keep their types."""
    table = pq.read_table(path)
    rows = table.to_pylist()
    change(rows)
    pq.write_table(pa.Table.from_pylist(rows, table.schema), path)


def png(size=(8, 6), mode="RGB") -> bytes:
    file = io.BytesIO()
    Image.new(mode, size).save(file, "PNG")
    return file.getvalue()


def noises() -> list[Demonstration]:
    return [noise(seed=seed, num_steps=3 + seed, scene=SCENE) for seed in range(3)]


# Folders as others write them: each shade of grey is an episode and a step, and survives a lossy video


def shade(episode: int, step: int) -> int:
    return 20 + 60 * episode + 8 * step


def shades(episode: int, length: int, size: tuple[int, int]) -> list[np.ndarray]:
    """Frames of one colour each, the left half in red."""
    frames = []
    for step in range(length):
        frame = np.full((*size, 3), shade(episode, step), np.uint8)
        frame[:, : size[1] // 2] = 200, 20, 20
        frames.append(frame)
    return frames


def joints_of(episode: int, length: int) -> np.ndarray:
    """Two joints that move, and between them one that does not."""
    way = np.arange(length) / 10
    return np.stack([way + episode, np.full(length, 0.5), -way], axis=1)


NAMES = ["pan", "frozen", "lift"]


def write_video(path: Path, frames: Sequence[np.ndarray], *, rate_hz: int = 10, between_keys: int = 3) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(CODEC, rate=rate_hz, options={"crf": "5", "g": str(between_keys)})
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


def info_of(version: str, lengths: Sequence[int], size: tuple[int, int], data_path: str, video_path: str) -> dict:
    number = {"dtype": "int64", "shape": [1], "names": None}
    return {
        "codebase_version": version,
        "fps": 10,
        "total_episodes": len(lengths),
        "chunks_size": 1000,
        "data_path": data_path,
        "video_path": video_path,
        "features": {
            "observation.state": {"dtype": "float32", "shape": [3], "names": [NAMES]},
            CAMERA: {"dtype": "video", "shape": [*size, 3], "names": ["height", "width", "channel"]},
            "timestamp": {"dtype": "float32", "shape": [1], "names": None},
            "episode_index": number,
        },
    }


def rows_of(episode: int, length: int) -> list[dict]:
    joints = joints_of(episode, length).tolist()
    return [{"observation.state": joints[step], "timestamp": step / 10, "episode_index": episode} for step in range(length)]


def write_rows(path: Path, rows: list[dict]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.Table.from_pylist(rows), path)


def write_v21(folder: Path, *, lengths: Sequence[int] = (5, 4), size: tuple[int, int] = (96, 160)) -> Path:
    """A LeRobotDataset v2.1 with a video an episode."""
    data, video = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}", "videos/chunk-{episode_chunk:03d}/{video_key}/"
    info = info_of("v2.1", lengths, size, f"{data}.parquet", video + "episode_{episode_index:06d}.mp4")
    (folder / "meta").mkdir(parents=True)
    (folder / INFO).write_text(json.dumps(info))
    lines = [json.dumps({"episode_index": episode, "tasks": ["pick"], "length": length}) for episode, length in enumerate(lengths)]
    (folder / "meta/episodes.jsonl").write_text("\n".join(lines) + "\n")
    for episode, length in enumerate(lengths):
        write_rows(folder / f"data/chunk-000/episode_{episode:06d}.parquet", rows_of(episode, length))
        write_video(folder / f"videos/chunk-000/{CAMERA}/episode_{episode:06d}.mp4", shades(episode, length, size))
    return folder


def write_v30(folder: Path, *, lengths: Sequence[int] = (5, 4, 6), size: tuple[int, int] = (96, 160)) -> Path:
    """A LeRobotDataset v3.0 with all episodes in one video."""
    files = "chunk-{chunk_index:03d}/file-{file_index:03d}"
    info = info_of("v3.0", lengths, size, f"data/{files}.parquet", "videos/{video_key}/" + f"{files}.mp4")
    (folder / "meta").mkdir(parents=True)
    (folder / INFO).write_text(json.dumps(info))
    starts = [0, *itertools.accumulate(lengths)]
    places = {"data/chunk_index": 0, "data/file_index": 0, f"videos/{CAMERA}/chunk_index": 0, f"videos/{CAMERA}/file_index": 0}
    index = [
        {"episode_index": episode, "length": length, "tasks": ["pick"]}
        | places
        | {f"videos/{CAMERA}/from_timestamp": starts[episode] / 10, f"videos/{CAMERA}/to_timestamp": starts[episode + 1] / 10}
        for episode, length in enumerate(lengths)
    ]
    write_rows(folder / INDEX, index)
    write_rows(folder / DATA, [row for episode, length in enumerate(lengths) for row in rows_of(episode, length)])
    frames = [frame for episode, length in enumerate(lengths) for frame in shades(episode, length, size)]
    write_video(folder / f"videos/{CAMERA}/chunk-000/file-000.mp4", frames)
    return folder


def write_plain(folder: Path, *, lengths: Sequence[int] = (5, 4), size: tuple[int, int] = (96, 160)) -> Path:
    """A folder an episode, its rate in a file."""
    for episode, length in enumerate(lengths):
        take = folder / f"take {episode + 8}"  # "take 10" comes after "take 9"
        take.mkdir(parents=True)
        rows = (",".join(map(str, row)) for row in joints_of(episode, length).tolist())
        (take / "joints.csv").write_text("\n".join([",".join(NAMES), *rows]) + "\n")
        for step, frame in enumerate(shades(episode, length, size)):
            Image.fromarray(frame).save(take / f"{step + 8}.png")
    (folder / "rate_hz").write_text("10\n")
    return folder


WRITERS: dict[str, Callable[..., Path]] = {"v2.1": write_v21, "v3.0": write_v30, "plain": write_plain}


# Damages


def change_info(**changes):
    return lambda folder: edit_json(folder / INFO, lambda info: info.update(changes))


def write(path, content: bytes):
    return lambda folder: (folder / path).write_bytes(content)


def remove(path):
    return lambda folder: (folder / path).unlink()


def drop_column(path, name):
    return lambda folder: pq.write_table(pq.read_table(folder / path).drop_columns([name]), folder / path)
