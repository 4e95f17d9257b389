"""Recordings without a format: a folder, in it one folder an episode, in that pictures and a table of joints.

    my-data/rate_hz             pictures a second, one number; not needed where joints.csv has a column time_s
    my-data/take 1/joints.csv   a head of joint names, then one row a picture; a first column `time_s`, in seconds, may stand before them
    my-data/take 1/0001.png     pictures, PNG or JPEG; the names put them in order, and their numbers are read as numbers

Episodes are counted from 0 in the order of their folders' names.
"""

import csv
import re
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

from preimage.data.decoding import decode
from preimage.data.view import Eye
from preimage.records import Description, Episode

TABLE, RATE, TIME = "joints.csv", "rate_hz", "time_s"
CAMERA = "camera"
"""What the one camera is called."""
SUFFIXES = ".png", ".jpg", ".jpeg"

Rows = tuple[tuple[str, ...], Float[np.ndarray, "T J"], Float[np.ndarray, " T"] | None]
"""Names, joints and times of a table."""


def is_plain(folder: Path) -> bool:
    """Whether the folder holds episodes as folders with a table of joints."""
    return any(folder.glob(f"*/{TABLE}"))


def describe(folder: Path) -> Description:
    """What the first episode and the rate tell.

    Raises:
        ValueError: the first episode cannot be read, or there is no rate.
    """
    takes = _takes(folder)
    names, rate_hz = _names_and_rate(folder)
    pictures = _pictures_of(takes[0])
    first = decode(pictures[0], str(pictures[0])) if pictures else f"{takes[0]} has no picture: put PNG or JPEG files there"
    if isinstance(first, str):
        raise ValueError(first)
    height, width, channels = first.shape
    return Description("folder", {CAMERA: (height, width, channels)}, names, rate_hz, len(takes))


def read_episodes(folder: Path, eye: Eye, only: Collection[int] | None = None) -> Iterator[Episode]:
    """The episodes one by one; what cannot be read of one is told in its faults.

    Args:
        only: numbers of the episodes to read; by default all.

    Raises:
        ValueError: there is no rate, the first table cannot be read, or another camera is asked for.
    """
    if eye.view.camera not in (None, CAMERA):
        raise ValueError(f"{folder} has no camera {eye.view.camera}: a folder of pictures has one, and it needs no name")
    names, rate_hz = _names_and_rate(folder)
    for number, take in enumerate(_takes(folder)):
        if only is not None and number not in only:
            continue
        try:
            (found, joints, times), unread = _read_table(take / TABLE), ()
            if found != names:
                raise ValueError(
                    f"{take / TABLE} has the joints {', '.join(found)}, the first episode {', '.join(names)}: give all the same"
                )
        except ValueError as error:
            joints, times, unread = np.zeros((0, len(names))), None, (str(error),)
        frames, unseen = eye.watch((decode(path, str(path)) for path in _pictures_of(take)), str(take))
        yield Episode(number, frames, joints, names, times, len(joints), rate_hz, task=None, faults=(*unread, *unseen))


def _by_number(path: Path) -> list[str | int]:
    """Orders 2.png before 10.png, as it was meant."""
    return [int(part) if part.isdigit() else part for part in re.split(r"([0-9]+)", path.name)]


def _takes(folder: Path) -> list[Path]:
    return sorted((path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")), key=_by_number)


def _pictures_of(take: Path) -> list[Path]:
    found = (path for path in take.iterdir() if path.suffix.lower() in SUFFIXES and not path.name.startswith("."))
    return sorted(found, key=_by_number)


def _read_table(path: Path) -> Rows:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:  # spreadsheets put a mark before the first name
            head, *rows = [row for row in csv.reader(file) if row]
    except FileNotFoundError as error:
        raise ValueError(f"{path} is missing: it should hold the joints, one row a picture, under their names") from error
    except (ValueError, csv.Error) as error:
        raise ValueError(
            f"{path} is empty or no table: it should hold the joints, one row a picture, under a head of their names"
        ) from error
    names = tuple(name.strip() for name in head)
    if len(set(names)) != len(names) or "" in names or names == (TIME,):
        raise ValueError(f"{path} has the head {','.join(head)}: it should give each joint a name of its own")
    numbers = np.array([_numbers(row, len(names), f"{path}, row {number}") for number, row in enumerate(rows, start=1)])
    numbers = numbers.reshape(-1, len(names))  # (T, J) or (T, 1 + J), and so where there is no row
    return (names[1:], numbers[:, 1:], numbers[:, 0]) if names[0] == TIME else (names, numbers, None)


def _numbers(row: list[str], count: int, where: str) -> list[float]:
    if len(row) != count:
        raise ValueError(f"{where} has {len(row)} columns, the head {count}: let them agree")
    try:
        return [float(text) if text.strip() else np.nan for text in row]
    except ValueError as error:
        raise ValueError(f"{where} holds {','.join(row)}: it should hold numbers") from error


def _names_and_rate(folder: Path) -> tuple[tuple[str, ...], float]:
    """The joints of the first table, and the number in the file `rate_hz` or else what the typical step of that table says."""
    table = min(folder.glob(f"*/{TABLE}"), key=lambda path: _by_number(path.parent))
    names, _, times = _read_table(table)
    if (file := folder / RATE).is_file():
        return names, _read_rate(file)
    if times is None or len(times) < 2:
        raise ValueError(f"{folder} tells no rate: write the pictures a second into {file}, or a first column {TIME} into each {TABLE}")
    if not (step_s := float(np.median(np.diff(times)))) > 0:
        raise ValueError(f"{table} has times that do not rise: {TIME} should be the seconds since the first picture")
    return names, float(f"{1 / step_s:.4g}")  # clocks jitter: more digits would say what nobody measured


def _read_rate(file: Path) -> float:
    text = file.read_text(encoding="utf-8", errors="replace").strip()
    try:
        rate_hz = float(text)
    except ValueError:
        rate_hz = np.nan
    if not 0 < rate_hz < np.inf:
        raise ValueError(f"{file} holds {text[:40]!r}: it should hold the number of pictures a second")
    return rate_hz
