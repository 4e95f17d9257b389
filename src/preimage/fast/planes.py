"""Convolutions of flat planes: the nine taps of a 3x3 kernel are nine constant distances, if lines end in a zero.

What takes long is here, and only that. Sums stay in the registers of the core: `correlate` sums a tile, twice the `fast.lanes` of four
planes, over all inputs and taps before it is written; `products` sums the 27 products that the weights of three planes learn from.

numba keeps compiled code by the age of the file that is compiled from, which is `fast.compiled`: touch that one after a change here.

>>> import numpy as np
>>> pixels, drawn, weights = np.ones(3 * TILE, np.float32), np.zeros(2 * TILE, np.float32), np.full(9, 0.5, np.float32)
>>> correlate(pixels, TILE, 1, drawn, 0, 1, TILE, 5, weights, 0, TILE)
>>> float(drawn[0])
4.5
"""

# pyright: reportCallIssue=false
# What an intrinsic is called with is not what it is written with.

from typing import Any

from numba import njit

from preimage.fast.lanes import LANES, all_lanes, load, plus_product, store, sum_of


def keeps_code() -> bool:
    """Whether there is a folder, beside this file or of the user's, where compiled code outlives the process."""
    try:
        njit(cache=True)(keeps_code)
    except RuntimeError:
        return False
    return True


HOW: dict[str, Any] = {"fastmath": True, "nogil": True, "cache": keeps_code(), "error_model": "numpy"}
"""numpy's errors: Python's would ask at every division whether it is by zero, one number at a time."""
TILE = 2 * LANES
"""Numbers of a plane that a convolution sums at once; planes are so long or several times."""


@njit(**HOW)
def correlate(x, source, inputs, y, target, outputs, size, row, weights, first, spare):
    """Add a 3x3 correlation to the planes of y, a tile at a time; of the last tile what is too much goes to the spare place."""
    step = 9 * inputs
    for p in range(0, size, TILE):
        for n in range(0, outputs, 4):
            at, w, left = target + n * size + p, first + n * step, outputs - 1 - n
            a, b, c = at + size if left > 0 else spare, at + 2 * size if left > 1 else spare, at + 3 * size if left > 2 else spare
            u, v, z = w + min(1, left) * step, w + min(2, left) * step, w + min(3, left) * step
            add_tile(x, source + p, inputs, size, row, y, at, a, b, c, weights, w, u, v, z)


@njit(**HOW)
def add_tile(x, source, inputs, size, row, y, a, b, c, d, weights, u, v, w, z):
    """Twice the lanes of four planes, that begin at a, b, c and d, by weights that begin at u, v, w and z: all sums stay in registers."""
    sums_a, sums_b, sums_c, sums_d = load_two(y, a), load_two(y, b), load_two(y, c), load_two(y, d)
    tap = 0
    for i in range(inputs):
        for line in range(-1, 2):
            for column in range(-1, 2):
                taps = load_two(x, source + i * size + line * row + column)
                sums_a, sums_b = plus_two(sums_a, weights[u + tap], taps), plus_two(sums_b, weights[v + tap], taps)
                sums_c, sums_d = plus_two(sums_c, weights[w + tap], taps), plus_two(sums_d, weights[z + tap], taps)
                tap += 1
    store_two(y, a, sums_a)
    store_two(y, b, sums_b)
    store_two(y, c, sums_c)
    store_two(y, d, sums_d)


@njit(**HOW)
def load_two(numbers, first):
    return load(numbers, first), load(numbers, first + LANES)


@njit(**HOW)
def store_two(numbers, first, two):
    store(numbers, first, two[0])
    store(numbers, first + LANES, two[1])


@njit(**HOW)
def plus_two(sums, weight, two):
    weight = all_lanes(weight)
    return plus_product(sums[0], weight, two[0]), plus_product(sums[1], weight, two[1])


@njit(**HOW)
def products(x, source, length, row, of_y, a, b, c):
    """Of the nine taps around places of x with what came back to three planes, that begin at a, b and c."""
    zero = all_lanes(x.dtype.type(0))
    u = v = w = (zero, zero, zero, zero, zero, zero, zero, zero, zero)
    for p in range(0, length, LANES):
        taps = nine_taps(x, source + p, row)
        u, v, w = plus_nine(u, load(of_y, a + p), taps), plus_nine(v, load(of_y, b + p), taps), plus_nine(w, load(of_y, c + p), taps)
    return u, v, w


@njit(**HOW)
def nine_taps(x, p, row):
    above, middle, below = p - row, p, p + row
    upper = load(x, above - 1), load(x, above), load(x, above + 1)
    return *upper, load(x, middle - 1), load(x, middle), load(x, middle + 1), load(x, below - 1), load(x, below), load(x, below + 1)


@njit(**HOW)
def plus_nine(sums, y, taps):
    s, x = sums, taps
    first = plus_product(s[0], y, x[0]), plus_product(s[1], y, x[1]), plus_product(s[2], y, x[2])
    second = plus_product(s[3], y, x[3]), plus_product(s[4], y, x[4]), plus_product(s[5], y, x[5])
    return *first, *second, plus_product(s[6], y, x[6]), plus_product(s[7], y, x[7]), plus_product(s[8], y, x[8])


@njit(**HOW)
def add_nine(numbers, first, nine):
    """The sums of nine lanes to numbers that lie behind each other."""
    for i in range(9):
        numbers[first + i] += sum_of(nine[i])
