"""Recordings on disk, opened as they are: LeRobotDataset v3.0 and v2.1, or plain folders of pictures and tables.

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
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import TypeVar

import numpy as np

from preimage.data import lerobot_reader, plain_folder
from preimage.data.lerobot_reader import EXTRAS, INFO
from preimage.data.lerobot_writer import save
from preimage.data.view import COLOURS, Eye, View, moving, telling_channels
from preimage.records import Body, Demonstration, Description, Episode, number_of

__all__ = ["Opened", "describe", "fingerprint", "load", "open_recordings", "read_episodes", "save"]

BY_DEFAULT = View()

Recording = TypeVar("Recording", Demonstration, Episode)


@dataclass(frozen=True, eq=False)
class Opened:
    """Recordings that were looked at, ready to be learned from."""

    demonstrations: list[Demonstration]
    view: View
    """How they were looked at: what the asked view left open is settled."""
    body: Body
    """All joints that were recorded, those that were left out too."""
    told: tuple[str, ...]
    """What there is and what was chosen, in two or three lines."""


def load(folder: Path | str, *, view: View = BY_DEFAULT, only: Collection[int] | None = None) -> list[Demonstration]:
    """The demonstrations of a data set; `open_recordings` tells besides what was chosen.

    Args:
        view: how to look at them; what it leaves open is settled by the data (`preimage.data.view`).
        only: numbers of the episodes to read; by default all.

    Raises:
        ValueError: the folder is no data set, or part of it is missing, damaged or contradicts the rest.
    """
    return open_recordings(folder, view=view, only=only).demonstrations


def open_recordings(folder: Path | str, *, view: View = BY_DEFAULT, only: Collection[int] | None = None) -> Opened:
    """The demonstrations of a data set, how they were looked at, and what to tell of it.

    Joints are in the unit they were recorded in. Of a data set that was written here all joints are taken: what is loaded is what was
    saved; of others those that move.

    Args:
        view: how to look at them; what it leaves open is settled by the episodes that are read.
        only: numbers of the episodes to read; by default all.

    Raises:
        ValueError: the folder is no data set, or part of it is missing, damaged or contradicts the rest.
    """
    folder = Path(folder)
    description = describe(folder)
    eye = Eye(view)
    episodes = [_whole(episode, folder) for episode in _reader(folder).read_episodes(folder, eye, only)]
    _refuse_other_numbers([episode.index for episode in episodes], description.num_episodes, only, folder)
    demonstrations = [_demonstration(episode, folder) for episode in episodes]
    joints = _chosen_joints(demonstrations, eye.view, folder)
    body = Body(description.joint_names, _held(demonstrations, joints), description.joint_unit)
    demonstrations = [_with_joints(each, joints, folder) for each in demonstrations]
    channels = demonstrations[0].frames.shape[-1]
    if view.colour == "keep" and (telling := telling_channels([each.frames for each in demonstrations])) != channels:
        channels, demonstrations = telling, [replace(each, frames=each.frames[..., :telling].copy()) for each in demonstrations]
    settled = replace(eye.view, joints=joints, colour=COLOURS.get(channels, "keep"))
    return Opened(demonstrations, settled, body, _told(demonstrations, description, settled, chosen=view.joints is not None))


def read_episodes(folder: Path | str, *, view: View = BY_DEFAULT, only: Collection[int] | None = None) -> Iterator[Episode]:
    """The episodes of a data set one by one, whether they are whole or not, for those who want to know what is wrong.

    All that the view asks for is applied; what it leaves open of joints and colour is left as it was recorded.

    Args:
        view: how to look at them.
        only: numbers of the episodes to read; by default all.

    Raises:
        ValueError: the folder is no data set, or what says where the episodes lie cannot be read, or the view does not fit.
    """
    folder = Path(folder)
    episodes = _reader(folder).read_episodes(folder, Eye(view), only)
    return episodes if view.joints is None else (_with_joints(episode, view.joints, folder) for episode in episodes)


def describe(folder: Path | str) -> Description:
    """What a data set says of itself: version, cameras, joints, rate and number of episodes.

    Raises:
        ValueError: the folder is no data set, or its description is damaged.
    """
    return _reader(Path(folder)).describe(Path(folder))


def fingerprint(demonstrations: Sequence[Demonstration]) -> str:
    """A short name of the data: the same for the same frames, joints (as float32) and rates, so the same before and after the disk."""
    digest = hashlib.sha256()
    for demonstration in demonstrations:
        digest.update(f"{demonstration.frames.shape} {demonstration.joints.shape} {float(demonstration.rate_hz)!r}".encode())
        digest.update(np.ascontiguousarray(demonstration.frames).data)
        digest.update(np.ascontiguousarray(demonstration.joints, dtype="<f4").data)
    return digest.hexdigest()[:12]


def _reader(folder: Path) -> ModuleType:
    """The room that reads this kind of data set; both have `describe` and `read_episodes`."""
    if not folder.is_dir():
        raise ValueError(f"{folder} is not a folder: name that of a data set")
    if (folder / INFO).is_file():
        return lerobot_reader
    if plain_folder.is_plain(folder):
        return plain_folder
    raise ValueError(
        f"{folder} has no {INFO}, so it is no LeRobot data set, and no folder in it has pictures and a joints.csv: "
        "name the folder that holds meta/ and data/, or the folders of the episodes"
    )


# From what was found to what can be learned from


def _whole(episode: Episode, folder: Path) -> Episode:
    """The episode, refused where something of it is missing."""
    steps, frames, where = len(episode.joints), len(episode.frames), f"{folder}, episode {episode.index}"
    if episode.faults:
        raise ValueError(episode.faults[0])
    if steps != episode.declared_length or steps == 0:
        raise ValueError(f"{where} has {steps} steps of joints, its index says {episode.declared_length}: copy the data set again")
    if frames != steps:
        raise ValueError(f"{where} has {frames} frames for {steps} steps of joints: copy the data set again or leave that episode out")
    return episode


def _refuse_other_numbers(found: list[int], count: int, only: Collection[int] | None, folder: Path) -> None:
    if only is not None and (absent := sorted(set(only) - set(found))):
        raise ValueError(f"{folder} has no episode {absent[0]}: it has {count}, counted from 0")
    if only is None and found != list(range(count)):
        raise ValueError(f"{folder} lists {len(found)} episodes, {INFO} counts {count} from 0: copy the data set again")


def _demonstration(episode: Episode, folder: Path) -> Demonstration:
    try:
        return Demonstration(episode.frames, episode.joints, episode.rate_hz, episode.joint_names, episode.scene)
    except ValueError as error:
        raise ValueError(f"{folder}, episode {episode.index}: {error}") from None


def _chosen_joints(demonstrations: Sequence[Demonstration], view: View, folder: Path) -> tuple[str, ...]:
    if view.joints is not None:
        return view.joints
    names, ours = demonstrations[0].joint_names, (folder / EXTRAS).is_file()
    return tuple(name for name, moves in zip(names, moving([each.joints for each in demonstrations]), strict=True) if ours or moves)


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


def _told(demonstrations: Sequence[Demonstration], description: Description, view: View, *, chosen: bool) -> tuple[str, ...]:
    assert view.recorded and view.size  # noqa: PT018
    assert view.joints
    camera = view.camera or next(iter(description.cameras))
    sizes = [f"{width}x{height}" for height, width in (view.recorded, view.size)]
    crop = f", of which {view.crop[3]}x{view.crop[2]} from row {view.crop[0]} and column {view.crop[1]}" if view.crop else ""
    seen = f", seen at {sizes[1]}" if crop or sizes[0] != sizes[1] else ""
    colour = {"grey": "in grey", "colour": "in colour", "keep": "with depth"}[view.colour]
    steps, rate_hz = sum(map(len, demonstrations)), description.rate_hz
    lines = [
        f"{description.version}: {number_of(len(demonstrations), 'episode')}, {number_of(steps, 'step')} at {rate_hz:g} Hz",
        f"camera {camera}: {sizes[0]}{crop}{seen}, {colour}",
    ]
    if left_out := [name for name in description.joint_names if name not in view.joints]:
        number = f"{len(view.joints)} of {number_of(len(description.joint_names), 'joint')}"
        why = "" if chosen else ", for they do not move"
        return *lines, f"{number}: {', '.join(view.joints)}; left out{why}: {', '.join(left_out)}"
    return *lines, f"{number_of(len(view.joints), 'joint')}: {', '.join(view.joints)}"
