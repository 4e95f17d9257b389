"""Frames out of pictures and videos, one at a time: one decoder for the pictures of recordings, of starts and of goals.

Whatever the file holds comes out as a viewer would show it, in 8 bits:

- the orientation that a camera wrote into EXIF is applied, and in a video the matrix by which players turn and mirror it;
- black and white is grey; a palette, CMYK and other colour spaces are RGB;
- grey with opacity is RGBA, a palette with transparency too (a fourth channel is depth, unless it is opaque everywhere);
- of 16 bits the upper 8 are taken, in grey as in colour.

Pillow is given the names of the formats, for it starts Ghostscript for an EPS file whatever its name, and the size is looked at before a
pixel is unpacked.
"""

import io
import math
import struct
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
from av.error import FFmpegError
from av.sidedata.sidedata import Type as SideData
from PIL import Image

from preimage.data.files import AGAIN, POINTER, is_pointer, validate_file
from preimage.data.view import Frame, Picture, Viewed

FORMATS = "PNG", "JPEG", "WEBP", "BMP", "TIFF"
SUFFIXES = ".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff"
NAMED = "PNG, JPEG, WebP, BMP or TIFF"
MOST_PIXELS = 64_000_000
"""Larger than the pictures of any camera on a robot; unpacked, so many take 0.2 GB."""
ALMOST_UPRIGHT = 0.02
"""Sine of an angle, about a degree, by which a matrix of quarter turns may be off."""
KEPT = "L", "RGB", "RGBA"
WITH_OPACITY = "LA", "La", "PA", "RGBa"
ORIENTATION = 0x0112
ORIENTATION_OF_MATRIX = {
    ((1, 0), (0, 1)): 1,
    ((-1, 0), (0, 1)): 2,
    ((-1, 0), (0, -1)): 3,
    ((1, 0), (0, -1)): 4,
    ((0, 1), (1, 0)): 5,
    ((0, 1), (-1, 0)): 6,
    ((0, -1), (-1, 0)): 7,
    ((0, -1), (1, 0)): 8,
}
"""Which orientation of EXIF the display matrix of a video asks for: of its rows, where a column and where a row of pixels is to go."""
UNDECODABLE = (
    *(OSError, SyntaxError, ValueError, EOFError, KeyError, IndexError, TypeError, AttributeError, OverflowError, NotImplementedError),
    *(struct.error, zlib.error, Image.DecompressionBombError),
)
"""What Pillow raises where a file holds no picture: its readers take a damaged header at its word."""


class NotShown(ValueError):
    """Why there is no frame, as the end of a sentence that begins with the name of the file."""


def decode(content: bytes | Path | None, where: str, *, remedy: str = AGAIN) -> Picture:
    """The frame of a recording that a picture holds, or a sentence on why it holds none.

    Args:
        content: the file or its bytes.
        where: what to call it in the sentence.
        remedy: what would help where it is damaged.
    """
    try:
        return picture(content)
    except NotShown as error:
        return f"{where} has a frame that {error}: {remedy}"


def picture(content: bytes | Path | None) -> Frame:
    """The picture in a file or in its bytes, as a viewer shows it, in 8 bits.

    Raises:
        NotShown: it holds none that can be shown.
    """
    if isinstance(content, Path) and not content.is_file():
        raise NotShown("is not a regular file")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what is odd in a file but can be read; the size is looked at below
        try:
            with Image.open(content if isinstance(content, Path) else io.BytesIO(content or b""), formats=FORMATS) as image:
                if image.width * image.height > MOST_PIXELS:
                    raise NotShown(f"has {image.width}x{image.height} pixels, more than {MOST_PIXELS / 1e6:.0f} million")
                image.load()
                frame, orientation = _in_8_bits(image), _orientation(image)
        except NotShown:
            raise
        except (*UNDECODABLE, MemoryError) as error:
            raise NotShown(_cause(content)) from error
    return upright(frame, orientation)


def upright(frame: Frame, orientation: int) -> Viewed:
    """The frame as it is to be looked at, given the orientation of EXIF (1 to 8; anything else says nothing)."""
    if orientation in (5, 6, 7, 8):
        frame = frame.swapaxes(0, 1)  # (W, H, C)
    if orientation in (2, 3, 6, 7):
        frame = frame[:, ::-1]
    if orientation in (3, 4, 7, 8):
        frame = frame[::-1]
    return np.ascontiguousarray(frame)


