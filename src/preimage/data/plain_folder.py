"""Recordings without a format: a folder, in it one folder an episode, in that pictures and a table of joints.

    my-data/rate_hz             pictures a second, one number; not needed where joints.csv has a clock
    my-data/take 1/joints.csv   a head of names, then one row a picture; a clock may stand among the joints: `time_s`, in seconds
    my-data/take 1/0001.png     pictures: PNG, JPEG, WebP, BMP or TIFF; their names put them in order, and numbers are read as numbers

Episodes are counted from 0 in the order of their folders' names. A folder without a table and without pictures is no episode.
"""

import re
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from preimage.data.clocks import bounds, is_rate, rate_of
from preimage.data.decoding import NAMED, SUFFIXES, decode
from preimage.data.files import leave_out, read_text
from preimage.data.tables import Table, read_table
from preimage.data.view import Eye
from preimage.records import Description, Episode

TABLE, RATE = "joints.csv", "rate_hz"
CAMERA = "camera"
"""What the one camera is called."""


def is_plain(folder: Path) -> bool:
    """Whether the folder holds episodes as folders with a table of joints."""
    return any(folder.glob(f"*/{TABLE}"))


def describe(folder: Path, state: tuple[str, ...] | None = None) -> Description:
    """What the first episode and the rate tell.

    Raises:
        ValueError: the first episode cannot be read, or there is no rate.
    """
    takes = _takes(folder)
    names, rate_hz = _names_and_rate(folder)
    pictures = _pictures_of(takes[0])
    first = decode(pictures[0], str(pictures[0])) if pictures else _without_pictures(takes[0])
    if isinstance(first, str):
        raise ValueError(first)
    height, width, channels = first.shape
    return Description("folder", {CAMERA: (height, width, channels)}, names, rate_hz, len(takes))


def numbers_of(folder: Path) -> list[int]:
    """The numbers of its episodes."""
    return list(range(len(_takes(folder))))


def read_episodes(folder: Path, eye: Eye, only: Collection[int] | None = None) -> Iterator[Episode]:
    """The episodes one by one; what cannot be read of one is reported in its faults.

    Args:
        only: numbers of the episodes to read; by default all.

    Raises:
        ValueError: there is no rate, the first table cannot be read, or another camera or state is asked for.
    """
    if eye.view.camera not in (None, CAMERA):
        raise ValueError(f"{folder} has no camera {eye.view.camera}: a folder of pictures has one, and it needs no name")
    if eye.view.state is not None:
        raise ValueError(f"{folder} has its joints in {TABLE}: leave --view.state out, and choose joints by --view.joints")
    names, rate_hz = _names_and_rate(folder)
    for number, take in enumerate(_takes(folder)):
        if only is not None and number not in only:
            continue
        table, unread = _read(take / TABLE, names)
        pictures = _pictures_of(take)
        unseen = () if pictures else (_without_pictures(take),)
        remedy = leave_out(number)
        frames, unfit = eye.watch((decode(path, str(path), remedy=remedy) for path in pictures), str(take))
        faults = (*unread, *unseen, *unfit)
        clock = table.clock(rate_hz)
        times_s = clock.times_s if clock else None
        yield Episode(number, frames, table.joints, names, times_s, len(table.joints), rate_hz, task=None, faults=faults)


def _read(path: Path, names: tuple[str, ...]) -> tuple[Table, tuple[str, ...]]:
    """The table, or an empty one and the sentence on why it cannot be taken."""
    try:
        table = read_table(path)
        if sorted(table.names) != sorted(names):
            raise ValueError(f"{path} has the joints {', '.join(table.names)}, the first episode {', '.join(names)}: give all the same")
    except ValueError as error:
        return Table(names, np.zeros((0, len(names))), {}), (str(error),)
    return table.in_order(names), ()


def _by_number(path: Path) -> list[str | int]:
    """Orders 2.png before 10.png, as it was meant."""
    return [int(part[:100]) if part.isdecimal() else part for part in re.split(r"([0-9]+)", path.name)]


def _takes(folder: Path) -> list[Path]:
    folders = (path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    return sorted((path for path in folders if (path / TABLE).exists() or _pictures_of(path)), key=_by_number)


def _pictures_of(take: Path) -> list[Path]:
    found = (path for path in take.iterdir() if path.suffix.lower() in SUFFIXES and not path.name.startswith(".") and not path.is_dir())
    return sorted(found, key=_by_number)


def _without_pictures(take: Path) -> str:
    """A sentence on what lies there instead."""
    inside = {path.name: len(_pictures_of(path)) for path in sorted(take.iterdir()) if path.is_dir()}
    counted = [f"a folder {name} with {count}" for name, count in inside.items() if count]
    others = sorted({path.suffix.lower() for path in take.iterdir() if path.is_file() and path.suffix and path.name != TABLE})
    there = " and ".join(counted) or (f"a file of the kind {', '.join(others)}" if others else "nothing else")
    help_ = f"put the pictures beside {TABLE}" if counted else f"put {NAMED} files there"
    return f"{take} has no picture beside {TABLE} (there is {there}): {help_}"


def _names_and_rate(folder: Path) -> tuple[tuple[str, ...], float]:
    """The joints of the first table, and the number in the file `rate_hz` or else what the clock of that table says."""
    path = min(folder.glob(f"*/{TABLE}"), key=lambda path: _by_number(path.parent))
    table = read_table(path)
    if (file := folder / RATE).is_file():
        return table.names, _read_rate(file)
    clock = table.clock(None)
    if clock is None and table.clocks:
        raise ValueError(f"{path} has times that do not rise ({', '.join(table.clocks)}): a clock counts on from picture to picture")
    if clock is None or len(clock.times_s) < 2:
        raise ValueError(f"{folder} tells no rate: write the pictures a second into {file}, or a column time_s into each {TABLE}")
    return table.names, rate_of(clock, str(path))


def _read_rate(file: Path) -> float:
    text = read_text(file).strip()
    try:
        rate_hz = float(text.replace(",", "."))
    except ValueError:
        rate_hz = np.nan
    if not is_rate(rate_hz):
        raise ValueError(f"{file} holds {text[:40]!r}: it should hold the number of pictures a second ({bounds()})")
    return rate_hz
