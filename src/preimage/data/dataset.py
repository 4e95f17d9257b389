"""Recordings on disk, opened as they are: LeRobotDataset v3.0, v2.1 and v2.0, or plain folders of pictures and tables.

>>> import tempfile
>>> from preimage.data.lerobot_writer import write_files
>>> demonstration = Demonstration(np.zeros((3, 8, 8, 1), np.uint8), np.ones((3, 2)), rate_hz=10.0, joint_names=("yaw", "shoulder"))
>>> with tempfile.TemporaryDirectory() as place:
...     write_files([demonstration, demonstration], Path(place) / "reach", task="reach the mark")
...     loaded = load(f"{place}/reach")
>>> len(loaded), loaded[0].frames.shape, loaded[0].joint_names, loaded[0].rate_hz
(2, (3, 8, 8, 1), ('yaw', 'shoulder'), 10.0)
>>> fingerprint(loaded) == fingerprint([demonstration, demonstration])
True
"""

import hashlib
import itertools
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import TypeVar

import numpy as np

from preimage.data import lerobot_reader, plain_folder
from preimage.data.attitudes import is_followed
from preimage.data.clocks import is_clock
from preimage.data.files import leave_out
from preimage.data.lerobot_info import EXTRAS, INFO
from preimage.data.questions import questions_about
from preimage.data.summary import cannot_unwrap, reads_past, several_each, summary
from preimage.data.view import (
    COLOURS,
    Eye,
    View,
    attitudes_of,
    made_continuous,
    moving,
    read_through,
    reading_by,
    telling_channels,
    wraps_of,
)
from preimage.records import Body, Demonstration, Description, Episode, listed

__all__ = ["Opened", "describe", "episode_numbers", "fingerprint", "load", "open_recordings", "read_episodes"]

BY_DEFAULT = View()
OTHER_FORMATS = {".npy", ".npz", ".h5", ".hdf5", ".zarr", ".bag", ".mcap", ".db3", ".tfrecord", ".arrow", ".pkl", ".zip", ".tar", ".mp4"}
"""Of files in which others keep recordings."""
MOST_LOOKED_AT = 1000
"""Entries of a folder that are looked at for a data set: it may be anybody's home."""

Recording = TypeVar("Recording", Demonstration, Episode)


@dataclass(frozen=True, eq=False)
class Opened:
    """Recordings that were looked at, ready to be learned from."""

    demonstrations: list[Demonstration]
    episodes: tuple[int, ...]
    """The number of each of them in the data set."""
    view: View
    """How they were looked at: what the asked view left open is resolved."""
    body: Body
    """All joints that were recorded, those that were left out too."""
    task: str | None
    """What they show, in words, where the data set gives one task."""
    summary: tuple[str, ...]
    """What there is and what was chosen, in a few lines."""


def load(
    folder: Path | str, *, view: View = BY_DEFAULT, only: Collection[int] | None = None, without: Collection[int] = ()
) -> list[Demonstration]:
    """The demonstrations of a data set; `open_recordings` reports besides what was chosen.

    Args:
        view: how to look at them; what it leaves open is resolved by the data (`preimage.data.view`).
        only: numbers of the episodes to read; by default all.
        without: numbers of episodes to leave out.

    Raises:
        ValueError: the folder is no data set, or part of it is missing, damaged or contradicts the rest.
    """
    return open_recordings(folder, view=view, only=only, without=without).demonstrations


