"""Convolution kernels on flat channels: the nine taps of a 3x3 kernel are nine constant offsets, if every row ends in a zero.

Only what takes long is here. Sums stay in registers: `correlate` sums a tile, a few SIMD vectors (`fast.simd`) of four channels, over all
inputs and taps before writing it; `products` sums the products that the weight gradients of three channels need. AVX-512 has twice as many
registers as AVX2; what fits them is chosen here.

>>> import numpy as np
>>> pixels, result, weights = np.ones(3 * TILE, np.float32), np.zeros(2 * TILE, np.float32), np.full(9, 0.5, np.float32)
>>> correlate(pixels, TILE, 1, result, 0, 1, TILE, 5, weights, 0, TILE)
>>> float(result[0])
4.5
"""

# pyright: reportCallIssue=false
# An intrinsic is called with other arguments than it is declared with.

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from numba import njit

from preimage.fast.simd import VECTOR_SIZE, broadcast, broadcast_at, load, multiply_add, store


def forget_outdated(sources: Iterable[Path], compiled: Iterable[Path]) -> None:
    """Delete compiled code that is older than any of its sources: numba looks at one alone, but code holds what other files define."""
    newest = max(path.stat().st_mtime for path in sources)
    for path in compiled:
        with suppress(OSError):  # another process may be as quick, or the folder not ours to change
            if path.stat().st_mtime < newest:
                path.unlink()


def can_cache() -> bool:
    """Whether compiled code can be cached on disk, beside this file or in the user's cache folder."""
    try:
        njit(cache=True)(can_cache)
    except RuntimeError:
        return False
    return True


forget_outdated(Path(__file__).parent.glob("*.py"), (Path(__file__).parent / "__pycache__").glob("*.nb[ic]"))
OPTIONS: dict[str, Any] = {"fastmath": True, "nogil": True, "cache": can_cache(), "error_model": "numpy"}
"""numpy's error model: Python's would check every division for a zero, one number at a time."""
VECTORS = 2 if VECTOR_SIZE == 16 else 3
"""Vectors of a tile. With AVX2 twelve of them, three and a factor are all registers; with AVX-512 a pair in bfloat16 asks for two."""
LINES = 3 if VECTOR_SIZE == 16 else 1
"""Lines of a kernel whose products are summed at once: with three channels 27 sums, or 9."""
TILE = VECTORS * VECTOR_SIZE
"""Numbers of a channel that a convolution sums at once; the length of a channel is a multiple of it."""


@njit(**OPTIONS)
def correlate(x, source, inputs, y, target, outputs, size, row, weights, first, spare):
    """Add a 3x3 correlation to the channels of y, a tile of four at a time; sums beyond the last channel go to the spare tile."""
    step = 9 * inputs
    for p in range(0, size, TILE):
        for n in range(0, outputs, 4):
            at, w, left = target + n * size + p, first + n * step, outputs - 1 - n
            a, b, c = at + size if left > 0 else spare, at + 2 * size if left > 1 else spare, at + 3 * size if left > 2 else spare
            u, v, z = w + min(1, left) * step, w + min(2, left) * step, w + min(3, left) * step
            add_tile(x, source + p, inputs, size, row, y, at, a, b, c, weights, w, u, v, z)


@njit(**OPTIONS)
def add_tile(x, source, inputs, size, row, y, a, b, c, d, weights, u, v, w, z):
    """A tile of four channels, which begin at a, b, c and d, with weights that begin at u, v, w and z: all sums stay in registers."""
    sums_a, sums_b, sums_c, sums_d = load_tile(y, a), load_tile(y, b), load_tile(y, c), load_tile(y, d)
    tap = 0
    for i in range(inputs):
        for line in range(-1, 2):
            for column in range(-1, 2):
                taps = load_tile(x, source + i * size + line * row + column)
                sums_a = multiply_add_tile(sums_a, broadcast_at(weights, u + tap), taps)
                sums_b = multiply_add_tile(sums_b, broadcast_at(weights, v + tap), taps)
                sums_c = multiply_add_tile(sums_c, broadcast_at(weights, w + tap), taps)
                sums_d = multiply_add_tile(sums_d, broadcast_at(weights, z + tap), taps)
                tap += 1
    store_tile(y, a, sums_a)
    store_tile(y, b, sums_b)
    store_tile(y, c, sums_c)
    store_tile(y, d, sums_d)


@njit(**OPTIONS)
def load_tile(numbers, first):
    if VECTORS == 2:
        return load(numbers, first), load(numbers, first + VECTOR_SIZE)
    return load(numbers, first), load(numbers, first + VECTOR_SIZE), load(numbers, first + 2 * VECTOR_SIZE)


@njit(**OPTIONS)
def store_tile(numbers, first, vectors):
    for k in range(VECTORS):
        store(numbers, first + k * VECTOR_SIZE, vectors[k])


@njit(**OPTIONS)
def multiply_add_tile(sums, weight, vectors):
    if VECTORS == 2:
        return multiply_add(sums[0], weight, vectors[0]), multiply_add(sums[1], weight, vectors[1])
    first = multiply_add(sums[0], weight, vectors[0])
    return first, multiply_add(sums[1], weight, vectors[1]), multiply_add(sums[2], weight, vectors[2])


@njit(**OPTIONS)
def products(x, first, length, row, grad_y, a, b, c, zero, step):
    """Of the taps in the lines from `first` on with the gradients of three channels, which begin at a, b and c.

    Tap by tap, so that only one of them needs a register beside the sums. A vector holds so many numbers as step says.
    """
    zero = broadcast(zero)
    three = zero, zero, zero
    if LINES == 1:
        sums = three, three, three
        for p in range(0, length, step):
            y = load(grad_y, a + p), load(grad_y, b + p), load(grad_y, c + p)
            sums = multiply_add_line(sums, y, x, first + p)
        return sums
    s = three, three, three, three, three, three, three, three, three
    for p in range(0, length, step):
        y = load(grad_y, a + p), load(grad_y, b + p), load(grad_y, c + p)
        upper, lower = multiply_add_line(s[:3], y, x, first + p), multiply_add_line(s[6:], y, x, first + p + 2 * row)
        s = upper + multiply_add_line(s[3:6], y, x, first + p + row) + lower
    return s


@njit(**OPTIONS)
def multiply_add_line(sums, y, x, p):
    left, middle = multiply_add_three(sums[0], y, load(x, p - 1)), multiply_add_three(sums[1], y, load(x, p))
    return left, middle, multiply_add_three(sums[2], y, load(x, p + 1))


@njit(**OPTIONS)
def multiply_add_three(sums, y, tap):
    return multiply_add(sums[0], y[0], tap), multiply_add(sums[1], y[1], tap), multiply_add(sums[2], y[2], tap)
