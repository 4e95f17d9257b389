"""What is kept of an episode once its frames have passed: enough for every finding, small enough for a thousand episodes.

An episode of 480 x 640 frames weighs as much as all that is kept of a hundred. Pixels are compared in grey and at most `SIDE` of them
along the longer side, which is also what a network of the usual size would get to see.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8

from preimage.data.view import LONGEST, moving
from preimage.network.config import ModelConfig
from preimage.records import Episode

SIDE = LONGEST
"""Pixels along the longer side at which frames are compared: the picture of the usual network."""
CHANGE = 20.0
"""Grey levels by which a pixel must differ to count as changed: several times the noise of a camera in a dim room."""
BLANK = 3.0
"""Grey levels of spread (standard deviation) within a frame, below which it shows nothing: a covered lens, black, one colour."""
NUM_PAIRS = 6
"""Pairs of frames in an episode, a step of the model apart, in which the size of what moves is measured."""
RATE_HZ = ModelConfig.rate_hz
"""Steps a second of the model that is going to be trained, where nothing else is asked for: at 30 Hz nothing ever seems to move."""
PACE_HZ = 10.0
"""Recordings with a higher rate are compared over several steps: between two of them there is little but the noise of the camera."""


@dataclass(frozen=True, eq=False)
class Seen:
    """One episode of F frames and T rows of joints, looked through. Small pictures are (h, w), grey levels 0 to 255."""

    index: int
    rate_hz: float
    declared_length: int
    num_frames: int
    unreadable: tuple[str, ...]
    """One sentence for each part that could not be read."""
    joint_names: tuple[str, ...]
    recorded_joints: Float[np.ndarray, "T J"]
    joints: Float[np.ndarray, "T J"]
    """As recorded, and what is not finite drawn straight between its neighbours."""
    timestamps_s: Float[np.ndarray, " T"] | None
    shape: tuple[int, int, int]
    """(H, W, C) of the frames as they came."""
    first: UInt8[np.ndarray, "H W C"] | None
    last: UInt8[np.ndarray, "H W C"] | None
    background: Float32[np.ndarray, "h w"]
    """What a pixel mostly shows: the median over time."""
    unsteady: Float32[np.ndarray, "h w"]
    """How far a pixel's middle half of values spreads over time; what covers it for less than a quarter of the time leaves no trace."""
    changes: Float32[np.ndarray, "h w"]
    """Share of the frames in which a pixel differs from the background."""
    goal: Float32[np.ndarray, "h w"]
    """The last frame, small."""
    pace: int
    """Steps over which `changes_at_pace` is measured: a tenth of a second or so."""
    changes_by_step: Float32[np.ndarray, " steps"]
    """Mean change of a pixel from each frame to the next, beyond a change of brightness, each counted up to twice `CHANGE`."""
    changes_at_pace: Float32[np.ndarray, " paces"]
    """The same from each frame to that `pace` steps later."""
    same_as_before: Bool[np.ndarray, " steps"]
    """Whether frame t + 1 equals frame t in every bit."""
    blank: Bool[np.ndarray, " F"]
    moving_px: float
    """Side of the square as large as the largest thing that moves in a step of the model, median over the pairs; 0 where nothing does."""
    task: str | None
    """What it shows, in words, where the recording says."""

    @property
    def sees(self) -> bool:
        """Most of the frames show something."""
        return self.num_frames > 0 and float(self.blank.mean()) < 0.5

    @property
    def num_steps(self) -> int:
        return len(self.recorded_joints)


def look_through(episode: Episode, *, rate_hz: float = RATE_HZ) -> Seen:
    """The episode, its frames digested.

    Args:
        rate_hz: steps a second of the model that is going to be trained.
    """
    pace = max(1, round(episode.rate_hz / PACE_HZ))
    frames, num_frames = episode.frames, len(episode.frames)
    small = shrunk(frames)  # (F, h, w)
    quarters = np.percentile(small, [25, 50, 75], axis=0).astype(np.float32) if num_frames else np.zeros((3, *small.shape[1:]), np.float32)
    away = np.abs(small - quarters[1]) > CHANGE
    return Seen(
        index=episode.index,
        rate_hz=episode.rate_hz,
        declared_length=episode.declared_length,
        num_frames=num_frames,
        unreadable=episode.faults,
        joint_names=episode.joint_names,
        recorded_joints=episode.joints,
        joints=_mended(episode.joints),
        timestamps_s=episode.timestamps_s,
        shape=(frames.shape[1], frames.shape[2], frames.shape[3]),
        first=frames[0].copy() if num_frames else None,
        last=frames[-1].copy() if num_frames else None,
        background=quarters[1],
        unsteady=quarters[2] - quarters[0],
        changes=away.mean(0, dtype=np.float32) if num_frames else quarters[0],
        goal=small[-1] if num_frames else quarters[0],
        pace=pace,
        changes_by_step=_changes(small, 1),
        changes_at_pace=_changes(small, pace),
        same_as_before=np.array([np.array_equal(a, b) for a, b in itertools.pairwise(frames)], bool),
        blank=small.std((1, 2)) < BLANK if num_frames else np.zeros(0, bool),
        moving_px=_moving_px(small, max(1, round(episode.rate_hz / rate_hz))),
        task=episode.task,
    )


