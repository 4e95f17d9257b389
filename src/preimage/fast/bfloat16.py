"""Convolutions in bfloat16, by AVX-512's own instruction: each number of a vector becomes the sum of two products.

The kernels are those of `fast.convolution`; what they read is rounded first. Where they sum over channels, two channels lie beside each
other, place by place, as pairs (uint32); where they sum over places, two neighbours are the pair, so that a channel is simply stored in
half the room (uint16). Everything else, sums included, stays in single precision.

>>> import numpy as np
>>> bits = np.array([1.0, 1.00390625, -3.0], np.float32).view(np.uint32)  # the second lies between two numbers of bfloat16
>>> [f"{rounded(each):08x}"[:4] for each in bits]
['3f80', '3f80', 'c040']
"""

import numpy as np
from numba import njit

from preimage.fast.convolution import OPTIONS
from preimage.fast.simd import VECTOR_SIZE, has

UPPER = np.uint32(0xFFFF0000)
"""The bits of a number in single precision that are one in bfloat16."""


def is_compiled() -> bool:
    """Whether the processor that numba compiles for has the instruction."""
    return has("avx512bf16")


@njit(**OPTIONS)
def rounded(bits):
    """The bits of a number in single precision, of which the upper half is the nearest in bfloat16."""
    return np.uint32(bits + np.uint32(0x7FFF) + ((bits >> np.uint32(16)) & np.uint32(1)))


@njit(**OPTIONS)
def pair(low, high):
    return (rounded(low) >> np.uint32(16)) | (rounded(high) & UPPER)


@njit(**OPTIONS)
def margin_of(row):
    """Places before and behind all channels that kernels read: a line and one, in whole vectors."""
    return -(-(row + 1) // VECTOR_SIZE) * VECTOR_SIZE


@njit(**OPTIONS)
def pair_channels(x, source, channels, size, pairs, first):
    """Two channels beside each other, the last one beside zeros if it is odd, and zeros before them all; how many pairs."""
    pairs[:first] = 0
    for channel in range(0, channels, 2):
        begin = source + channel * size
        low, result = x[begin : begin + size].view(np.uint32), pairs[first : first + size]
        if channel + 1 < channels:
            high = x[begin + size : begin + 2 * size].view(np.uint32)
            for p in range(size):
                result[p] = pair(low[p], high[p])
        else:
            for p in range(size):
                result[p] = rounded(low[p]) >> np.uint32(16)
        first += size
    return (channels + 1) // 2


@njit(**OPTIONS)
def halve(x, source, count, halves, first):
    """Channels as they lie, in half the room, and zeros before them."""
    halves[:first] = 0
    numbers, result = x[source : source + count].view(np.uint32), halves[first : first + count]
    for p in range(count):
        result[p] = rounded(numbers[p]) >> np.uint32(16)


@njit(**OPTIONS)
def pair_weights(weights, first, outputs, inputs, pairs):
    """A convolution's kernels, those of two inputs beside each other."""
    bits, at = weights[first : first + 9 * outputs * inputs].view(np.uint32), first
    for n in range(outputs):
        for i in range(0, inputs, 2):
            for tap in range(9):
                p = 9 * (n * inputs + i) + tap
                pairs[at] = pair(bits[p], bits[p + 9] if i + 1 < inputs else np.uint32(0))
                at += 1
