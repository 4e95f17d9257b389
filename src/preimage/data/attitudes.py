"""Attitudes of a hand: neighbouring columns that are one, and leap between numbers that mean the same.

What an attitude is, and how it is followed, its own room knows (`data.quaternions`, `data.rotation_vectors`).
"""

from collections.abc import Sequence
from typing import ClassVar, Protocol

import numpy as np
from jaxtyping import Float

from preimage.records import listed, number_of


class Attitude(Protocol):
    """Columns that are one."""

    LEAPS: ClassVar[str]
    """What it is, and how it leaps, in words."""
    FOLLOWED: ClassVar[str]
    """What is made of it, in words."""

    @property
    def columns(self) -> tuple[str, ...]: ...

    @property
    def episodes(self) -> tuple[int, ...]:
        """Those in which a reading is changed by following it."""
        ...

    def follow(self, readings: Float[np.ndarray, "T K"]) -> Float[np.ndarray, "T K"]:
        """The readings of an episode's columns, or of one step, each as the equal one that goes on from the one before."""
        ...


def followed(joints: Float[np.ndarray, "T J"], names: Sequence[str], attitudes: Sequence[Attitude]) -> Float[np.ndarray, "T J"]:
    """The joints of an episode, or of one step, with those attitudes followed that are whole among them."""
    joints = joints.copy() if attitudes else joints
    for each in attitudes:
        if len(joints) and set(each.columns) <= set(names):
            columns = [list(names).index(name) for name in each.columns]
            joints[:, columns] = each.follow(joints[:, columns])
    return joints


def is_followed(attitude: Attitude, num_episodes: int) -> str:
    """A sentence on an attitude of which readings were changed."""
    count = f"{len(attitude.episodes)} of {number_of(num_episodes, 'episode')} ({listed(attitude.episodes)})"
    return f"{', '.join(attitude.columns)} are {attitude.LEAPS}, in {count}: {attitude.FOLLOWED}"
