"""Demonstrations on disk: a LeRobotDataset v3.0, so that LeRobot reads, shows and replays them as they are.

    meta/info.json                              rate, counts, and what each column is, with the joints' names
    meta/stats.json, meta/tasks.parquet         statistics of every column; the task in words
    meta/episodes/chunk-000/file-000.parquet    the index: one row an episode, its length and its data file
    meta/preimage.json                          ours, LeRobot ignores it: the joints' unit, the scenes
    data/chunk-000/file-000.parquet             one row a step: frame (PNG, lossless), joints, action, counters

Joints are float32 on disk, LeRobot's convention, and float64 in memory: what is loaded is within 6e-8 of what was saved, relatively,
and saving it again changes nothing.

>>> import tempfile
>>> demonstration = Demonstration(np.zeros((3, 8, 8, 1), np.uint8), np.ones((3, 2)), rate_hz=10.0, joint_names=("yaw", "shoulder"))
>>> with tempfile.TemporaryDirectory() as place:
...     save([demonstration, demonstration], f"{place}/reach", task="reach the mark")
...     loaded = load(f"{place}/reach")
>>> len(loaded), loaded[0].frames.shape, loaded[0].joint_names, loaded[0].rate_hz
(2, (3, 8, 8, 1), ('yaw', 'shoulder'), 10.0)
>>> fingerprint(loaded) == fingerprint([demonstration, demonstration])
True
"""

import hashlib
import io
import itertools
import json
import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float, Int, UInt8
from PIL import Image

from preimage.records import Demonstration, Scene

VERSION = "v3.0"
CAMERA, STATE = "observation.images.camera", "observation.state"
INFO, STATS, TASKS, EXTRAS = "meta/info.json", "meta/stats.json", "meta/tasks.parquet", "meta/preimage.json"
CHUNK_FILE = "chunk-{chunk:03d}/file-{file:03d}.parquet"
DATA, EPISODES = f"data/{CHUNK_FILE}", f"meta/episodes/{CHUNK_FILE}"
INDEX_COLUMNS = ["episode_index", "length", "data/chunk_index", "data/file_index"]
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
PICTURE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])

Numbers = dict[str, np.ndarray]
"""Every column but the frames, (T, J) or (T,)."""
Statistics = dict[str, list[Any]]
"""min, max, mean, std, count and the QUANTILES of one column, as nested lists ready for JSON."""


def save(demonstrations: Sequence[Demonstration], folder: Path | str, *, task: str) -> None:
    """`folder` holds the demonstrations, all of them; after a failure it is as it was before.

    The action of a step is the joints one step later, the last repeated: what a replay commands. Grey frames are written as three
    equal channels, for LeRobot expects three.

    Args:
        task: what is shown, in words, for policies conditioned on language.

    Raises:
        ValueError: there is something in the folder, or the demonstrations do not agree in frame size, joints or rate.
        OSError: the disk is full or forbidden.
    """
    folder = Path(folder).resolve()
    _check_alike(demonstrations)
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise ValueError(f"{folder} is there already: give a new folder or an empty one")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as scratch:
        draft = Path(scratch) / folder.name
        _write(demonstrations, draft, task)
        draft.replace(folder)


def load(folder: Path | str, *, camera: str | None = None) -> list[Demonstration]:
    """The demonstrations of a LeRobotDataset v3.0 with frames of dtype "image", whoever wrote it.

    Frames whose three channels are equal in the whole set come back with one. Joints are `observation.state`, in the unit they were
    recorded in.

    Args:
        camera: which of the cameras, by the name of its feature; needed only where there are several.

    Raises:
        ValueError: the folder is no such data set, or part of it is missing, damaged or contradicts the rest.
    """
    folder = Path(folder)
    info = _read_info(folder)
    camera = _choose_camera(info["features"], camera)
    names = _joint_names(info["features"])
    index = _read_index(folder, info["total_episodes"])
    scenes = _read_scenes(folder, len(index))
    recordings = list(_read_recordings(folder, index, camera, names))
    if all((frames == frames[..., :1]).all() for frames, _ in recordings):
        recordings = [(frames[..., :1].copy(), joints) for frames, joints in recordings]  # (T, H, W, 1)
    demonstrations = []
    for episode, ((frames, joints), scene) in enumerate(zip(recordings, scenes, strict=True)):
        try:
            demonstrations.append(Demonstration(frames, joints, float(info["fps"]), names, scene))
        except ValueError as error:
            raise ValueError(f"{folder}, episode {episode}: {error}") from None
    return demonstrations


def fingerprint(demonstrations: Sequence[Demonstration]) -> str:
    """A short name of the data: the same for the same frames, joints (as float32) and rates, so the same before and after the disk."""
    digest = hashlib.sha256()
    for demonstration in demonstrations:
        digest.update(f"{demonstration.frames.shape} {demonstration.joints.shape} {float(demonstration.rate_hz)!r}".encode())
        digest.update(np.ascontiguousarray(demonstration.frames).data)
        digest.update(np.ascontiguousarray(demonstration.joints, dtype="<f4").data)
    return digest.hexdigest()[:12]


