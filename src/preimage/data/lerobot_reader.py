"""Recordings as LeRobot keeps them, v3.0, v2.1 and v2.0, images or videos, whoever wrote them.

    v3.0    meta/info.json, meta/episodes/*/*.parquet      the index: one row an episode, with its length and its files
            data/*/*.parquet                               many episodes a file, one row a step: joints, and frames where they are images
            videos/CAMERA/*/*.mp4                          many episodes a file, each from one time to another
    v2.*    meta/info.json, meta/episodes.jsonl            the index: one line an episode, with its length
            data/*/episode_*.parquet                       one episode a file
            videos/*/CAMERA/episode_*.mp4                  one episode a file

Reading is patient: a part that is missing is reported in a sentence (`Episode.faults`) and the rest is read, for the doctor has to see it.
Only what says where things lie must be whole.
"""

import itertools
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from preimage.data.clocks import SECONDS, unit_that_agrees
from preimage.data.decoding import decode, video_frames
from preimage.data.files import leave_out, read_json
from preimage.data.lerobot_index import Place, places_of, read_table, tasks_by_number
from preimage.data.lerobot_info import EXTRAS, INFO, cameras_of, choose_camera, choose_state, joint_names, read_info
from preimage.data.view import Eye, Picture
from preimage.records import Description, Episode, Scene, number_of, scene_of

OPTIONAL = "timestamp", "frame_index", "index", "task_index"
"""Columns that say when a row was taken and what it shows; some leave them out."""


def describe(folder: Path, state: tuple[str, ...] | None = None) -> Description:
    """What meta/info.json tells of the data set.

    Args:
        state: the columns that hold the joints; by default observation.state.

    Raises:
        ValueError: it is missing, damaged, or of a version that is not known.
    """
    info = read_info(folder)
    features = info["features"]
    extras = read_json(folder / EXTRAS) if (folder / EXTRAS).exists() else {}
    unit = extras.get("joint_unit")
    names = joint_names(features, choose_state(features, state))
    version, rate_hz = f"LeRobotDataset {info['codebase_version']}", float(info["fps"])
    return Description(version, cameras_of(features), names, rate_hz, info["total_episodes"], unit if isinstance(unit, str) else None)


def numbers_of(folder: Path) -> list[int]:
    """The numbers of its episodes, as its index lists them.

    Raises:
        ValueError: the index is missing or damaged.
    """
    return [place.episode for place in places_of(folder, read_info(folder), None)]


def read_episodes(folder: Path, eye: Eye, only: Collection[int] | None = None) -> Iterator[Episode]:
    """The episodes one by one, in the order of their numbers; only one data file at a time is in memory.

    Args:
        only: numbers of the episodes to read; by default all.

    Raises:
        ValueError: the index is missing or damaged, or there is no such camera or state.
    """
    info = read_info(folder)
    features, rate_hz = info["features"], float(info["fps"])
    camera = choose_camera(features, eye.view.camera)
    state = choose_state(features, eye.view.state)
    names = joint_names(features, state)
    places = places_of(folder, info, camera)
    scenes = _read_scenes(folder, places)
    tasks = {} if all(place.task for place in places) else tasks_by_number(folder)
    columns = [*state, "episode_index"] + ([camera] if features[camera]["dtype"] == "image" else [])
    wanted = [place for place in places if only is None or place.episode in only]
    for path, group in itertools.groupby(wanted, lambda place: place.data):
        try:
            table, unread = read_table(path, columns, OPTIONAL), ()
        except ValueError as error:
            table, unread = pa.table({name: pa.array([], pa.int64()) for name in columns}), (str(error),)
        episode_of_row = _scalars(table, "episode_index")
        for place in group:
            steps = _in_order(table.filter(pa.array(episode_of_row == place.episode)))
            where = f"{path}, episode {place.episode}"
            frames, unseen = eye.watch(_pictures(folder, place, steps, camera, rate_hz), str(place.video or where))
            joints, unfit = _joint_angles([steps[column].to_pylist() for column in state], where, names)
            times_s = None if unfit or "timestamp" not in steps.column_names else _times(steps, rate_hz)
            task = place.task or _task_of(steps, tasks)
            about = {"rate_hz": rate_hz, "task": task, "scene": scenes.get(place.episode), "faults": (*unread, *unfit, *unseen)}
            yield Episode(place.episode, frames, joints, names, times_s, place.length, **about)


def _scalars(table: pa.Table, column: str) -> Float[np.ndarray, " T"]:
    """One number a row, where some write a list of one; NaN where there is none."""
    values = (value[0] if isinstance(value, list) and value else value for value in table[column].to_pylist())
    return np.array([value if isinstance(value, int | float) else np.nan for value in values], np.float64)