def open_recordings(
    folder: Path | str,
    *,
    view: View = BY_DEFAULT,
    only: Collection[int] | None = None,
    without: Collection[int] = (),
    progress: Callable[..., None] | None = None,
    look: Callable[[Episode], None] | None = None,
) -> Opened:
    """The demonstrations of a data set, how they were looked at, and a summary of it.

    Joints are in the unit they were recorded in; angles that wrap are unwrapped. Of a data set that was written here all joints are taken:
    what is loaded is what was saved; of others those that move and are no clocks.

    Args:
        view: how to look at them; what it leaves open is resolved by the episodes that are read.
        only: numbers of the episodes to read; by default all.
        without: numbers of episodes to leave out.
        progress: called after each episode with the number that is `done` and the `total`.
        look: called with each episode as `read_episodes` has it.

    Raises:
        ValueError: the folder is no data set, or part of it is missing, damaged or contradicts the rest.
    """
    folder = Path(folder)
    room, eye, chosen = _reader(folder), Eye(view), _chosen(folder, only, without)
    episodes = []
    for episode in room.read_episodes(folder, eye, chosen):
        episodes.append(_whole(episode, folder))
        if look:
            look(episode if view.joints is None else _with_joints(episode, view.joints, folder))
        if progress:
            progress(done=len(episodes), total=len(chosen))
    episodes, empty = _without_empty(episodes, view.joints or ())
    demonstrations = [_demonstration(episode, folder) for episode in episodes]
    numbers = tuple(episode.index for episode in episodes)
    names = demonstrations[0].joint_names
    if view.joints is None:
        _refuse_what_is_asked(demonstrations, folder)
    recorded = [each.joints for each in demonstrations]
    if view.wraps is None:
        read, attitudes, wraps = made_continuous(recorded, names, episodes=numbers)
    else:  # as the run does that the recordings are looked at for
        read, attitudes, wraps = [read_through(view, each, names) for each in recorded], attitudes_of(view), wraps_of(view)
    demonstrations = [replace(each, joints=joints) for each, joints in zip(demonstrations, read, strict=True)]
    joints = view.joints or _chosen_joints(demonstrations, folder)
    if lost := [wrap for wrap in wraps if wrap.impossible and wrap.joint in joints]:
        raise ValueError(f"{folder}: {': '.join(cannot_unwrap(lost[0], [name for name in joints if name != lost[0].joint]))}")
    kept = [wrap for wrap in wraps if wrap.joint in joints]
    description = room.describe(folder, view.state)
    body = Body(names, _held(demonstrations, joints), description.joint_unit)
    demonstrations = [_with_joints(each, joints, folder) for each in demonstrations]
    channels = demonstrations[0].frames.shape[-1]
    if view.colour == "keep" and (telling := telling_channels([each.frames for each in demonstrations])) != channels:
        channels, demonstrations = telling, [replace(each, frames=each.frames[..., :telling].copy()) for each in demonstrations]
    resolved = reading_by(replace(eye.view, joints=joints, colour=COLOURS.get(channels, "keep")), kept, attitudes)
    tasks = {episode.task for episode in episodes}
    lines = [*summary(demonstrations, numbers, description, resolved, chosen=view.joints is not None, empty=empty)]
    lines += [reads_past(wrap, len(numbers)) for wrap in kept if wrap.episodes]
    lines += [is_followed(each, len(numbers)) for each in attitudes if each.episodes]
    return Opened(demonstrations, numbers, resolved, body, tasks.pop() if len(tasks) == 1 else None, tuple(lines))


def read_episodes(
    folder: Path | str, *, view: View = BY_DEFAULT, only: Collection[int] | None = None, without: Collection[int] = ()
) -> Iterator[Episode]:
    """The episodes of a data set one by one, whether they are whole or not, for those who want to know what is wrong.

    All that the view asks for is applied; what it leaves open of joints, wraps and colour is left as it was recorded.

    Args:
        view: how to look at them.
        only: numbers of the episodes to read; by default all.
        without: numbers of episodes to leave out.

    Raises:
        ValueError: the folder is no data set, or what says where the episodes lie cannot be read, or the view does not fit.
    """
    folder = Path(folder)
    episodes = _reader(folder).read_episodes(folder, Eye(view), _chosen(folder, only, without))
    return episodes if view.joints is None else (_with_joints(episode, view.joints, folder) for episode in episodes)


def describe(folder: Path | str, *, state: tuple[str, ...] | None = None) -> Description:
    """What a data set says of itself: version, cameras, joints, rate and number of episodes.

    Args:
        state: the columns that hold the joints; by default observation.state.

    Raises:
        ValueError: the folder is no data set, or its description is damaged.
    """
    return _reader(Path(folder)).describe(Path(folder), state)


def episode_numbers(folder: Path | str) -> list[int]:
    """The numbers of the episodes of a data set, in order; there may be gaps between them.

    Raises:
        ValueError: the folder is no data set, or what says where the episodes lie cannot be read.
    """
    return _reader(Path(folder)).numbers_of(Path(folder))


def fingerprint(demonstrations: Sequence[Demonstration]) -> str:
    """A short name of the data: the same for the same frames, joints (as float32) and rates, so the same before and after the disk."""
    digest = hashlib.sha256()
    for demonstration in demonstrations:
        digest.update(f"{demonstration.frames.shape} {demonstration.joints.shape} {float(demonstration.rate_hz)!r}".encode())
        digest.update(np.ascontiguousarray(demonstration.frames).data)
        digest.update(np.ascontiguousarray(demonstration.joints, dtype="<f4").data)
    return digest.hexdigest()[:12]


def written_here(folder: Path) -> bool:
    """Whether `save` wrote the data set: what it holds was learned from or meant to be, and all of its joints are joints."""
    return (folder / EXTRAS).is_file()


def _reader(folder: Path) -> ModuleType:
    """The room that reads this kind of data set; both have `describe`, `numbers_of` and `read_episodes`."""
    if not folder.is_dir():
        raise ValueError(f"{folder} is not a folder: name that of a data set")
    if (folder / INFO).exists():
        return lerobot_reader
    if plain_folder.is_plain(folder):
        return plain_folder
    if (folder / "config.json").is_file():
        raise ValueError(f"{folder} holds a trained model (config.json) and no recordings: name the folder of the data set")
    raise ValueError(
        f"{folder} has no {INFO}, so it is no LeRobot data set, and no folder in it has pictures and a joints.csv: {_what_to_name(folder)}"
    )