def shrunk(frames: UInt8[np.ndarray, "F H W C"]) -> Float32[np.ndarray, "F h w"]:
    """In grey, and no more than `SIDE` pixels along the longer side, each the mean of a block; what remains at the edge is cut off."""
    block = max(1, -(-max(frames.shape[1:3]) // SIDE))
    height, width = frames.shape[1] // block * block, frames.shape[2] // block * block
    grey = frames[:, :height, :width, :3]  # a fourth channel would be depth
    blocks = grey.reshape(len(frames), height // block, block, width // block, block, grey.shape[-1])
    return blocks.mean((2, 4, 5), dtype=np.float32)  # (F, h, w)


class Recorded(Protocol):
    """What is compared of an episode."""

    @property
    def index(self) -> int: ...
    @property
    def joint_names(self) -> tuple[str, ...]: ...
    @property
    def joints(self) -> Float[np.ndarray, "T J"]: ...
    @property
    def first(self) -> UInt8[np.ndarray, "H W C"] | None: ...


def spans(seen: Sequence[Recorded]) -> Float[np.ndarray, " J"]:
    """How far each joint goes in the whole set, the farthest hundredth on either side left out: a glitch does not widen it."""
    low, high = np.percentile(np.concatenate([one.joints for one in seen]), [1, 99], axis=0)
    return high - low


def wide_spans(seen: Sequence[Recorded]) -> Float[np.ndarray, " J"]:
    """The same to divide by: infinite where a joint goes nowhere."""
    span = spans(seen)
    return np.where(span > 0, span, np.inf)


def divisors(seen: Sequence[Seen]) -> Float[np.ndarray, " J"]:
    """What to divide each joint by, so that all that are learned count alike; infinite for the others (`data.view.moving`)."""
    return np.where(moving([one.joints for one in seen], seen[0].joint_names), wide_spans(seen), np.inf)


def _mended(joints: Float[np.ndarray, "T J"]) -> Float[np.ndarray, "T J"]:
    finite, steps = np.isfinite(joints), np.arange(len(joints))
    if finite.all():
        return joints
    mended = np.zeros_like(joints)
    for joint, known in enumerate(finite.T):
        if known.any():
            mended[:, joint] = np.interp(steps, steps[known], joints[known, joint])
    return mended


def _changes(small: Float32[np.ndarray, "F h w"], pace: int) -> Float32[np.ndarray, " changes"]:
    if len(small) <= pace:
        return np.zeros(0, np.float32)
    change = small[pace:] - small[:-pace]  # (changes, h, w)
    change -= np.median(change, axis=(1, 2), keepdims=True)
    return np.minimum(np.abs(change), 2 * CHANGE).mean((1, 2))


def _moving_px(small: Float32[np.ndarray, "F h w"], stride: int) -> float:
    if len(small) < 2:
        return 0.0
    stride = min(stride, len(small) - 1)
    pairs = np.unique(np.linspace(0, len(small) - 1 - stride, NUM_PAIRS).astype(int))
    sizes = [np.sqrt(largest_blob(np.abs(small[t + stride] - small[t]) > CHANGE)) for t in pairs]
    moving = [size for size in sizes if size > 0]
    return float(np.median(moving)) if moving else 0.0


def largest_blob(mask: Bool[np.ndarray, "h w"]) -> int:
    """The number of pixels of the largest patch that hangs together by its sides.

    >>> largest_blob(np.array([[True, True, False], [False, False, True], [False, False, True]]))
    2
    """
    labels = np.pad(np.where(mask, np.arange(1, mask.size + 1).reshape(mask.shape), 0), (0, 1))  # no run goes on in the next row
    while True:
        spread = _along_runs(_along_runs(labels).T).T
        if np.array_equal(spread, labels):
            return int(np.bincount(labels[labels > 0]).max(initial=0))
        labels = spread


def _along_runs(labels: Int[np.ndarray, "h w"]) -> Int[np.ndarray, "h w"]:
    """The greatest label of each run of labels in a row, all along it."""
    flat = labels.ravel()
    starts = np.flatnonzero(np.diff(flat > 0, prepend=flat[0] == 0))
    return np.repeat(np.maximum.reduceat(flat, starts), np.diff(starts, append=flat.size)).reshape(labels.shape)