# Writing


def _check_alike(demonstrations: Sequence[Demonstration]) -> None:
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


def _write(demonstrations: Sequence[Demonstration], folder: Path, task: str) -> None:
    features = _features(demonstrations[0])
    data_file, index_file = (folder / name.format(chunk=0, file=0) for name in (DATA, EPISODES))
    data_file.parent.mkdir(parents=True)
    index_file.parent.mkdir(parents=True)
    starts = np.cumsum([0, *map(len, demonstrations)]).tolist()
    numbers = [_numbers(each, episode, starts[episode]) for episode, each in enumerate(demonstrations)]
    histograms = [_histogram(each.frames) for each in demonstrations]

    _write_data(data_file, demonstrations, numbers, _schema(features))
    rows = [_index_row(episode, starts, task, _statistics(*both)) for episode, both in enumerate(zip(numbers, histograms, strict=True))]
    pq.write_table(pa.Table.from_pylist(rows), index_file)
    _write_tasks(folder / TASKS, task)
    everything = {name: np.concatenate([each[name] for each in numbers]) for name in numbers[0]}
    _write_json(folder / STATS, _statistics(everything, np.sum(histograms, axis=0)))
    _write_json(folder / INFO, _info(features, demonstrations[0].rate_hz, len(demonstrations), starts[-1]))
    _write_json(folder / EXTRAS, {"joint_unit": "rad", "scenes": [each.scene and asdict(each.scene) for each in demonstrations]})


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
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
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
    with pq.ParquetWriter(path, schema, write_page_checksum=True) as writer:
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
    pq.write_table(table.replace_schema_metadata({"pandas": json.dumps(pandas)}), path)


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


# Reading


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is not JSON: the file is damaged, copy the data set again") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path} holds a {type(content).__name__}, not an object: the file is damaged, copy the data set again")
    return content


def _read_info(folder: Path) -> dict[str, Any]:
    path = folder / INFO
    if not folder.is_dir():
        raise ValueError(f"{folder} is not a folder: name one that holds a LeRobot data set")
    if not path.is_file():
        raise ValueError(f"{folder} has no {INFO}, so it is no LeRobot data set: name the folder that holds meta/ and data/")
    info = _read_json(path)
    if (version := info.get("codebase_version")) != VERSION:
        raise ValueError(f"{folder} is a LeRobot data set of version {version}: only {VERSION} can be read, convert it with LeRobot first")
    fps, features = info.get("fps"), info.get("features")
    if not isinstance(fps, int | float) or not fps > 0:
        raise ValueError(f"{path} has fps {fps!r}: it should be the number of steps a second")
    if not isinstance(features, dict) or not all(isinstance(feature, dict) for feature in features.values()):
        raise ValueError(f"{path} has no usable features: they should describe each column by its dtype, shape and names")
    if not isinstance(info.get("total_episodes"), int):
        raise ValueError(f"{path} has total_episodes {info.get('total_episodes')!r}: it should be the number of episodes")
    return info


def _choose_camera(features: Mapping[str, Mapping[str, Any]], camera: str | None) -> str:
    cameras = [name for name, feature in features.items() if feature.get("dtype") in ("image", "video")]
    if not cameras:
        raise ValueError("the data set has no camera: one of its features should have dtype image")
    if camera is None and len(cameras) > 1:
        raise ValueError(f"the data set has the cameras {', '.join(cameras)}: choose one with camera=")
    if camera is not None and camera not in cameras:
        raise ValueError(f"the data set has no camera {camera}: it has {', '.join(cameras)}")
    camera = camera or cameras[0]
    if features[camera]["dtype"] == "video":
        raise ValueError(f"{camera} is stored as video, which cannot be read yet: convert the data set to dtype image with LeRobot")
    return camera


def _joint_names(features: Mapping[str, Mapping[str, Any]]) -> tuple[str, ...]:
    if STATE not in features:
        raise ValueError(f"the data set has no {STATE}: the joint angles should be stored under that name")
    names, shape = features[STATE].get("names"), features[STATE].get("shape")
    if isinstance(names, dict) and len(names) == 1:  # sets converted from version 2 say {"motors": [...]}
        (names,) = names.values()
    if names is None and isinstance(shape, list) and len(shape) == 1:
        names = [f"joint_{number}" for number in range(shape[0])]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError(f"{STATE} has the names {names!r} in {INFO}: they should be a list with the name of each joint")
    return tuple(names)


