"""Recordings as LeRobot keeps them, v3.0 and v2.1, images or videos, whoever wrote them.

    v3.0    meta/info.json, meta/episodes/*/*.parquet      the index: one row an episode, with its length and its files
            data/*/*.parquet                               many episodes a file, one row a step: joints, and frames where they are images
            videos/CAMERA/*/*.mp4                          many episodes a file, each from one time to another
    v2.1    meta/info.json, meta/episodes.jsonl            the index: one line an episode, with its length
            data/*/episode_*.parquet                       one episode a file
            videos/*/CAMERA/episode_*.mp4                  one episode a file

Reading is patient: a part that is missing is told in a sentence (`Episode.faults`) and the rest is read, for the doctor has to see it.
Only what says where things lie must be whole.
"""

import itertools
import json
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float

from preimage.data.decoding import AGAIN, decode, video_frames
from preimage.data.view import Eye, Picture
from preimage.records import Description, Episode, Scene, number_of, scene_of

VERSIONS = "v2.1", "v3.0"
STATE, INFO, EXTRAS = "observation.state", "meta/info.json", "meta/preimage.json"
INDEX_COLUMNS = ["episode_index", "length", "data/chunk_index", "data/file_index"]

Info = dict[str, Any]


@dataclass(frozen=True)
class Place:
    """Where an episode lies, and what the index says of it."""

    episode: int
    length: int
    task: str | None
    data: Path
    video: Path | None
    """None where frames are images among the data."""
    from_s: float = 0.0
    to_s: float = math.inf


def describe(folder: Path) -> Description:
    """What meta/info.json tells of the data set.

    Raises:
        ValueError: it is missing, damaged, or of a version that is not known.
    """
    info = read_info(folder)
    features = info["features"]
    cameras = {name: _picture_shape(features[name]) for name in _cameras(features)}
    extras = _read_json(folder / EXTRAS) if (folder / EXTRAS).exists() else {}
    version = f"LeRobotDataset {info['codebase_version']}"
    return Description(version, cameras, _joint_names(features), float(info["fps"]), info["total_episodes"], extras.get("joint_unit"))


def read_episodes(folder: Path, eye: Eye, only: Collection[int] | None = None) -> Iterator[Episode]:
    """The episodes one by one, in the order of the index; only one data file at a time is in memory.

    Args:
        only: numbers of the episodes to read; by default all.

    Raises:
        ValueError: the index is missing or damaged, or there is no such camera.
    """
    info = read_info(folder)
    camera = _choose_camera(info["features"], eye.view.camera)
    names = _joint_names(info["features"])
    scenes = _read_scenes(folder, info["total_episodes"])
    places = _places_in_one(folder, info, camera) if info["codebase_version"] == "v2.1" else _places_in_many(folder, info, camera)
    wanted = [place for place in places if only is None or place.episode in only]
    for path, group in itertools.groupby(wanted, lambda place: place.data):
        columns = [STATE, "episode_index"] + ([camera] if info["features"][camera]["dtype"] == "image" else [])
        try:
            table, unread = _read_table(path, columns, ["timestamp"]), ()
        except ValueError as error:
            table, unread = pa.table({name: pa.array([], pa.int64()) for name in columns}), (str(error),)
        for place in group:
            steps = table.filter(pa.array(table["episode_index"].to_numpy() == place.episode))
            where = f"{path}, episode {place.episode}"
            frames, unseen = eye.watch(_pictures(place, steps, camera, where, info["fps"]), str(place.video or where))
            joints, unfit = _joint_angles(steps[STATE].to_pylist(), where, names)
            scene = scenes[place.episode] if place.episode < len(scenes) else None
            faults = (*unread, *unfit, *unseen)
            about = {"rate_hz": float(info["fps"]), "task": place.task, "scene": scene, "faults": faults}
            yield Episode(place.episode, frames, joints, names, None if unfit else _times(steps), place.length, **about)


def _pictures(place: Place, steps: pa.Table, camera: str, where: str, fps: float) -> Iterator[Picture]:
    if place.video:
        yield from video_frames(place.video, rate_hz=float(fps), from_s=place.from_s, to_s=place.to_s)
        return
    for step, picture in enumerate(steps[camera]):
        content = picture.as_py()
        yield decode(content.get("bytes") if isinstance(content, dict) else None, f"{where}, step {step}")


