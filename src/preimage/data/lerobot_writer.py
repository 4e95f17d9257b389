"""Demonstrations to disk: a LeRobotDataset v3.0, so that LeRobot reads, shows and replays them as they are.

    meta/info.json                              rate, counts, and what each column is, with the joints' names
    meta/stats.json, meta/tasks.parquet         statistics of every column; the task in words
    meta/episodes/chunk-000/file-000.parquet    the index: one row an episode, its length and its data file
    meta/preimage.json                          ours, LeRobot ignores it: the joints' unit, the scenes
    data/chunk-000/file-000.parquet             one row a step: frame (PNG, lossless), joints, action, counters

Joints are float32 on disk, LeRobot's convention, and float64 in memory: what is loaded is within 6e-8 of what was saved, relatively,
and saving it again changes nothing.
"""

import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Int, UInt8
from PIL import Image

from preimage.data.lerobot_info import EXTRAS, INFO, STATE
from preimage.records import Demonstration

VERSION = "v3.0"
CAMERA = "observation.images.camera"
STATS, TASKS = "meta/stats.json", "meta/tasks.parquet"
CHUNK_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
DATA, EPISODES = f"data/{CHUNK_FILE}", f"meta/episodes/{CHUNK_FILE}"
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
PICTURE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])

Numbers = dict[str, np.ndarray]
"""Every column but the frames, (T, J) or (T,)."""
Statistics = dict[str, list[Any]]
"""min, max, mean, std, count and the QUANTILES of one column, as nested lists ready for JSON."""


def validate_alike(demonstrations: Sequence[Demonstration]) -> None:
    """Raises ValueError where one data set cannot hold all of these."""
    if not demonstrations:
        raise ValueError("there is no demonstration: give one or more")
    first = demonstrations[0]
    if first.frames.shape[-1] not in (1, 3):
        raise ValueError(f"frames have {first.frames.shape[-1]} channels: a LeRobot data set takes 1 (grey) or 3 (colour)")
    if not first.joint_names:
        raise ValueError("demonstrations have no joints: a LeRobot data set needs 1 or more")
    if not (math.isfinite(first.rate_hz) and first.rate_hz > 0):
        raise ValueError(f"rate_hz is {first.rate_hz}: give the number of steps a second, above 0")
    for number, other in enumerate(demonstrations):
        for what, its, firsts in (
            ("frames of (height, width, channels)", other.frames.shape[1:], first.frames.shape[1:]),
            ("joints", other.joint_names, first.joint_names),
            ("a rate in Hz of", other.rate_hz, first.rate_hz),
        ):
            if its != firsts:
                raise ValueError(f"demonstration {number} has {what} {its}, the first {firsts}: one data set takes one kind")


def write_files(demonstrations: Sequence[Demonstration], folder: Path, *, task: str, joint_unit: str | None = None) -> None:
    """The files of the demonstrations are in an empty folder; a failure leaves some of them there (`storage.recordings.save` none).

    Raises:
        ValueError: the demonstrations do not agree in frame size, joints or rate.
        OSError: the disk is full or forbidden.
    """
    validate_alike(demonstrations)
    features = _features(demonstrations[0])
    data_file, index_file = (folder / name.format(chunk_index=0, file_index=0) for name in (DATA, EPISODES))
    data_file.parent.mkdir(parents=True)
    index_file.parent.mkdir(parents=True)
    starts = np.cumsum([0, *map(len, demonstrations)]).tolist()
    numbers = [_numbers(each, episode, starts[episode]) for episode, each in enumerate(demonstrations)]
    histograms = [_histogram(each.frames) for each in demonstrations]

    _write_data(data_file, demonstrations, numbers, _schema(features))
    rows = [_index_row(episode, starts, task, _statistics(*both)) for episode, both in enumerate(zip(numbers, histograms, strict=True))]
    pq.write_table(pa.Table.from_pylist(rows), index_file.absolute())
    _write_tasks(folder / TASKS, task)
    everything = {name: np.concatenate([each[name] for each in numbers]) for name in numbers[0]}
    _write_json(folder / STATS, _statistics(everything, np.sum(histograms, axis=0)))
    _write_json(folder / INFO, _info(features, demonstrations[0].rate_hz, len(demonstrations), starts[-1]))
    _write_json(folder / EXTRAS, {"joint_unit": joint_unit, "scenes": [each.scene and asdict(each.scene) for each in demonstrations]})