def _read_table(path: Path, columns: list[str]) -> pa.Table:
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            table = file.read(columns=columns)
    except FileNotFoundError as error:
        raise ValueError(f"{path} is missing: copy the data set again") from error
    except (OSError, pa.ArrowException) as error:
        raise ValueError(f"{path} cannot be read as parquet: the file is damaged or incomplete, copy the data set again") from error
    if missing := [column for column in columns if column not in table.column_names]:
        raise ValueError(f"{path} has no column {missing[0]}: a LeRobot data set of version {VERSION} needs it")
    return table


def _read_index(folder: Path, num_episodes: int) -> list[dict[str, Any]]:
    """One row an episode, in the order of their numbers, with the INDEX_COLUMNS."""
    paths = sorted(folder.glob("meta/episodes/*/*.parquet"))
    index = [row for path in paths for row in _read_table(path, INDEX_COLUMNS).to_pylist()]
    if not index:
        raise ValueError(f"{folder} has no episodes in meta/episodes: record one or more, or copy the data set again")
    if [row["episode_index"] for row in index] != list(range(num_episodes)):
        raise ValueError(f"meta/episodes in {folder} lists {len(index)} episodes, {INFO} counts {num_episodes}: copy the data set again")
    return index


def _read_scenes(folder: Path, num_episodes: int) -> list[Scene | None]:
    path = folder / EXTRAS
    if not path.exists():
        return [None] * num_episodes
    try:
        scenes = [_scene_from_json(scene) for scene in _read_json(path)["scenes"]]
    except (AttributeError, KeyError, TypeError) as error:
        raise ValueError(f"{path} has no usable scenes: repair it, or remove it to load the data set without scenes") from error
    if len(scenes) != num_episodes:
        raise ValueError(f"{path} has {len(scenes)} scenes for {num_episodes} episodes: remove it to load the data set without scenes")
    return scenes


def _scene_from_json(scene: dict[str, Any] | None) -> Scene | None:
    if scene is None:
        return None
    positions_m = {name: tuple(position) for name, position in scene["positions_m"].items()}
    return Scene(scene["task"], tuple(scene["start_joints"]), positions_m)


def _read_recordings(
    folder: Path, index: list[dict[str, Any]], camera: str, names: tuple[str, ...]
) -> Iterator[tuple[UInt8[np.ndarray, "T H W C"], Float[np.ndarray, "T J"]]]:
    """Frames and joints, episode by episode; only one data file at a time is in memory."""
    size = None
    for (chunk, number), rows in itertools.groupby(index, lambda row: (row["data/chunk_index"], row["data/file_index"])):
        path = folder / DATA.format(chunk=chunk, file=number)
        table = _read_table(path, [camera, STATE, "episode_index"])
        episodes = table["episode_index"].to_numpy()
        for row in rows:
            episode, length = row["episode_index"], row["length"]
            steps = table.filter(pa.array(episodes == episode))
            if len(steps) != length or length == 0:
                raise ValueError(f"{path} has {len(steps)} steps of episode {episode}, its index says {length}: copy the data set again")
            frames = _decode_frames(steps[camera].to_pylist(), f"{path}, episode {episode}", size)
            size = frames.shape[1:]
            yield frames, _joint_angles(steps[STATE].to_pylist(), f"{path}, episode {episode}", names)


def _joint_angles(steps: list[Any], where: str, names: tuple[str, ...]) -> Float[np.ndarray, "T J"]:
    angles = [step if isinstance(step, list) else [step] for step in steps]  # a single joint is stored without a list
    for step, values in enumerate(angles):
        if len(values) != len(names):
            raise ValueError(f"{where}, step {step} has {len(values)} values of {STATE}, {INFO} names {len(names)}: let them agree")
    return np.array(angles, np.float64)


def _decode_frames(pictures: list[Any], where: str, size: tuple[int, ...] | None) -> UInt8[np.ndarray, "T H W C"]:
    """The frames of an episode, all of `size` (H, W, C) or, where that is None, of the size of the first."""
    frames = []
    for step, picture in enumerate(pictures):
        frame = _decode(picture, f"{where}, step {step}")
        size = size or frame.shape
        if frame.shape != size:
            raise ValueError(f"{where}, step {step} has a frame of {frame.shape}, the first is of {size} (H, W, C): give all one size")
        frames.append(frame)
    return np.stack(frames)


def _decode(picture: Any, where: str) -> UInt8[np.ndarray, "H W C"]:
    try:
        with Image.open(io.BytesIO(picture["bytes"]), formats=("PNG", "JPEG")) as image:
            mode, frame = image.mode, np.asarray(image)
    except (OSError, SyntaxError, TypeError, KeyError, ValueError) as error:
        raise ValueError(f"{where} has a frame that cannot be decoded: copy the data set again or leave that episode out") from error
    if mode not in ("L", "RGB"):
        raise ValueError(f"{where} has a frame of mode {mode}: it should be 8-bit grey or RGB")
    return frame.reshape(*frame.shape[:2], -1)  # (H, W, C)
