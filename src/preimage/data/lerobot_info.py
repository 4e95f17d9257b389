"""What meta/info.json says of a LeRobot data set: rate, cameras, columns of the state, and the patterns of the files' names.

Converters write it in many ways, and nobody is to be trusted with paths and sizes: names of files stay inside the folder, and a pattern
holds nothing but the words that LeRobot puts there.
"""

import math
import re
import string
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from preimage.data.clocks import bounds, is_rate
from preimage.data.files import is_count, read_json

VERSIONS = "v2.0", "v2.1", "v3.0"
IN_MANY = "v3.0"
"""The version whose files hold many episodes; the former ones have a file an episode and are read alike."""
STATE, INFO, EXTRAS = "observation.state", "meta/info.json", "meta/preimage.json"
KEPT_BY_LEROBOT = "timestamp", "frame_index", "episode_index", "index", "task_index"
NUMBERS = re.compile(r"(float|int|uint)\d+")
MOST_JOINTS = 1024
MOST_CHUNK = 10**6
LONGEST_PATTERN = 300

Info = dict[str, Any]
Features = Mapping[str, Mapping[str, Any]]


def read_info(folder: Path) -> Info:
    """The content of meta/info.json, as far as it is needed known to be sound.

    Raises:
        ValueError: it is not.
    """
    path = folder / INFO
    info = read_json(path)
    if (version := info.get("codebase_version")) not in VERSIONS:
        known = f"{', '.join(VERSIONS[:-1])} and {VERSIONS[-1]}"
        raise ValueError(f"{folder} is a LeRobot data set of version {version}: only {known} can be read, convert it with LeRobot first")
    features = info.get("features")
    if not is_rate(info.get("fps")):
        raise ValueError(f"{path} has fps {info.get('fps')!r}: it should be the number of steps a second; {bounds()}")
    if not isinstance(features, dict) or not all(isinstance(feature, dict) for feature in features.values()):
        raise ValueError(f"{path} has no usable features: they should describe each column by its dtype, shape and names")
    if not is_count(info.get("total_episodes")):
        raise ValueError(f"{path} has total_episodes {info.get('total_episodes')!r}: it should be the number of episodes")
    if not is_count(info.setdefault("chunks_size", 1000)) or not 1 <= info["chunks_size"] <= MOST_CHUNK:
        raise ValueError(f"{path} has chunks_size {info['chunks_size']!r}: it should be the number of episodes a folder")
    return info


# Cameras


def cameras_of(features: Features) -> dict[str, tuple[int, int, int]]:
    """Height, width and channels of each camera; zeros where the data set does not tell."""
    return {name: _picture_shape(feature) for name, feature in features.items() if feature.get("dtype") in ("image", "video")}


def choose_camera(features: Features, camera: str | None) -> str:
    """The column of the camera that is asked for, by its whole name or by the end of it, as `front` for observation.images.front.

    Raises:
        ValueError: there is no such camera, or there are several.
    """
    cameras = list(cameras_of(features))
    if not cameras:
        raise ValueError("the data set has no camera: one of its features should have dtype image or video")
    if camera is None and len(cameras) > 1:
        raise ValueError(f"the data set has the cameras {', '.join(cameras)}: choose one by --view.camera, or View(camera=...)")
    if camera is None:
        return cameras[0]
    return _named(camera, cameras, "camera")


def _named(name: str, names: list[str], what: str) -> str:
    """The one of the names that is meant by its whole or by its end."""
    if name in names:
        return name
    ends = [each for each in names if each.endswith((f".{name}", f"/{name}"))]
    if len(ends) > 1:
        raise ValueError(f"the data set has several columns that end in {name}: give the whole name, {' or '.join(ends)}")
    if not ends:
        raise ValueError(f"the data set has no {what} {name}: it has {', '.join(names)}")
    return ends[0]


def _picture_shape(feature: Mapping[str, Any]) -> tuple[int, int, int]:
    """Some write the channels first."""
    shape, names = feature.get("shape"), feature.get("names")
    if not isinstance(shape, list) or len(shape) != 3 or not all(is_count(side) for side in shape):
        return 0, 0, 0
    if isinstance(names, list) and names and str(names[0]).startswith("c"):
        shape = [*shape[1:], shape[0]]
    height, width, channels = shape
    return height, width, channels


# Joints


def choose_state(features: Features, asked: tuple[str, ...] | None) -> tuple[str, ...]:
    """The columns that hold the joints, one after the other: those that are asked for, or observation.state.

    Raises:
        ValueError: there is no such column.
    """
    if asked is None and STATE in features:
        return (STATE,)
    there = [name for name in features if _is_vector(features[name]) and name not in KEPT_BY_LEROBOT]
    if asked is None:
        choice = (
            f"choose one or more of {', '.join(there)} by --view.state" if there else "the joint angles should be stored under that name"
        )
        raise ValueError(f"the data set has no {STATE}: {choice}")
    if not asked or len(set(asked)) != len(asked):
        raise ValueError(f"--view.state is {', '.join(asked) or 'empty'}: name one column or more, each once")
    return tuple(_named(name, there, "column of numbers") for name in asked)