def _times(steps: pa.Table, rate_hz: float) -> Float[np.ndarray, " T"]:
    """When each row was taken, in seconds; some write another unit, and the rate tells which."""
    times = _scalars(steps, "timestamp")
    return times * SECONDS[unit_that_agrees(times, rate_hz)]


def _task_of(steps: pa.Table, tasks: Mapping[int, str]) -> str | None:
    """What an episode shows, by the numbers of the tasks in its rows."""
    if "task_index" not in steps.column_names:
        return None
    numbers = dict.fromkeys(int(number) for number in _scalars(steps, "task_index") if np.isfinite(number))
    return ", ".join(tasks.get(number, f"task {number}") for number in numbers) or None


def _in_order(steps: pa.Table) -> pa.Table:
    """The steps of an episode by what counts them: some write them in another order."""
    for column in ("frame_index", "index", "timestamp"):
        places = _scalars(steps, column) if column in steps.column_names else np.zeros(0)
        if len(np.unique(places[np.isfinite(places)])) == len(steps):
            order = places.argsort(kind="stable")
            return steps if (order == np.arange(len(order))).all() else steps.take(pa.array(order))
    return steps


def _pictures(folder: Path, place: Place, steps: pa.Table, camera: str, rate_hz: float) -> Iterator[Picture]:
    remedy = leave_out(place.episode)
    if place.video:
        yield from video_frames(place.video, rate_hz=rate_hz, from_s=place.from_s, to_s=place.to_s, remedy=remedy)
        return
    for step, cell in enumerate(steps[camera]):
        where = f"{place.data}, episode {place.episode}, step {step}"
        content = cell.as_py()
        if isinstance(content, str):
            content = {"bytes": None, "path": content}
        if isinstance(content, dict):
            content = content.get("bytes") or _named_file(folder, place, camera, content.get("path"))
        if isinstance(content, str) or not content:
            yield f"{where} has no picture: {content or remedy}"
        elif isinstance(content, bytes | Path):
            yield decode(content, where, remedy=remedy)
        else:
            yield f"{where} holds a {type(content).__name__} in the column {camera}: it should hold the bytes of a PNG or JPEG file"


def _named_file(folder: Path, place: Place, camera: str, path: Any) -> Path | str | None:
    """The picture that a table names instead of holding it, or a sentence where it is not there; None where it names none."""
    if not isinstance(path, str) or not path:
        return None
    inside = not Path(path).is_absolute() and ".." not in Path(path).parts and path.isprintable()
    beside = folder / "images" / camera / f"episode_{place.episode:06d}" / Path(path).name  # where LeRobot kept them as it recorded
    for there in (folder / path, beside) if inside else ():
        if there.is_file():
            return there
    help_ = "copy that folder too" if inside else "only files in the folder of the data set are read"
    return f"the table names a file ({path[:200]}) instead of holding the picture, and it is not in {folder}: {help_}"


def _joint_angles(columns: list[list[Any]], where: str, names: tuple[str, ...]) -> tuple[Float[np.ndarray, "T J"], tuple[str, ...]]:
    steps = zip(*columns, strict=True)
    angles = [[np.nan] * len(names) if None in step else [value for cell in step for value in _values(cell)] for step in steps]
    for step, values in enumerate(angles):
        if len(values) != len(names):
            fault = f"{where}, step {step} has {number_of(len(values), 'value')} of the joints, {INFO} names {len(names)}: let them agree"
            return np.zeros((0, len(names))), (fault,)
    try:
        return np.array(angles, np.float64).reshape(-1, len(names)), ()
    except (TypeError, ValueError):
        return np.zeros((0, len(names))), (f"{where} holds joints that are no numbers: it should hold one number for each name",)


def _values(cell: Any) -> Iterator[Any]:
    """A single joint is stored without a list; some store [1, n]."""
    if isinstance(cell, list):
        for value in cell:
            yield from _values(value)
    else:
        yield cell


def _read_scenes(folder: Path, places: list[Place]) -> dict[int, Scene | None]:
    """By the number of the episode."""
    path = folder / EXTRAS
    if not path.exists():
        return {}
    content = read_json(path)
    try:
        scenes = [scene_of(scene) for scene in content["scenes"]]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} has no usable scenes: repair it, or remove it to load the data set without scenes") from error
    if len(scenes) <= (last := places[-1].episode):
        counts = f"{number_of(len(scenes), 'scene')} for {number_of(last + 1, 'episode')}"
        raise ValueError(f"{path} has {counts}: remove it to load the data set without scenes")
    return dict(enumerate(scenes))
