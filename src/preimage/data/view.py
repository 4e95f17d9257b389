"""How a recording is looked at: which camera and which joints, which part of the picture, how large, in grey or in colour.

What a view leaves open is resolved by the data. Where no size is asked for,

- frames whose sides are multiples of 16 and at most 128 stay as they are;
- others with no side above 64 are brought to the nearest multiples of 16, except where a side is shorter than that;
- others are shrunk: the longer side to 64, the other to the multiple of 16 that is nearest to the proportions.

>>> default_size(480, 640), default_size(720, 1280), default_size(96, 128), default_size(50, 60)
((48, 64), (32, 64), (96, 128), (48, 64))

A resolved view goes with the trained model, and later pictures, of goals above all, are looked at in the same way. Nothing is stretched
further than `size` asks for: a picture of other proportions than the recordings is refused.

>>> view = resolved(View(crop=(0, 80, 480, 480)), 480, 640)
>>> large, small = (np.zeros((height, width, 3), np.uint8) for height, width in ((480, 640), (240, 320)))
>>> view.size, look(large, view, "goal.png").shape, look(small, view, "goal.png").shape
((64, 64), (64, 64, 3), (64, 64, 3))
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
import tyro
from jaxtyping import Bool, Float, UInt8
from PIL import Image

from preimage.data.angles import Wrap, find_wraps, unwrapped
from preimage.data.attitudes import followed
from preimage.data.quaternions import NUM_PARTS, Quaternion, find_quaternions
from preimage.data.rotation_vectors import NUM_PARTS as NUM_OF_VECTOR
from preimage.data.rotation_vectors import RotationVector, find_rotation_vectors
from preimage.network.config import Sensors

LADDER = 16
"""What a ladder of three levels needs: sides that are multiples of this."""
LONGEST, LONGEST_KEPT = 64, 128
"""The longer side of frames that are shrunk, and of frames that stay as they are where both sides fit the ladder (pixels)."""
LIVELY, LEAST, SHARE_OF_RANGE = 1 / 5, 1 / 100, 1 / 3
"""A joint moves where one episode in ten crosses `LIVELY` of what the liveliest joint crosses. As units differ (a gripper in metres beside
radians), it does too where that is above `LEAST`, the noise of a sensor, and `SHARE_OF_RANGE` of all angles that the joint takes in the
set: what was only put elsewhere between episodes does not move."""
GRIPPER = re.compile("grip|finger|jaw|claw|pinch")
"""In the name of a joint: its unit is its own, metres or ones beside degrees, and what it does is small beside them."""
MOST_TO_AND_FRO, EVERY_FEW_STEPS = 4.0, 0.1
"""Times that a gripper opens or closes in an episode, or in a step of it, at most; white noise makes twice as many in 20 steps."""
ALIKE = 0.02
"""Two sizes have the same proportions where they differ by less than this share: 854x480 counts as 16:9."""
COLOURS: Mapping[int, Literal["grey", "colour"]] = {1: "grey", 3: "colour"}
"""What frames of so many channels are; four are colour and depth."""

Frame = UInt8[np.ndarray, "H W C"]
Viewed = UInt8[np.ndarray, "h w c"]
"""A frame as the view shows it."""
Picture = Frame | str
"""A frame, or one sentence on why there is none."""


@dataclass(frozen=True)
class View:
    """How recordings are looked at."""

    camera: str | None = None
    """Name of the camera, or the end of it, as front for observation.images.front; needed only where there are several."""
    state: tuple[str, ...] | None = None
    """Names of the columns that hold the joints, one after the other; by default observation.state."""
    joints: tuple[str, ...] | None = None
    """Names of the joints; by default those that move, and all of them in a data set that was written here."""
    crop: tuple[int, int, int, int] | None = None
    """The part that is looked at, as top, left, height and width in pixels of the recording; by default all of it."""
    size: tuple[int, int] | None = None
    """Height and width of what the network sees; by default a large frame is shrunk to 64 along its longer side."""
    colour: Literal["keep", "grey", "colour"] = "keep"
    """Grey or colour; keep takes what there is, and grey that was copied into three channels as grey."""
    recorded: Annotated[tuple[int, int] | None, tyro.conf.Suppress] = None
    """Height and width of the recordings before the crop; the data resolve it."""
    wraps: Annotated[tuple[str, ...] | None, tyro.conf.Suppress] = None
    """Names of the joints whose readings wrap and are unwrapped (`data.angles`); the data resolve it."""
    turns: Annotated[tuple[float, ...], tyro.conf.Suppress] = ()
    """A full turn of each of them, in its unit."""
    seams: Annotated[tuple[float, ...], tyro.conf.Suppress] = ()
    """The reading above which the first of an episode is taken, for each of them."""
    quaternions: Annotated[tuple[str, ...], tyro.conf.Suppress] = ()
    """Names of the columns of quaternions, four for each (`data.quaternions`); the data resolve it."""
    poles: Annotated[tuple[float, ...], tyro.conf.Suppress] = ()
    """The reading on whose side the first of an episode is taken, four numbers for each."""
    rotations: Annotated[tuple[str, ...], tyro.conf.Suppress] = ()
    """Names of the columns of rotation vectors that leap, three for each (`data.rotation_vectors`); the data resolve it."""
    rotation_turns: Annotated[tuple[float, ...], tyro.conf.Suppress] = ()
    """A full turn of each of them, in its unit."""
    rotation_poles: Annotated[tuple[float, ...], tyro.conf.Suppress] = ()
    """The reading nearest to which the first of an episode is taken, three numbers for each."""


def wraps_of(view: View) -> list[Wrap]:
    """How the view unwraps joints."""
    return [Wrap(*wrap) for wrap in zip(view.wraps or (), view.turns, view.seams, strict=True)]


def attitudes_of(view: View) -> list[Quaternion | RotationVector]:
    """On which side the view keeps quaternions, and how it follows rotation vectors."""
    quaternions = [Quaternion(view.quaternions[part], view.poles[part]) for part in _parts(view.quaternions, NUM_PARTS)]
    parts = zip(_parts(view.rotations, NUM_OF_VECTOR), view.rotation_turns, strict=True)
    return quaternions + [RotationVector(view.rotations[part], turn, view.rotation_poles[part]) for part, turn in parts]


def _parts(names: Sequence[str], count: int) -> list[slice]:
    return [slice(begin, begin + count) for begin in range(0, len(names), count)]


def reading_by(view: View, wraps: Sequence[Wrap], attitudes: Sequence[Quaternion | RotationVector]) -> View:
    """The view that reads joints so (`wraps_of`, `attitudes_of`)."""
    quaternions = [each for each in attitudes if isinstance(each, Quaternion)]
    rotations = [each for each in attitudes if isinstance(each, RotationVector)]
    return replace(
        view,
        wraps=tuple(wrap.joint for wrap in wraps),
        turns=tuple(wrap.turn for wrap in wraps),
        seams=tuple(wrap.seam for wrap in wraps),
        quaternions=tuple(name for each in quaternions for name in each.columns),
        poles=tuple(number for each in quaternions for number in each.pole),
        rotations=tuple(name for each in rotations for name in each.columns),
        rotation_turns=tuple(each.turn for each in rotations),
        rotation_poles=tuple(number for each in rotations for number in each.pole),
    )


def made_continuous(
    recordings: Sequence[Float[np.ndarray, "_T J"]], names: Sequence[str], *, episodes: Sequence[int]
) -> tuple[list[Float[np.ndarray, "_T J"]], list[Quaternion | RotationVector], list[Wrap]]:
    """The joints of all episodes, quaternions on one side, rotation vectors followed, angles unwrapped, and what was found of these."""
    quaternions = find_quaternions(recordings, names, episodes=episodes)
    recordings = [followed(joints, names, quaternions) for joints in recordings]
    rotations = find_rotation_vectors(recordings, names, episodes=episodes)
    recordings = [followed(joints, names, rotations) for joints in recordings]
    wraps = find_wraps(recordings, names, episodes=episodes)
    return [unwrapped(joints, names, wraps) for joints in recordings], [*quaternions, *rotations], wraps


def read_through(view: View, joints: Float[np.ndarray, "T J"], names: Sequence[str]) -> Float[np.ndarray, "T J"]:
    """The joints of an episode, or of one step, as a resolved view reads them."""
    return unwrapped(followed(joints, names, attitudes_of(view)), names, wraps_of(view))


def default_size(height: int, width: int) -> tuple[int, int]:
    """Height and width of what the network sees of frames of a size, where nothing is asked for."""
    longest, fits = max(height, width), height % LADDER == width % LADDER == 0
    no_picture = longest <= LONGEST and min(height, width) < LADDER
    if no_picture or (fits and longest <= LONGEST_KEPT):
        return height, width
    rungs = (round(side * min(1, LONGEST / longest) / LADDER) for side in (height, width))
    tall, wide = (LADDER * max(1, rung) for rung in rungs)
    return tall, wide


def resolved(view: View, height: int, width: int) -> View:
    """The view with its size resolved for recordings of this height and width.

    Raises:
        ValueError: the crop does not lie in the picture, or the size is no size.
    """
    top, left, tall, wide = view.crop or (0, 0, height, width)
    if min(top, left) < 0 or min(tall, wide) < 1 or top + tall > height or left + wide > width:
        raise ValueError(
            f"the crop {view.crop} (top, left, height, width) does not lie in a picture of {height}x{width} (height x width): "
            "give one that does"
        )
    if view.size is not None and min(view.size) < 1:
        raise ValueError(f"the size {view.size} (height, width) is below one pixel: give multiples of {LADDER}")
    return replace(view, size=view.size or default_size(tall, wide), recorded=(height, width))


def look(frame: Frame, view: View, where: str) -> Viewed:
    """What a resolved view shows of a picture: of the recordings' size, of their proportions, or as small as the network sees it already.

    Args:
        where: what to call the picture where it does not fit.

    Raises:
        ValueError: the picture has other proportions than the recordings.
    """
    assert view.recorded, "resolve the view first"
    assert view.size, "resolve the view first"
    refuse_other_proportions(frame.shape[:2], view, where)
    if view.crop and (frame.shape[:2] == view.recorded or frame.shape[:2] != view.size):
        by = frame.shape[0] / view.recorded[0]
        top, left, height, width = (round(by * number) for number in view.crop)
        frame = frame[top : top + height, left : left + width]
    return coloured(scaled(frame, view.size), view.colour)


def refuse_other_proportions(came: tuple[int, ...], view: View, where: str) -> None:
    """Raises ValueError where a picture of this (height, width) cannot be looked at through the view without stretching it."""
    assert view.recorded, "resolve the view first"
    assert view.size, "resolve the view first"
    (height, width), (tall, wide) = came, view.recorded
    if (height, width) == view.size or abs(height * wide / (width * tall) - 1) < ALIKE:
        return
    other = "" if view.recorded == view.size else f" to that, or to the proportions of the recordings, {wide}x{tall}"
    raise ValueError(f"{where} is {width}x{height} pixels, the model sees {view.size[1]}x{view.size[0]}: scale or crop it{other}")


def scaled(frame: Frame, size: tuple[int, int]) -> Viewed:
    """The frame at another (height, width), each pixel the mean of those it covers."""
    if frame.shape[:2] == size:
        return frame
    # Colour and depth apart: Pillow takes a fourth channel for opacity and weighs colours with it.
    parts = (frame[..., :3], frame[..., 3:]) if frame.shape[-1] == 4 else (frame,)
    images = (Image.fromarray(np.ascontiguousarray(part[..., 0] if part.shape[-1] == 1 else part)) for part in parts)
    smaller = [np.asarray(image.resize((size[1], size[0]), Image.Resampling.BILINEAR)).reshape(*size, -1) for image in images]
    return np.concatenate(smaller, axis=-1)  # (H, W, C)


def coloured(frame: Frame, colour: Literal["keep", "grey", "colour"]) -> Viewed:
    """The frame in grey (one channel) or in colour (three), or as it is."""
    channels = frame.shape[-1]
    if colour == "grey" and channels > 1:
        grey = Image.fromarray(np.ascontiguousarray(frame[..., :3])).convert("L")
        return np.asarray(grey)[..., None]  # (H, W, 1)
    if colour == "colour" and channels != 3:
        return np.repeat(frame, 3, axis=-1) if channels == 1 else frame[..., :3]  # (H, W, 3)
    return frame


def with_channels(frame: Frame, channels: int) -> UInt8[np.ndarray, "H W c"] | None:
    """The frame with so many channels, where nothing is lost and nothing made up by it; None where that cannot be.

    >>> with_channels(np.full((1, 1, 1), 7, np.uint8), 3).tolist(), with_channels(np.uint8([[[7, 8, 9]]]), 1)
    ([[[7, 7, 7]]], None)
    """
    if frame.shape[-1] == 4 and channels != 4 and (frame[..., 3] == 255).all():
        frame = frame[..., :3]
    if frame.shape[-1] == 3 and channels == 1 and (frame == frame[..., :1]).all():
        return frame[..., :1]
    if frame.shape[-1] == 1 and channels > 1:
        frame = np.repeat(frame, 3, axis=-1)  # (H, W, 3)
    if frame.shape[-1] == 3 and channels == 4:
        return np.concatenate([frame, np.full_like(frame[..., :1], 255)], axis=-1)  # (H, W, 4)
    return frame if frame.shape[-1] == channels else None


def telling_channels(recordings: Sequence[UInt8[np.ndarray, "_F H W C"]]) -> int:
    """How many channels say something: not a fourth that is opaque everywhere, not three that are the same grey everywhere."""
    channels = recordings[0].shape[-1]
    if channels == 4 and all((frames[..., 3] == 255).all() for frames in recordings):
        channels = 3
    if channels == 3 and all((frames[..., :3] == frames[..., :1]).all() for frames in recordings):
        channels = 1
    return channels


def moving(recordings: Sequence[Float[np.ndarray, "_T J"]], names: Sequence[str] = ()) -> Bool[np.ndarray, " J"]:
    """Which joints move; all of them where none does.

    Args:
        names: of the joints: what is called a gripper moves however small its numbers are, unless it trembles.
    """
    within = np.quantile([np.ptp(joints, axis=0) for joints in recordings], 0.9, axis=0)  # (J,)
    overall = np.ptp(np.concatenate(recordings), axis=0)
    lively, above_noise = within >= LIVELY * within.max(), within >= LEAST * within.max()
    above_noise |= [bool(GRIPPER.search(name.lower())) for name in names or [""] * len(within)] & ~_trembling(recordings)
    moves = (within > 0) & (lively | (above_noise & (within >= SHARE_OF_RANGE * overall)))
    return moves if moves.any() else np.ones_like(moves)


def _trembling(recordings: Sequence[Float[np.ndarray, "_T J"]]) -> Bool[np.ndarray, " J"]:
    """Which joints go to and fro as noise does, all their steps together so many times as long as they get."""
    ways = [np.abs(np.diff(joints, axis=0)).sum(0) for joints in recordings]
    sizes = [np.maximum(np.ptp(joints, axis=0), np.finfo(float).tiny) for joints in recordings]
    most = [max(MOST_TO_AND_FRO, EVERY_FEW_STEPS * len(joints)) for joints in recordings]
    return np.median([way / size / times for way, size, times in zip(ways, sizes, most, strict=True)], axis=0) > 1


class Eye:
    """Looks at the pictures of a data set one by one, so that few large ones are in memory; the first one resolves the view."""

    def __init__(self, view: View) -> None:
        self.view = view
        self._kind: tuple[int, ...] | None = None

    def watch(self, pictures: Iterable[Picture], where: str) -> tuple[UInt8[np.ndarray, "F H W C"], tuple[str, ...]]:
        """The frames of an episode as the view shows them, of no size where there is none, and a sentence for each that is missing.

        Raises:
            ValueError: the view does not fit the pictures.
        """
        frames, faults = [], []
        for step, picture in enumerate(pictures):
            if isinstance(picture, str):
                faults.append(picture)
                continue
            self._resolve(picture, where)
            assert self._kind
            alike = picture if self.view.colour != "keep" else with_channels(picture, self._kind[-1])
            if picture.shape[:2] != self._kind[:2]:
                faults.append(
                    f"{where}, step {step} has a frame of {picture.shape}, the first is of {self._kind} (H, W, C): give all one size"
                )
            elif alike is None:
                kinds = [{1: "in grey", 3: "in colour"}.get(each, "with a fourth channel") for each in (picture.shape[-1], self._kind[-1])]
                faults.append(
                    f"{where}, step {step} has a frame {kinds[0]}, the first is {kinds[1]}: look at all alike, by --view.colour grey"
                )
            else:
                frames.append(look(alike, self.view, where))
        return np.stack(frames) if frames else np.zeros((0, 0, 0, 1), np.uint8), tuple(faults)

    def _resolve(self, picture: Frame, where: str) -> None:
        if self._kind is None:
            self._kind = picture.shape
            self.view = self.view if self.view.recorded else resolved(self.view, *picture.shape[:2])


def seen_by(sensors: Sensors) -> View:
    """The view that shows recordings of a model's own frame size as the model sees them."""
    size = sensors.height, sensors.width
    return View(joints=sensors.joint_names, size=size, colour=COLOURS.get(sensors.channels, "keep"), recorded=size, wraps=())