def joint_names(features: Features, state: tuple[str, ...]) -> tuple[str, ...]:
    """A name for each value of these columns, no name twice.

    Raises:
        ValueError: a column has no usable names or shape.
    """
    of_each = {column: _names_of(column, features[column]) for column in state}
    every = [name for names in of_each.values() for name in names]
    if len(set(every)) != len(every) and all(len(set(names)) == len(names) for names in of_each.values()):
        return tuple(f"{column.rpartition('.')[2]}_{name}" for column, names in of_each.items() for name in names)
    return tuple(_each_once(every))


def _names_of(column: str, feature: Mapping[str, Any]) -> list[str]:
    names, width = feature.get("names"), _width(column, feature)
    listed = None if names is None else list(_flat(names))
    stem = "joint" if column == STATE else column.rpartition(".")[2]
    if listed is None or (not listed and width):
        return [f"{stem}_{number}" for number in range(width)]
    if not all(isinstance(name, str) for name in listed) or not listed:
        raise ValueError(f"{column} has the names {names!r} in {INFO}: they should be a list with the name of each joint")
    if len(listed) == 1 and width > 1:  # one name for the whole vector
        return [f"{listed[0]}_{number}" for number in range(width)]
    return listed


def _flat(names: Any) -> Iterator[Any]:
    """Lists in lists, groups by name, and names by position, {"pan": 0, "lift": 1}, in the order they are meant in."""
    if isinstance(names, dict):
        if names and all(is_count(place) for place in names.values()):
            yield from sorted(names, key=names.__getitem__)
        else:
            for group in names.values():
                yield from _flat(group)
    elif isinstance(names, list):
        for name in names:
            yield from _flat(name)
    else:
        yield names


def _each_once(names: list[str]) -> list[str]:
    """Names that are given twice are numbered: joint, joint becomes joint_0, joint_1."""
    while twice := {name for name in names if names.count(name) > 1}:
        counts = dict.fromkeys(twice, 0)
        numbered = []
        for name in names:
            numbered.append(f"{name}_{counts[name]}" if name in twice else name)
            if name in twice:
                counts[name] += 1
        names = numbered
    return names


def _is_vector(feature: Mapping[str, Any]) -> bool:
    return NUMBERS.fullmatch(str(feature.get("dtype"))) is not None


def _width(column: str, feature: Mapping[str, Any]) -> int:
    shape: Any = feature.get("shape")
    sides = shape if isinstance(shape, list) else [shape]
    if not all(is_count(side) for side in sides):
        return 0
    if (width := math.prod(sides)) > MOST_JOINTS:
        raise ValueError(f"{column} has the shape {shape} in {INFO}: {MOST_JOINTS} values a step are the most that can be joints")
    return width


# Files


def path_of(folder: Path, info: Info, key: str, **numbers: int | str) -> Path:
    """The file that a pattern of info.json names.

    Args:
        numbers: what the words of the pattern stand for.

    Raises:
        ValueError: it is no pattern, or leads out of the folder.
    """
    pattern = info.get(key)
    where = f"{folder}/{INFO} has {key} {repr(pattern)[:LONGEST_PATTERN]}"
    if not isinstance(pattern, str) or not _is_pattern(pattern, numbers):
        words = ", ".join(f"{{{word}}}" for word in numbers)
        raise ValueError(f"{where}: it should be the pattern of the files' names, in which {words} may stand")
    name = Path(pattern.replace("\\", "/").format(**numbers))  # some were written on Windows
    if name.is_absolute() or ".." in name.parts or not str(name).isprintable():
        raise ValueError(f"{where}: the files of a data set lie in its own folder, and their names begin there")
    return folder / name


def _is_pattern(pattern: str, numbers: Mapping[str, int | str]) -> bool:
    """Whether a pattern is short, and has nothing between braces but the words, with no more digits than a file's name needs."""
    try:
        parts = list(string.Formatter().parse(pattern[: LONGEST_PATTERN + 1]))
    except ValueError:
        return False
    fits = len(pattern) <= LONGEST_PATTERN
    for _, word, spec, conversion in parts:
        known = word is None or (word in numbers and not conversion)
        digits = re.fullmatch(r"(0?\d{1,2}d?|d)?" if isinstance(numbers.get(word or ""), int) else "", spec or "")
        fits = fits and known and digits is not None
    return fits