def _joint_angles(steps: list[Any], where: str, names: tuple[str, ...]) -> tuple[Float[np.ndarray, "T J"], tuple[str, ...]]:
    angles = [step if isinstance(step, list) else [step] for step in steps]  # a single joint is stored without a list
    for step, values in enumerate(angles):
        if len(values) != len(names):
            fault = f"{where}, step {step} has {len(values)} values of {STATE}, {INFO} names {len(names)}: let them agree"
            return np.zeros((0, len(names))), (fault,)
    return np.array(angles, np.float64).reshape(-1, len(names)), ()


def _times(steps: pa.Table) -> Float[np.ndarray, " T"] | None:
    if "timestamp" not in steps.column_names:
        return None
    return np.array(steps["timestamp"].to_pylist(), np.float64).reshape(-1)


# The description


def _read_json(path: Path) -> Info:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is not JSON: the file is damaged, {AGAIN}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path} holds a {type(content).__name__}, not an object: the file is damaged, {AGAIN}")
    return content


def read_info(folder: Path) -> Info:
    """The content of meta/info.json, as far as it is needed known to be sound.

    Raises:
        ValueError: it is not.
    """
    path = folder / INFO
    info = _read_json(path)
    if (version := info.get("codebase_version")) not in VERSIONS:
        known = " and ".join(VERSIONS)
        raise ValueError(f"{folder} is a LeRobot data set of version {version}: only {known} can be read, convert it with LeRobot first")
    fps, features = info.get("fps"), info.get("features")
    if not isinstance(fps, int | float) or not 0 < fps < math.inf:
        raise ValueError(f"{path} has fps {fps!r}: it should be the number of steps a second")
    if not isinstance(features, dict) or not all(isinstance(feature, dict) for feature in features.values()):
        raise ValueError(f"{path} has no usable features: they should describe each column by its dtype, shape and names")
    if not isinstance(info.get("total_episodes"), int):
        raise ValueError(f"{path} has total_episodes {info.get('total_episodes')!r}: it should be the number of episodes")
    if not isinstance(info.setdefault("chunks_size", 1000), int) or info["chunks_size"] < 1:
        raise ValueError(f"{path} has chunks_size {info['chunks_size']!r}: it should be the number of episodes a folder")
    return info


def _cameras(features: Mapping[str, Mapping[str, Any]]) -> list[str]:
    return [name for name, feature in features.items() if feature.get("dtype") in ("image", "video")]


def _choose_camera(features: Mapping[str, Mapping[str, Any]], camera: str | None) -> str:
    cameras = _cameras(features)
    if not cameras:
        raise ValueError("the data set has no camera: one of its features should have dtype image or video")
    if camera is None and len(cameras) > 1:
        raise ValueError(f"the data set has the cameras {', '.join(cameras)}: choose one by --view.camera, or View(camera=...)")
    if camera is not None and camera not in cameras:
        raise ValueError(f"the data set has no camera {camera}: it has {', '.join(cameras)}")
    return camera or cameras[0]


def _picture_shape(feature: Mapping[str, Any]) -> tuple[int, int, int]:
    """Height, width and channels of a camera; some write the channels first. Zeros where the data set does not tell."""
    shape, names = feature.get("shape"), feature.get("names")
    if not isinstance(shape, list) or len(shape) != 3:
        return 0, 0, 0
    if isinstance(names, list) and str(names[0]).startswith("c"):
        shape = [*shape[1:], shape[0]]
    height, width, channels = shape
    return height, width, channels


def _joint_names(features: Mapping[str, Mapping[str, Any]]) -> tuple[str, ...]:
    if STATE not in features:
        raise ValueError(f"the data set has no {STATE}: the joint angles should be stored under that name")
    names, shape = features[STATE].get("names"), features[STATE].get("shape")
    if isinstance(names, dict) and len(names) == 1:  # sets converted from version 2 say {"motors": [...]}
        (names,) = names.values()
    if isinstance(names, list) and len(names) == 1 and isinstance(names[0], list):  # and some of version 2 [[...]]
        (names,) = names
    if names is None and isinstance(shape, list) and len(shape) == 1:
        names = [f"joint_{number}" for number in range(shape[0])]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError(f"{STATE} has the names {names!r} in {INFO}: they should be a list with the name of each joint")
    return tuple(names)