def _what_to_name(folder: Path) -> str:
    """Where a data set lies instead, above or not far below; or what is to be made of recordings in files of another kind."""
    around = [folder.parent, *sorted(path for depth in ("*", "*/*") for path in itertools.islice(folder.glob(depth), MOST_LOOKED_AT))]
    for other in around:
        if other.is_dir() and ((other / INFO).is_file() or plain_folder.is_plain(other)):
            return f"name {other}, which is one"
    if tables := sorted(path for path in itertools.islice(folder.glob("*/*"), MOST_LOOKED_AT) if path.suffix.lower() == ".csv"):
        return f"a table of joints is called {plain_folder.TABLE}, and {tables[0]} is not"
    if others := sorted({f".{part}" for path in around[1:] for part in re.split(r"[.-]", path.name)[1:]} & OTHER_FORMATS):
        return f"convert its {' and '.join(others)} files to a LeRobot data set, or to a folder an episode with pictures and joints.csv"
    return "name the folder that holds meta/ and data/, or the folders of the episodes"


def _chosen(folder: Path, only: Collection[int] | None, without: Collection[int]) -> list[int]:
    """The numbers of the episodes that are asked for; ValueError where one is not there, or none is left."""
    there = episode_numbers(folder)
    if absent := sorted({*(only or ()), *without} - {*there}):
        raise ValueError(f"{folder} has no episode {absent[0]}: it has {listed(there)}")
    chosen = [number for number in there if (only is None or number in only) and number not in without]
    if not chosen:
        raise ValueError(f"no episode of {folder} is left: name one or more, or leave fewer out")
    return chosen


# From what was found to what can be learned from


def _whole(episode: Episode, folder: Path) -> Episode:
    """The episode, refused where something of it is missing."""
    steps, frames, where = len(episode.joints), len(episode.frames), f"{folder}, episode {episode.index}"
    if episode.faults:
        raise ValueError(episode.faults[0])
    if steps != episode.declared_length or steps == 0:
        raise ValueError(f"{where} has {steps} steps of joints, its index says {episode.declared_length}: {leave_out(episode.index)}")
    if frames != steps:
        raise ValueError(
            f"{where} has {frames} frames for {steps} steps of joints{several_each(frames, steps)}: {leave_out(episode.index)}"
        )
    return episode


def _demonstration(episode: Episode, folder: Path) -> Demonstration:
    try:
        return Demonstration(episode.frames, episode.joints, episode.rate_hz, episode.joint_names, episode.scene)
    except ValueError as error:
        raise ValueError(f"{folder}, episode {episode.index}: {error}; leave it out by --without-episodes {episode.index}") from None


def _without_empty(episodes: Sequence[Episode], kept: Collection[str]) -> tuple[list[Episode], list[str]]:
    """The episodes without the columns that hold no number in any of them, but for those to be kept, and the names of these columns."""
    names = episodes[0].joint_names
    if any(episode.joint_names != names for episode in episodes):
        return list(episodes), []
    empty = np.all([np.isnan(episode.joints).all(0) for episode in episodes], axis=0) & [name not in kept for name in names]
    if not empty.any() or empty.all():
        return list(episodes), []
    rest = tuple(name for name, is_empty in zip(names, empty, strict=True) if not is_empty)
    dropped = [name for name in names if name not in rest]
    return [replace(episode, joints=episode.joints[:, ~empty], joint_names=rest) for episode in episodes], dropped


def _refuse_what_is_asked(demonstrations: Sequence[Demonstration], folder: Path) -> None:
    """Raises ValueError where only the user knows whether a column is to be learned; of a data set that was written here all are."""
    if written_here(folder):
        return
    if questions := questions_about(demonstrations[0].joint_names, [each.joints for each in demonstrations]):
        raise ValueError(f"{folder}: {questions[0]}")


def _chosen_joints(demonstrations: Sequence[Demonstration], folder: Path) -> tuple[str, ...]:
    """Those that move and are no clocks; of a data set that was written here all."""
    names, joints = demonstrations[0].joint_names, [each.joints for each in demonstrations]
    if written_here(folder):
        return names
    free = [not is_clock(name) for name in names]
    if not any(free):
        raise ValueError(f"{folder} has no joints beside its clocks ({', '.join(names)}): choose what is to be learned by --view.joints")
    candidates = [name for name, is_free in zip(names, free, strict=True) if is_free]
    return tuple(name for name, moves in zip(candidates, moving([each[:, free] for each in joints], candidates), strict=True) if moves)


def _held(demonstrations: Sequence[Demonstration], joints: tuple[str, ...]) -> dict[str, float]:
    starts = np.median([each.joints[0] for each in demonstrations], axis=0).tolist()
    return {name: start for name, start in zip(demonstrations[0].joint_names, starts, strict=True) if name not in joints}


def _with_joints(recording: Recording, joints: tuple[str, ...], folder: Path) -> Recording:
    names = recording.joint_names
    if unknown := [name for name in joints if name not in names]:
        raise ValueError(f"{folder} has no joint {unknown[0]}: it has {', '.join(names)}")
    if not joints or len(set(joints)) != len(joints):
        raise ValueError(f"joints are {', '.join(joints) or 'none'}: name one or more, each once")
    if joints == names:
        return recording
    columns = [names.index(name) for name in joints]
    return replace(recording, joints=recording.joints[:, columns], joint_names=joints)