def _features(demonstration: Demonstration) -> dict[str, dict[str, Any]]:
    height, width = demonstration.frames.shape[1:3]
    joints = {"dtype": "float32", "shape": [len(demonstration.joint_names)], "names": list(demonstration.joint_names)}
    count = {"dtype": "int64", "shape": [1], "names": None}
    return {
        CAMERA: {"dtype": "image", "shape": [height, width, 3], "names": ["height", "width", "channels"]},
        STATE: joints,
        "action": joints,
        "timestamp": {"dtype": "float32", "shape": [1], "names": None},
        "frame_index": count,
        "episode_index": count,
        "index": count,
        "task_index": count,
    }


def _info(features: dict[str, dict[str, Any]], rate_hz: float, num_episodes: int, num_steps: int) -> dict[str, Any]:
    return {
        "codebase_version": VERSION,
        "fps": int(rate_hz) if float(rate_hz).is_integer() else float(rate_hz),
        "features": features,
        "total_episodes": num_episodes,
        "total_frames": num_steps,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "data_path": DATA,
        "video_path": None,
        "robot_type": None,
        "splits": {"train": f"0:{num_episodes}"},
    }


def _schema(features: Mapping[str, Mapping[str, Any]]) -> pa.Schema:
    """The columns as arrow types, and once more as the metadata in which Hugging Face `datasets` looks for pictures."""
    fields, described = [], {}
    for name, feature in features.items():
        value = {"dtype": feature["dtype"], "_type": "Value"}
        (length, *others) = feature["shape"]
        if feature["dtype"] == "image":
            fields.append((name, PICTURE))
            described[name] = {"_type": "Image"}
        elif length == 1 and not others:  # LeRobot stores a single number as such, not as a list of one
            fields.append((name, pa.type_for_alias(feature["dtype"])))
            described[name] = value
        else:
            fields.append((name, pa.list_(pa.type_for_alias(feature["dtype"]), length)))
            described[name] = {"feature": value, "length": length, "_type": "List"}
    return pa.schema(fields, metadata={"huggingface": json.dumps({"info": {"features": described}})})


def _numbers(demonstration: Demonstration, episode: int, start: int) -> Numbers:
    steps = np.arange(len(demonstration))
    joints = demonstration.joints.astype(np.float32)
    return {
        STATE: joints,
        "action": np.concatenate([joints[1:], joints[-1:]]),
        "timestamp": (steps / demonstration.rate_hz).astype(np.float32),
        "frame_index": steps,
        "episode_index": np.full_like(steps, episode),
        "index": start + steps,
        "task_index": np.zeros_like(steps),
    }


def _write_data(path: Path, demonstrations: Sequence[Demonstration], numbers: Sequence[Numbers], schema: pa.Schema) -> None:
    with pq.ParquetWriter(path.absolute(), schema, write_page_checksum=True) as writer:
        for demonstration, columns in zip(demonstrations, numbers, strict=True):
            pictures = [{"bytes": _encode(frame), "path": f"frame-{step:06d}.png"} for step, frame in enumerate(demonstration.frames)]
            arrays = [pa.array(pictures, PICTURE)]
            for name, values in columns.items():
                flat, kind = pa.array(values.reshape(-1)), schema.field(name).type
                arrays.append(pa.FixedSizeListArray.from_arrays(flat, type=kind) if pa.types.is_fixed_size_list(kind) else flat)
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))