def _in_8_bits(image: Image.Image) -> Frame:
    mode = image.mode
    if mode.startswith("I"):
        values = np.asarray(image).astype(np.int64)
        if values.min(initial=0) < 0 or values.max(initial=0) > 0xFFFF:
            raise NotShown("has pixels of 32 bits, whose brightness nothing tells: save it with 8 or 16")
        return (values >> 8).astype(np.uint8)[..., None]  # (H, W, 1)
    if mode == "F":
        raise NotShown("has pixels of floating point, whose brightness nothing tells: save it with 8 or 16 bits")
    if mode == "1":
        image = image.convert("L")
    elif mode in WITH_OPACITY or (mode == "P" and "transparency" in image.info):
        image = image.convert("RGBA")
    elif mode not in KEPT:
        image = image.convert("RGB")
    frame = np.asarray(image)
    return frame.reshape(*frame.shape[:2], -1)  # (H, W, C)


def _orientation(image: Image.Image) -> int:
    """After loading, for Pillow itself turns a TIFF while it loads, and takes the tag away."""
    try:
        return image.getexif().get(ORIENTATION, 1)
    except UNDECODABLE:
        return 1  # no viewer turns a picture whose EXIF is damaged


def _orientation_shown(frame: av.VideoFrame) -> int:
    """The orientation of EXIF by which players show a frame: a phone writes how it was held beside the pictures of its sensor."""
    given = frame.side_data.get(SideData.DISPLAYMATRIX.name)
    if given is None:
        return 1
    matrix = np.frombuffer(bytes(given), np.int32)[:6].reshape(2, 3)[:, :2] / 65536  # 16.16 fixed point; the third column is 0
    (a, b), (c, d) = matrix.round().astype(int).tolist()
    orientation = ORIENTATION_OF_MATRIX.get(((a, b), (c, d)))
    if orientation is None or np.abs(matrix - matrix.round()).max() > ALMOST_UPRIGHT:
        raise NotShown("is to be shown turned by other than a quarter turn: save it as it is to be looked at")
    return orientation


def _cause(content: bytes | Path | None) -> str:
    if isinstance(content, Path):
        with content.open("rb") as file:
            content = file.read(len(POINTER))
    if is_pointer(content or b""):
        return "is a Git LFS pointer, not the picture itself (`git lfs pull` fetches it)"
    return f"cannot be decoded as {NAMED}"


def video_frames(path: Path, *, rate_hz: float, from_s: float = 0.0, to_s: float = math.inf, remedy: str = AGAIN) -> Iterator[Picture]:
    """The colour frames that a video shows from one time until before another; where it breaks off, a sentence says so.

    Args:
        rate_hz: frames a second; times are distinguished to half a frame.
        remedy: what would help where a part of it is damaged.
    """
    try:
        validate_file(path)
    except ValueError as error:
        yield str(error)
        return
    half_s = 0.5 / rate_hz
    try:
        with av.open(str(path.absolute())) as container:
            stream = container.streams.video[0]
            if stream.codec_context is None:
                yield f"{path} is in a coding that cannot be decoded: record it as H.264 or AV1"
                return
            if (pixels := stream.codec_context.width * stream.codec_context.height) > MOST_PIXELS:
                yield f"{path} has frames of {pixels / 1e6:.0f} million pixels, more than {MOST_PIXELS / 1e6:.0f}: record smaller ones"
                return
            stream.thread_type = "AUTO"
            if from_s > 0 and stream.time_base:
                container.seek(int(from_s / stream.time_base), stream=stream)
            for frame in container.decode(stream):
                if (frame.time or 0.0) >= to_s - half_s:
                    return
                if frame.is_corrupt:
                    yield f"{path} is damaged at {frame.time or 0.0:.2f} s: {remedy}"
                elif not from_s or (frame.time or 0.0) >= from_s - half_s:
                    yield upright(frame.to_ndarray(format="rgb24"), _orientation_shown(frame))
    except NotShown as error:
        yield f"{path} {error}"
    except (FFmpegError, IndexError, OverflowError, ValueError) as error:
        reason = getattr(error, "strerror", None) or ("it has no video stream" if isinstance(error, IndexError) else "it is damaged")
        yield f"{path} cannot be decoded as video ({reason}): the file is damaged or incomplete, {remedy}"
