"""Where a start or a goal comes from: an image file, or a step of a recorded demonstration.

cup.png            an image file: a frame, no joints
DATA:7             the last step of episode 7 (as a goal), or its first (as a start)
DATA:7:12          step 12 of episode 7
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from preimage.data.dataset import episode_numbers, load
from preimage.data.decoding import NotShown, picture
from preimage.data.view import View, look, seen_by, with_channels
from preimage.network.config import Sensors
from preimage.records import Percept, Scene, listed


@dataclass(frozen=True, eq=False)
class Found:
    """A percept and, where it comes from a simulated demonstration, the scene it was recorded in."""

    percept: Percept
    scene: Scene | None = None


def find_percept(source: str, sensors: Sensors, *, view: View | None = None, default_step: int) -> Found:
    """The percept that a source names, as the model saw its recordings.

    Args:
        view: how the model saw its recordings (`storage.runs.read_view`); by default whole and in its own size.
        default_step: the step of an episode where the source names none: 0 for a start, -1 for a goal.

    Raises:
        ValueError: there is no such file, data set, episode or step, or the file is no image, or the picture does not fit the view.
    """
    view = view or seen_by(sensors)
    if Path(source).is_file():
        return Found(Percept(frame=read_image(Path(source), sensors, view)))
    splits = [source.rsplit(":", count) for count in (1, 2)]  # from the right, for a path may hold colons itself
    named = [(folder, numbers) for folder, *numbers in splits if numbers and Path(folder).is_dir()]
    if not named:
        raise ValueError(f"{source} is neither an image file nor a step of a data set: give FILE, DATA:EPISODE or DATA:EPISODE:STEP")
    folder, numbers = named[0]
    try:
        episode, step = int(numbers[0]), int(numbers[1]) if len(numbers) == 2 else default_step
    except ValueError as error:
        raise ValueError(f"{source} does not name an episode by number: give DATA:EPISODE or DATA:EPISODE:STEP") from error
    if episode not in (there := episode_numbers(folder)):
        raise ValueError(f"{folder} has episodes {listed(there)}, not {episode}")
    (demonstration,) = load(folder, view=view, only=(episode,))
    if not -len(demonstration) <= step < len(demonstration):
        raise ValueError(f"episode {episode} of {folder} has steps 0 to {len(demonstration) - 1}, not {step}")
    return Found(demonstration[step], demonstration.scene)


def read_image(path: Path, sensors: Sensors, view: View | None = None) -> UInt8[np.ndarray, "H W C"]:
    """An image file as a frame (H, W, C), cropped, scaled and in grey or colour as the model saw its recordings.

    Args:
        view: how the model saw its recordings (`storage.runs.read_view`); by default whole and in its own size.

    Raises:
        ValueError: it is no image, has other proportions than the recordings, or lacks the depth that the model sees.
    """
    try:
        whole = picture(path)
    except NotShown as error:
        raise ValueError(f"{path} is not an image that can be read: it {error}") from error
    if sensors.channels != 4 and with_channels(whole, 3) is None:
        raise ValueError(f"{path} is transparent in places, and what is to be seen there nobody can say: save it opaque")
    frame = look(whole, view or seen_by(sensors), str(path))
    if sensors.channels == 4 and frame.shape[-1] != 4:
        raise ValueError(f"{path} has no depth, which the model sees: give a PNG whose fourth channel is the depth")
    return np.array(frame)  # a copy, for torch wants to own it
