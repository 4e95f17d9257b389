"""The lines of a `fast.program`: their kinds, their fields, and what several kinds do.

>>> OPERATION.names[0], CONVOLUTION
('kind', 0)
"""

import numpy as np
from numba import njit

from preimage.fast.convolution import OPTIONS

CONVOLUTION, MATRIX, SCATTER, POINTS, GATES, PIXELS, CODES = range(7)
"""Kinds of operations: a 3x3 convolution, a matrix, a rearrangement, the positions of keypoints, an LSTM's gates, and the outputs: pixels
and joint codes."""
FIELDS = (
    *("kind", "source", "source_now", "target", "target_now", "inputs", "outputs", "batch", "size", "row", "image"),
    *("weight", "bias", "cell", "tanh_cell", "spare", "first", "count", "tape"),
)
OPERATION = np.dtype([*((name, np.int64) for name in FIELDS), ("factor", np.float64)])
"""One line of a program; fields that a kind does not use are 0. Indices count from the start of a step's buffer."""


@njit(**OPTIONS)
def clear_padding(y, first, channels, op):
    """Zeros where there is no pixel: the last row and column of every image, and the rest of the last tile."""
    for channel in range(first, first + channels * op.size, op.size):
        for image in range(channel, channel + op.batch * op.image, op.image):
            for p in range(image + op.row - 1, image + op.image, op.row):
                y[p] = 0
            y[image + op.image - op.row : image + op.image] = 0
        y[channel + op.batch * op.image : channel + op.size] = 0


@njit(**OPTIONS)
def add_scaled(y, x, factor):
    for i in range(len(y)):
        y[i] += factor * x[i]


@njit(**OPTIONS)
def sum_of(x):
    total = x.dtype.type(0)
    for i in range(len(x)):
        total += x[i]
    return total
