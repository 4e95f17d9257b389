"""Frames out of encoded pictures, PNG or JPEG, and out of videos, one at a time."""

import io
import math
from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
from av.error import FFmpegError
from PIL import Image

from preimage.data.view import Picture

MODES = "L", "RGB", "RGBA"
AGAIN = "copy the data set again"
UNDECODABLE = OSError, SyntaxError, ValueError, Image.DecompressionBombError
"""What Pillow raises where a file holds no picture."""


def decode(content: bytes | Path | None, where: str) -> Picture:
    """The frame that a PNG or JPEG holds, or a sentence on why it holds none.

    Args:
        content: the file or its bytes.
        where: what to call it in the sentence.
    """
    try:
        with Image.open(content if isinstance(content, Path) else io.BytesIO(content or b""), formats=("PNG", "JPEG")) as image:
            mode, frame = image.mode, np.asarray(image)
    except UNDECODABLE:
        return f"{where} has a frame that cannot be decoded: {AGAIN} or leave that episode out"
    if mode not in MODES:
        return f"{where} has a frame of mode {mode}: it should be 8-bit grey, RGB, or RGBA where the fourth channel is depth"
    return frame.reshape(*frame.shape[:2], -1)  # (H, W, C)


def video_frames(path: Path, *, rate_hz: float, from_s: float = 0.0, to_s: float = math.inf) -> Iterator[Picture]:
    """The colour frames that a video shows from one time until before another; where it breaks off, a sentence says so.

    Args:
        rate_hz: frames a second; times are told apart to half a frame.
    """
    if not path.is_file():
        yield f"{path} is missing: {AGAIN}"
        return
    half_s = 0.5 / rate_hz
    try:
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            if from_s > 0 and stream.time_base:
                container.seek(int(from_s / stream.time_base), stream=stream)
            for frame in container.decode(stream):
                if (frame.time or 0.0) >= to_s - half_s:
                    return
                if frame.is_corrupt:
                    yield f"{path} is damaged at {frame.time or 0.0:.2f} s: {AGAIN} or leave that episode out"
                elif not from_s or (frame.time or 0.0) >= from_s - half_s:
                    yield frame.to_ndarray(format="rgb24")
    except (FFmpegError, IndexError) as error:
        reason = getattr(error, "strerror", None) or "it has no video stream"
        yield f"{path} cannot be decoded as video ({reason}): the file is damaged or incomplete, {AGAIN}"
