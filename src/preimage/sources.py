"""Where a start or a goal comes from: an image file, or a step of a recorded demonstration.

cup.png            an image file: a frame, no joints
DATA:7             the last step of episode 7 (as a goal), or its first (as a start)
DATA:7:12          step 12 of episode 7
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from preimage.dataset import load
from preimage.model import Sensors
from preimage.records import Percept, Scene


@dataclass(frozen=True, eq=False)
class Found:
    """A percept and, where it comes from a simulated demonstration, the scene it was recorded in."""

    percept: Percept
    scene: Scene | None = None


def find_percept(source: str, sensors: Sensors, *, default_step: int) -> Found:
    """The percept that a source names.

    Args:
        default_step: the step of an episode where the source names none: 0 for a start, -1 for a goal.

    Raises:
        ValueError: there is no such file, data set, episode or step, or the file is no image.
    """
    if Path(source).is_file():
        return Found(Percept(frame=read_image(Path(source), sensors)))
    splits = [source.rsplit(":", count) for count in (1, 2)]  # from the right, for a path may hold colons itself
    named = [(folder, numbers) for folder, *numbers in splits if numbers and Path(folder).is_dir()]
    if not named:
        raise ValueError(f"{source} is neither an image file nor a step of a data set: give FILE, DATA:EPISODE or DATA:EPISODE:STEP")
    folder, numbers = named[0]
    try:
        episode, step = int(numbers[0]), int(numbers[1]) if len(numbers) == 2 else default_step
    except ValueError as error:
        raise ValueError(f"{source} does not name an episode by number: give DATA:EPISODE or DATA:EPISODE:STEP") from error
    demonstrations = load(folder)
    if not 0 <= episode < len(demonstrations):
        raise ValueError(f"{folder} has episodes 0 to {len(demonstrations) - 1}, not {episode}")
    demonstration = demonstrations[episode]
    if not -len(demonstration) <= step < len(demonstration):
        raise ValueError(f"episode {episode} of {folder} has steps 0 to {len(demonstration) - 1}, not {step}")
    return Found(demonstration[step], demonstration.scene)


def read_image(path: Path, sensors: Sensors) -> np.ndarray:
    """An image file as a frame (H, W, C), in grey where the model sees grey.

    Raises:
        ValueError: it is no image, or of another size than the model's frames.
    """
    try:
        with Image.open(path) as image:
            picture = np.array(image.convert("L" if sensors.channels == 1 else "RGB"))  # a copy, for torch wants to own it
    except OSError as error:
        raise ValueError(f"{path} is not an image that can be read: give a PNG or JPEG file") from error
    frame = picture.reshape(*picture.shape[:2], -1)
    wanted = sensors.height, sensors.width
    if frame.shape[:2] != wanted:
        raise ValueError(f"{path} is {frame.shape[1]}x{frame.shape[0]} pixels, the model sees {wanted[1]}x{wanted[0]}: scale or crop it")
    return frame