# Where things lie


def _places_in_many(folder: Path, info: Info, camera: str) -> list[Place]:
    """Of v3.0, where files hold many episodes."""
    video = info["features"][camera]["dtype"] == "video"
    parts = {name: f"videos/{camera}/{name}" for name in ("chunk_index", "file_index", "from_timestamp", "to_timestamp")}
    paths = sorted(folder.glob("meta/episodes/*/*.parquet"))
    columns = INDEX_COLUMNS + (list(parts.values()) if video else [])
    index = [row for path in paths for row in _read_table(path, columns, ["tasks"]).to_pylist()]
    if not index:
        raise ValueError(f"{folder} has no episodes in meta/episodes: record one or more, or {AGAIN}")
    if empty := [column for column in columns if None in (row[column] for row in index)]:
        raise ValueError(f"{folder}/meta/episodes does not tell {empty[0]} of every episode: the index is damaged, {AGAIN}")
    places = []
    for row in index:
        data = _path(folder, info, "data_path", chunk_index=row["data/chunk_index"], file_index=row["data/file_index"])
        place = row["episode_index"], row["length"], _task(row), data
        if not video:
            places.append(Place(*place, video=None))
            continue
        numbers = {"chunk_index": row[parts["chunk_index"]], "file_index": row[parts["file_index"]]}
        film = _path(folder, info, "video_path", video_key=camera, **numbers)
        places.append(Place(*place, film, row[parts["from_timestamp"]], row[parts["to_timestamp"]]))
    return places


def _places_in_one(folder: Path, info: Info, camera: str) -> list[Place]:
    """Of v2.1, where each episode has files of its own."""
    path = folder / "meta/episodes.jsonl"
    if not path.is_file():
        raise ValueError(f"{folder} has no meta/episodes.jsonl: {AGAIN}")
    places = []
    for line, text in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), start=1):
        try:
            row = json.loads(text)
            episode, length = int(row["episode_index"]), int(row["length"])
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path}, line {line} does not tell an episode's number and length: the file is damaged, {AGAIN}") from error
        numbers = {"episode_chunk": episode // info["chunks_size"], "episode_index": episode}
        video = info["features"][camera]["dtype"] == "video"
        film = _path(folder, info, "video_path", video_key=camera, **numbers) if video else None
        places.append(Place(episode, length, _task(row), _path(folder, info, "data_path", **numbers), film))
    if not places:
        raise ValueError(f"{folder} has no episodes in meta/episodes.jsonl: record one or more, or {AGAIN}")
    return places


def _task(row: Mapping[str, Any]) -> str | None:
    tasks = row.get("tasks")
    return tasks[0] if isinstance(tasks, list) and tasks else None


def _path(folder: Path, info: Info, key: str, **numbers: Any) -> Path:
    try:
        return folder / info[key].format(**numbers)
    except (KeyError, IndexError, ValueError, AttributeError) as error:
        raise ValueError(f"{folder}/{INFO} has {key} {info.get(key)!r}: it should be the pattern of the files' names") from error


def _read_table(path: Path, columns: list[str], optional: list[str]) -> pa.Table:
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            table = file.read(columns=columns + optional)
    except FileNotFoundError as error:
        raise ValueError(f"{path} is missing: {AGAIN}") from error
    except (OSError, pa.ArrowException) as error:
        raise ValueError(f"{path} cannot be read as parquet: the file is damaged or incomplete, {AGAIN}") from error
    if missing := [column for column in columns if column not in table.column_names]:
        raise ValueError(f"{path} has no column {missing[0]}: a LeRobot data set needs it")
    return table


def _read_scenes(folder: Path, num_episodes: int) -> list[Scene | None]:
    path = folder / EXTRAS
    if not path.exists():
        return []
    try:
        scenes = [scene_of(scene) for scene in _read_json(path)["scenes"]]
    except (AttributeError, KeyError, TypeError) as error:
        raise ValueError(f"{path} has no usable scenes: repair it, or remove it to load the data set without scenes") from error
    if len(scenes) != num_episodes:
        counts = f"{number_of(len(scenes), 'scene')} for {number_of(num_episodes, 'episode')}"
        raise ValueError(f"{path} has {counts}: remove it to load the data set without scenes")
    return scenes
