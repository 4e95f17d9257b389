"""An episode as somebody recorded it, before anything is known about whether it can be learned from."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8


@dataclass(frozen=True, eq=False)
class Episode:
    """One recording of F frames and T rows of joints; F, T and `declared_length` need not agree."""

    index: int
    frames: UInt8[np.ndarray, "F H W C"]
    joints: Float[np.ndarray, "T J"]
    joint_names: tuple[str, ...]
    timestamps_s: Float[np.ndarray, " T"] | None
    declared_length: int
    rate_hz: float
    task: str | None = None