def _encode(frame: UInt8[np.ndarray, "H W C"]) -> bytes:
    png = io.BytesIO()
    colour = np.broadcast_to(frame, (*frame.shape[:2], 3))  # (H, W, 3)
    # LeRobot's level: on camera frames twice as fast as Pillow's own, and the files are no larger.
    Image.fromarray(np.ascontiguousarray(colour)).save(png, "PNG", compress_level=1)
    return png.getvalue()


def _index_row(episode: int, starts: Sequence[int], task: str, statistics: Mapping[str, Statistics]) -> dict[str, Any]:
    return {
        "episode_index": episode,
        "tasks": [task],
        "length": starts[episode + 1] - starts[episode],
        "data/chunk_index": 0,
        "data/file_index": 0,
        "dataset_from_index": starts[episode],
        "dataset_to_index": starts[episode + 1],
        **{f"stats/{name}/{which}": value for name, column in statistics.items() for which, value in column.items()},
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
    }


def _write_tasks(path: Path, task: str) -> None:
    """One row a task. LeRobot reads it with pandas, which finds in the metadata that the words are the index."""
    columns = [("task_index", "int64", "int64"), ("task", "unicode", "object")]
    described = [
        {"name": name, "field_name": name, "pandas_type": pandas_type, "numpy_type": numpy_type, "metadata": None}
        for name, pandas_type, numpy_type in columns
    ]
    level = {"name": None, "field_name": None, "pandas_type": "unicode", "numpy_type": "object", "metadata": {"encoding": "UTF-8"}}
    creator = {"library": "pyarrow", "version": pa.__version__}
    pandas = {"index_columns": ["task"], "column_indexes": [level], "columns": described, "creator": creator, "pandas_version": "2.3.3"}
    table = pa.table({"task_index": pa.array([0], pa.int64()), "task": pa.array([task], pa.string())})
    pq.write_table(table.replace_schema_metadata({"pandas": json.dumps(pandas)}), path.absolute())


def _histogram(frames: UInt8[np.ndarray, "T H W C"]) -> Int[np.ndarray, "256 3"]:
    """How often each of the 256 values occurs in each channel, from which all statistics of pixels follow exactly."""
    counts = [np.bincount(frames[..., channel].reshape(-1), minlength=256) for channel in range(frames.shape[-1])]
    return np.broadcast_to(np.stack(counts, axis=-1), (256, 3))


def _statistics(numbers: Numbers, histogram: Int[np.ndarray, "256 3"]) -> dict[str, Statistics]:
    num_steps = len(numbers["index"])
    return {CAMERA: _pixel_statistics(histogram, num_steps)} | {name: _number_statistics(values) for name, values in numbers.items()}


def _pixel_statistics(histogram: Int[np.ndarray, "256 3"], num_steps: int) -> Statistics:
    """Of pixels scaled to [0, 1], each of shape (3, 1, 1); `count` is the number of frames, as in LeRobot."""
    levels = np.arange(256)[:, None] / 255
    total, reached = histogram.sum(0), np.cumsum(histogram, axis=0)
    mean = (levels * histogram).sum(0) / total
    std = np.sqrt(((levels - mean) ** 2 * histogram).sum(0) / total)
    present = histogram > 0
    statistics = {"min": present.argmax(0) / 255, "max": (255 - present[::-1].argmax(0)) / 255, "mean": mean, "std": std}
    statistics |= {name: (reached >= share * total).argmax(0) / 255 for name, share in QUANTILES.items()}
    return {name: value.reshape(3, 1, 1).tolist() for name, value in statistics.items()} | {"count": [num_steps]}


def _number_statistics(values: np.ndarray) -> Statistics:
    values = values.reshape(len(values), -1).astype(np.float64)  # (T, J)
    statistics = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
    statistics |= {name: np.quantile(values, share, axis=0) for name, share in QUANTILES.items()}
    return {name: value.tolist() for name, value in statistics.items()} | {"count": [len(values)]}


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=4), encoding="utf-8")
