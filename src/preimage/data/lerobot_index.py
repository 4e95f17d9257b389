"""Where the episodes of a LeRobot data set lie, by its index: meta/episodes/*/*.parquet (v3.0), or meta/episodes.jsonl (v2.0, v2.1).

What the index lists counts, in whatever order: episodes that somebody took out of it are not there, and the others keep their numbers.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from preimage.data.files import AGAIN, is_count, read_json_lines, validate_file
from preimage.data.lerobot_info import IN_MANY, Info, path_of

LINES = "meta/episodes.jsonl"
COLUMNS = ["episode_index", "length", "data/chunk_index", "data/file_index"]
TASK_NAMES = "task", "__index_level_0__"
"""Columns of meta/tasks.parquet that hold the words: pandas calls an index without a name by the second."""
MOST_ROWS, MOST_BYTES = 20_000_000, 4 * 2**30
"""Of one parquet file, unpacked: what is larger would not fit in memory, or is a bomb."""


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


def places_of(folder: Path, info: Info, camera: str | None) -> list[Place]:
    """The episodes in the order of their numbers.

    Args:
        camera: whose videos are wanted; None where no picture is.

    Raises:
        ValueError: the index is missing or damaged, lists no episode, or one twice.
    """
    video = camera if camera and info["features"][camera]["dtype"] == "video" else None
    places = (_places_in_many if info["codebase_version"] == IN_MANY else _places_in_one)(folder, info, video)
    places.sort(key=lambda place: place.episode)
    for one, other in itertools.pairwise(places):
        if one.episode == other.episode:
            raise ValueError(f"{folder} lists episode {one.episode} twice in its index: take one of the two out")
    return places


def read_table(path: Path, columns: Sequence[str], optional: Sequence[str] = ()) -> pa.Table:
    """These columns of a parquet file.

    Raises:
        ValueError: it is missing, no parquet, damaged, far too large, or lacks one that is not optional.
    """
    validate_file(path)
    try:
        with pq.ParquetFile(path.absolute(), page_checksum_verification=True) as file:
            _validate_size(path, file.metadata)
            table = file.read(columns=[*columns, *optional])
    except (OSError, pa.ArrowException) as error:
        raise ValueError(f"{path} cannot be read as parquet: the file is damaged or incomplete, {AGAIN}") from error
    if twice := [column for column in (*columns, *optional) if table.column_names.count(column) > 1]:
        raise ValueError(f"{path} has several columns {twice[0]}: give each a name of its own")
    if missing := [column for column in columns if column not in table.column_names]:
        raise ValueError(f"{path} has no column {missing[0]}: a LeRobot data set needs it")
    return table


def _validate_size(path: Path, metadata: pq.FileMetaData) -> None:
    size = sum(metadata.row_group(number).total_byte_size for number in range(metadata.num_row_groups))
    if metadata.num_rows > MOST_ROWS or size > MOST_BYTES:
        raise ValueError(
            f"{path} unpacks to {metadata.num_rows} rows and {size / 2**30:.1f} GB, more than {MOST_ROWS} or "
            f"{MOST_BYTES / 2**30:.0f} GB: split it into several files"
        )


def _places_in_many(folder: Path, info: Info, camera: str | None) -> list[Place]:
    parts = {name: f"videos/{camera}/{name}" for name in ("chunk_index", "file_index", "from_timestamp", "to_timestamp")}
    columns = COLUMNS + (list(parts.values()) if camera else [])
    paths = sorted(folder.glob("meta/episodes/*/*.parquet"))
    index = [row for path in paths for row in read_table(path, columns, ["tasks"]).to_pylist()]
    if not index:
        raise ValueError(f"{folder} has no episodes in meta/episodes: record one or more, or {AGAIN}")
    times = parts["from_timestamp"], parts["to_timestamp"]
    for column in columns:
        fits = (lambda value: isinstance(value, int | float) and math.isfinite(value)) if column in times else is_count
        if not all(fits(row[column]) for row in index):
            raise ValueError(f"{folder}/meta/episodes does not tell {column} of every episode: the index is damaged, {AGAIN}")
    places = []
    for row in index:
        data = path_of(folder, info, "data_path", **_chunk(row["data/chunk_index"]), file_index=row["data/file_index"])
        place = row["episode_index"], row["length"], _task(row), data
        if camera is None:
            places.append(Place(*place, video=None))
            continue
        numbers = {**_chunk(row[parts["chunk_index"]]), "file_index": row[parts["file_index"]]}
        film = path_of(folder, info, "video_path", video_key=camera, **numbers)
        places.append(Place(*place, film, row[times[0]], row[times[1]]))
    return places


def _places_in_one(folder: Path, info: Info, camera: str | None) -> list[Place]:
    path = folder / LINES
    if not path.exists():
        raise ValueError(f"{folder} has no {LINES}: {AGAIN}")
    places = []
    for line, row in read_json_lines(path):
        episode, length = row.get("episode_index", -1), row.get("length", -1)
        if not is_count(episode) or not is_count(length):
            raise ValueError(f"{path}, line {line} does not tell an episode's number and length: the file is damaged, {AGAIN}")
        numbers = {**_chunk(episode // info["chunks_size"]), "episode_index": episode, "file_index": episode}
        film = path_of(folder, info, "video_path", video_key=camera, **numbers) if camera else None
        places.append(Place(episode, length, _task(row), path_of(folder, info, "data_path", **numbers), film))
    if not places:
        raise ValueError(f"{folder} has no episodes in {LINES}: record one or more, or {AGAIN}")
    return places


def _chunk(number: int) -> dict[str, int]:
    """v2.1 calls it by one name and v3.0 by another, and converters mix them up."""
    return {"episode_chunk": number, "chunk_index": number}


def _task(row: Mapping[str, Any]) -> str | None:
    """All that the index says an episode shows, in its order."""
    tasks = row.get("tasks")
    return ", ".join(task for task in tasks if isinstance(task, str)) or None if isinstance(tasks, list) else None


def tasks_by_number(folder: Path) -> dict[int, str]:
    """What the numbers in the column task_index stand for, where the data set says.

    Raises:
        ValueError: the file that says it is damaged.
    """
    lines, table = folder / "meta/tasks.jsonl", folder / "meta/tasks.parquet"
    rows = [row for _, row in read_json_lines(lines)] if lines.exists() else []
    if table.exists():
        rows = read_table(table, ["task_index"], TASK_NAMES).to_pylist()
    named = [(row.get("task_index"), next((row[name] for name in TASK_NAMES if row.get(name)), None)) for row in rows]
    return {number: task for number, task in named if isinstance(number, int) and is_count(number) and isinstance(task, str)}
