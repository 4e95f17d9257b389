"""Matrix kernels for batches of a few sequences: every weight is read from memory once, for five sequences at a time.

A vector's numbers lie sequence beside sequence; here they are brought into rows, one a sequence, so that the rows of a matrix and those of
the batch are multiplied as they lie. Rows are as long as whole SIMD vectors (`fast.simd`): what a kernel reads of a matrix beyond the end
of a row meets zeros, or is written where nobody looks.

>>> import numpy as np
>>> weights, x, y = np.zeros(4 + VECTOR_SIZE, np.float32), np.array([5, 6], np.float32), np.zeros(2, np.float32)
>>> weights[:4] = 1, 2, 3, 4
>>> multiply(weights, 0, 2, 2, x, 0, 1, y, 0)
>>> y.tolist()
[17.0, 39.0]
"""

# pyright: reportCallIssue=false
# An intrinsic is called with other arguments than it is declared with.

import numpy as np
from numba import njit

from preimage.fast.convolution import OPTIONS
from preimage.fast.simd import VECTOR_SIZE, broadcast, broadcast_at, horizontal_sum, load, multiply_add, store

ROWS = 4
"""Rows of a matrix that are read side by side."""
SEQUENCES = 5
"""Sequences for which they are read: so many sums of each row fit the registers."""


@njit(**OPTIONS)
def in_rows(numbers, first, count, batch):
    """Each sequence's numbers in a row of whole vectors, zeros behind them and below."""
    rows = np.zeros((-(-batch // SEQUENCES) * SEQUENCES, -(-count // VECTOR_SIZE) * VECTOR_SIZE), numbers.dtype)
    for i in range(count):
        for row in range(batch):
            rows[row, i] = numbers[first + i * batch + row]
    return rows


@njit(**OPTIONS)
def multiply(weights, first, inputs, outputs, x, source, batch, y, target):
    """Add to y the products of a matrix's rows with each sequence's numbers."""
    rows = in_rows(x, source, inputs, batch)
    length, numbers = rows.shape[1], rows.ravel()
    for n in range(0, outputs, ROWS):
        at, left = first + n * inputs, outputs - 1 - n
        b, c, d = at + min(1, left) * inputs, at + min(2, left) * inputs, at + min(3, left) * inputs
        for row in range(0, batch, SEQUENCES):
            sums = products_of_rows(weights, at, b, c, d, numbers, row * length, length)
            for k in range(min(ROWS, outputs - n)):
                for r in range(min(SEQUENCES, batch - row)):
                    y[target + (n + k) * batch + row + r] += horizontal_sum(sums[k][r])


@njit(**OPTIONS)
def products_of_rows(weights, a, b, c, d, numbers, first, length):
    """Of four rows of a matrix, which begin at a, b, c and d, with those of five sequences."""
    zero = broadcast(numbers.dtype.type(0))
    s = t = u = v = (zero, zero, zero, zero, zero)
    for i in range(0, length, VECTOR_SIZE):
        p = first + i
        x = (
            load(numbers, p),
            load(numbers, p + length),
            load(numbers, p + 2 * length),
            load(numbers, p + 3 * length),
            load(numbers, p + 4 * length),
        )
        s, t = multiply_add_five(s, load(weights, a + i), x), multiply_add_five(t, load(weights, b + i), x)
        u, v = multiply_add_five(u, load(weights, c + i), x), multiply_add_five(v, load(weights, d + i), x)
    return s, t, u, v


@njit(**OPTIONS)
def multiply_add_five(sums, w, x):
    first = multiply_add(sums[0], w, x[0]), multiply_add(sums[1], w, x[1]), multiply_add(sums[2], w, x[2])
    return *first, multiply_add(sums[3], w, x[3]), multiply_add(sums[4], w, x[4])


@njit(**OPTIONS)
def multiply_transposed(weights, first, inputs, outputs, grad_y, target, batch, grad_x, source):
    """Add to grad_x the products of a matrix's columns with each sequence's gradients."""
    gradients = np.zeros((-(-outputs // ROWS) * ROWS, -(-batch // SEQUENCES) * SEQUENCES), grad_y.dtype)
    for n in range(outputs):
        for row in range(batch):
            gradients[n, row] = grad_y[target + n * batch + row]
    length, width = -(-inputs // VECTOR_SIZE) * VECTOR_SIZE, gradients.shape[1]
    sums, gradients = np.zeros(width * length, grad_y.dtype), gradients.ravel()
    for n in range(0, outputs, ROWS):
        at, left = first + n * inputs, outputs - 1 - n
        b, c, d = at + min(1, left) * inputs, at + min(2, left) * inputs, at + min(3, left) * inputs
        for row in range(0, batch, SEQUENCES):
            add_rows(weights, at, b, c, d, gradients, n * width + row, width, sums, row * length, length)
    for i in range(inputs):
        for row in range(batch):
            grad_x[source + i * batch + row] += sums[row * length + i]


@njit(**OPTIONS)
def add_rows(weights, a, b, c, d, gradients, first, width, sums, row, length):
    """Add four rows of a matrix, times the gradients of five sequences, to the sums of these."""
    s, t = five_of(gradients, first), five_of(gradients, first + width)
    u, v = five_of(gradients, first + 2 * width), five_of(gradients, first + 3 * width)
    for i in range(0, length, VECTOR_SIZE):
        w = load(weights, a + i), load(weights, b + i), load(weights, c + i), load(weights, d + i)
        p = row + i
        add_four(sums, p, w, (s[0], t[0], u[0], v[0]))
        add_four(sums, p + length, w, (s[1], t[1], u[1], v[1]))
        add_four(sums, p + 2 * length, w, (s[2], t[2], u[2], v[2]))
        add_four(sums, p + 3 * length, w, (s[3], t[3], u[3], v[3]))
        add_four(sums, p + 4 * length, w, (s[4], t[4], u[4], v[4]))


@njit(**OPTIONS)
def five_of(numbers, p):
    first = broadcast_at(numbers, p), broadcast_at(numbers, p + 1), broadcast_at(numbers, p + 2)
    return *first, broadcast_at(numbers, p + 3), broadcast_at(numbers, p + 4)


@njit(**OPTIONS)
def add_four(sums, p, w, factors):
    total = multiply_add(multiply_add(load(sums, p), w[0], factors[0]), w[1], factors[1])
    store(sums, p, multiply_add(multiply_add(total, w[2], factors[2]), w[3], factors[3]))
