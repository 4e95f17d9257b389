"""Frames as PNG, as the page gets them: one picture in an event, or a film as one strip of all its frames, one below the other."""

import base64
import io

import numpy as np
from jaxtyping import UInt8
from PIL import Image


def png(frame: UInt8[np.ndarray, "H W C"]) -> bytes:
    """A frame in grey or colour; depth, which a picture has no channel for, is left out."""
    shown = frame[..., 0] if frame.shape[-1] == 1 else frame[..., :3]
    file = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(shown)).save(file, "PNG")
    return file.getvalue()


def strip(frames: UInt8[np.ndarray, "T H W C"]) -> bytes:
    """A film as one picture: step 0 on top."""
    return png(frames.reshape(-1, *frames.shape[2:]))  # (T*H, W, C)


def inline(frame: UInt8[np.ndarray, "H W C"]) -> str:
    """A frame as text, for an event."""
    return text_of(png(frame))


def text_of(content: bytes) -> str:
    """Bytes as text, for JSON."""
    return base64.b64encode(content).decode()
