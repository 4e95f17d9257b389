"""Loops that are compiled: what goes through a `fast.program` step by step, forward and back.

A program is a list of operations on a stretch of numbers. Each kind of operation has a function that does it and one that brings its
gradient back; `go_forward` and `go_backward` call them line by line, without Python between them. Maps lie as planes, the sequences of
a batch one under the other, with one row and one column of zeros between them. So the nine taps of a 3x3 convolution are nine constant
distances in a flat plane, and the margins come out right by themselves.

Other loops than those of the convolutions (`fast.planes`) become vector instructions by themselves, where they count from 0, go through few
arrays (slices that begin at 0) and divide without asking.

numba keeps compiled code by the age of the file of the outermost function, which is this one.
"""

# pyright: reportGeneralTypeIssues=false
# What an intrinsic returns its text does not tell.

import numpy as np
from numba import njit

from preimage.fast.lanes import tanh
from preimage.fast.planes import HOW, add_nine, correlate, products

CHUNK = 2048
"""Numbers of a plane that a weight's gradient goes through before it turns to the next plane: four of them stay near the core."""

CONVOLVE, APPLY, SPREAD, GATE, SQUASH, ENCODE = range(6)
"""Kinds of operations: a 3x3 convolution, a matrix, a rearrangement, an LSTM's gates, the pixels' and the joint codes' read-out."""
FIELDS = (
    *("kind", "source", "source_now", "target", "target_now", "inputs", "outputs", "batch", "size", "row", "image"),
    *("weight", "bias", "cell", "squashed", "spare", "first", "count"),
)
OPERATION = np.dtype([*((name, np.int64) for name in FIELDS), ("factor", np.float64)])
"""One line of a program; what a kind does not use is 0. Places count from the start of a step's stretch."""


@njit(**HOW)
def read(places, numbers, tensor):
    for row in range(len(places)):
        for i in range(places.shape[1]):
            tensor[row, i] = numbers[places[row, i]]


@njit(**HOW)
def add_to(places, numbers, tensor):
    """The way back of `read`."""
    for row in range(len(places)):
        for i in range(places.shape[1]):
            numbers[places[row, i]] += tensor[row, i]


@njit(**HOW)
def spread(from_where, to_where, x, y, factor):
    """Rearrange, or take means; the way back is the same with the places exchanged."""
    factor = x.dtype.type(factor)
    for i in range(len(from_where)):
        y[to_where[i]] += factor * x[from_where[i]]


@njit(**HOW)
def clear_margins(y, first, planes, op):
    """Zeros where no pixel is: the last row and column of every image, and what fills a plane up to whole tiles."""
    for plane in range(first, first + planes * op.size, op.size):
        for image in range(plane, plane + op.batch * op.image, op.image):
            for p in range(image + op.row - 1, image + op.image, op.row):
                y[p] = 0
            y[image + op.image - op.row : image + op.image] = 0
        y[plane + op.batch * op.image : plane + op.size] = 0


@njit(**HOW)
def convolve(op, x, y, weights):
    """A 3x3 convolution that keeps the size of the maps."""
    for n in range(op.outputs):
        y[op.target + n * op.size : op.target + (n + 1) * op.size] = weights[op.bias + n]
    correlate(x, op.source, op.inputs, y, op.target, op.outputs, op.size, op.row, weights, op.weight, op.spare)
    clear_margins(y, op.target, op.outputs, op)


@njit(**HOW)
def turned(operations, weights):
    """The weights of all convolutions as the way back needs them: inputs and outputs exchanged, taps from the last to the first."""
    result = np.empty_like(weights)
    for line in range(len(operations)):
        op = operations[line]
        if op.kind == CONVOLVE:
            for n in range(op.outputs):
                for i in range(op.inputs):
                    for tap in range(9):
                        result[op.weight + 9 * (i * op.outputs + n) + 8 - tap] = weights[op.weight + 9 * (n * op.inputs + i) + tap]
    return result


@njit(**HOW)
def convolve_back(op, of_x, of_y, mirrored):
    correlate(of_y, op.target, op.outputs, of_x, op.source, op.inputs, op.size, op.row, mirrored, op.weight, op.spare)
    clear_margins(of_x, op.source, op.inputs, op)


@njit(**HOW)
def learn_convolution(op, x, of_y, of_weights):
    """Add the gradients of the weights: of three planes at a time, 27 sums in the registers."""
    size, step = op.size, 9 * op.inputs
    for n in range(op.outputs):
        of_weights[op.bias + n] += total_of(of_y[op.target + n * size : op.target + (n + 1) * size])
    for begin in range(0, size, CHUNK):
        length = min(CHUNK, size - begin)
        for n in range(0, op.outputs, 3):
            a, left = op.target + n * size + begin, op.outputs - 1 - n
            b, c = a + min(1, left) * size, a + min(2, left) * size
            for i in range(op.inputs):
                u, v, w = products(x, op.source + i * size + begin, length, op.row, of_y, a, b, c)
                first = op.weight + 9 * (n * op.inputs + i)
                add_nine(of_weights, first, u)
                if left > 0:
                    add_nine(of_weights, first + step, v)
                if left > 1:
                    add_nine(of_weights, first + 2 * step, w)


@njit(**HOW)
def add_times(y, x, factor):
    for i in range(len(y)):
        y[i] += factor * x[i]


@njit(**HOW)
def product(x, y):
    total = x.dtype.type(0)
    for i in range(len(x)):
        total += x[i] * y[i]
    return total


@njit(**HOW)
def total_of(x):
    total = x.dtype.type(0)
    for i in range(len(x)):
        total += x[i]
    return total


@njit(**HOW)
def apply(op, x, y, weights):
    """A matrix: for every input, its weights to all outputs."""
    outputs, batch = op.outputs, op.size
    for row in range(batch):
        result = weights[op.bias : op.bias + outputs].copy()
        for i in range(op.inputs):
            first = op.weight + i * outputs
            add_times(result, weights[first : first + outputs], x[op.source + i * batch + row])
        y[op.target + row : op.target + outputs * batch : batch] = result


@njit(**HOW)
def apply_back(op, x, of_x, of_y, weights, of_weights, learned):
    outputs, batch = op.outputs, op.size
    for row in range(batch):
        gradient = of_y[op.target + row : op.target + outputs * batch : batch].copy()
        for i in range(op.inputs):
            first, place = op.weight + i * outputs, op.source + i * batch + row
            of_x[place] += product(weights[first : first + outputs], gradient)
            if learned:
                add_times(of_weights[first : first + outputs], gradient, x[place])
        if learned:
            add_times(of_weights[op.bias : op.bias + outputs], gradient, gradient.dtype.type(1))


@njit(**HOW)
def four(numbers, first, size):
    """Input, forget and output gate and candidate, as they lie."""
    keep, show, candidate = first + size, first + 2 * size, first + 3 * size
    return numbers[first:keep], numbers[keep:show], numbers[show:candidate], numbers[candidate : candidate + size]


@njit(**HOW)
def open_gates(op, now, before):
    """The LSTM equations after the linear part (`network.cells.CellStep`); what the way back needs stays where it is."""
    size = op.outputs * op.size
    admit, keep, show, candidate = four(now, op.source, size)
    sigmoids, half = now[op.source : op.source + 3 * size], now.dtype.type(0.5)
    for p in range(3 * size):
        sigmoids[p] = half * tanh(half * sigmoids[p]) + half
    for p in range(size):
        candidate[p] = tanh(candidate[p])
    old, new = before[op.cell : op.cell + size], now[op.cell : op.cell + size]
    for p in range(size):
        new[p] = keep[p] * old[p] + admit[p] * candidate[p]
    squashed, hidden = now[op.squashed : op.squashed + size], now[op.target : op.target + size]
    for p in range(size):
        squashed[p] = tanh(new[p])
        hidden[p] = show[p] * squashed[p]
    if op.image > 1:
        clear_margins(now, op.target, op.outputs, op)


@njit(**HOW)
def open_gates_back(op, now, before, of_now, of_before):
    size = op.outputs * op.size
    admit, keep, show, candidate = four(now, op.source, size)
    of_admit, of_keep, of_show, of_candidate = four(of_now, op.source, size)
    squashed, of_hidden = now[op.squashed : op.squashed + size], of_now[op.target : op.target + size]
    old, of_old, of_cell = before[op.cell : op.cell + size], of_before[op.cell : op.cell + size], of_now[op.cell : op.cell + size]
    one = now.dtype.type(1)
    for p in range(size):  # three loops, as with more arrays in one the compiler no longer asks whether they are apart
        of_cell[p] += of_hidden[p] * show[p] * (one - squashed[p] * squashed[p])
        of_show[p] = of_hidden[p] * squashed[p] * show[p] * (one - show[p])
    for p in range(size):
        of_admit[p] = of_cell[p] * candidate[p] * admit[p] * (one - admit[p])
        of_candidate[p] = of_cell[p] * admit[p] * (one - candidate[p] * candidate[p])
    for p in range(size):
        of_keep[p] = of_cell[p] * old[p] * keep[p] * (one - keep[p])
        of_old[p] = of_cell[p] * keep[p]


@njit(**HOW)
def squash(op, now, weights):
    """Pixels: the tanh of what is drawn and a bias of every place."""
    size = op.outputs * op.size
    x, y, bias = now[op.source : op.source + size], now[op.target : op.target + size], weights[op.bias : op.bias + size]
    for p in range(size):
        y[p] = tanh(x[p] + bias[p])


@njit(**HOW)
def squash_back(op, now, of_now, of_weights):
    size = op.outputs * op.size
    y, of_y, of_x = now[op.target : op.target + size], of_now[op.target : op.target + size], of_now[op.source : op.source + size]
    of_bias, one = of_weights[op.bias : op.bias + size], now.dtype.type(1)
    for p in range(size):
        of_x[p] = of_y[p] * (one - y[p] * y[p])
    add_times(of_bias, of_x, one)


@njit(**HOW)
def encode(op, now, weights):
    """Log codes: the log-softmax over the units of a joint; and the codes."""
    units, batch = op.count, op.size
    for joint in range(op.outputs // units):
        for row in range(batch):
            first, last = joint * units * batch + row, (joint + 1) * units * batch
            bias = weights[op.bias + joint * units : op.bias + (joint + 1) * units]
            logits = now[op.source + first : op.source + last : batch] + bias
            most = logits.max()
            log_codes = logits - (most + np.log(np.exp(logits - most).sum()))
            now[op.target + first : op.target + last : batch] = log_codes
            now[op.cell + first : op.cell + last : batch] = np.exp(log_codes)


@njit(**HOW)
def encode_back(op, now, of_now, of_weights):
    units, batch = op.count, op.size
    for joint in range(op.outputs // units):
        for row in range(batch):
            first, last = joint * units * batch + row, (joint + 1) * units * batch
            codes = now[op.cell + first : op.cell + last : batch]
            gradient = of_now[op.target + first : op.target + last : batch] + codes * of_now[op.cell + first : op.cell + last : batch]
            gradient = gradient - codes * gradient.sum()
            of_now[op.source + first : op.source + last : batch] = gradient
            of_weights[op.bias + joint * units : op.bias + (joint + 1) * units] += gradient


@njit(**HOW)
def go_forward(operations, cleared, moves, begun_at, pixels_at, codes_at, weights, stretches, begun, pixels, log_codes):
    """All steps; the stretches are used in turn where there are fewer than steps."""
    stretches[0] = 0
    add_to(begun_at, stretches[0], begun)
    for step in range(pixels.shape[1]):
        before, now = stretches[step % len(stretches)], stretches[(step + 1) % len(stretches)]
        now[cleared:] = 0
        for line in range(len(operations)):
            op = operations[line]
            x, y = now if op.source_now else before, now if op.target_now else before
            if op.kind == CONVOLVE:
                convolve(op, x, y, weights)
            elif op.kind == APPLY:
                apply(op, x, y, weights)
            elif op.kind == SPREAD:
                spread(moves[0, op.first : op.first + op.count], moves[1, op.first : op.first + op.count], x, y, op.factor)
            elif op.kind == GATE:
                open_gates(op, now, before)
            elif op.kind == SQUASH:
                squash(op, now, weights)
            else:
                encode(op, now, weights)
        read(pixels_at, now, pixels[:, step])
        read(codes_at, now, log_codes[:, step])


@njit(**HOW)
def go_backward(
    operations, cleared, moves, begun_at, pixels_at, codes_at, weights, stretches, of_pixels, of_codes, of_weights, of_begun, learned
):
    """The gradients of all weights, where they are learned, and of what the loop started from."""
    mirrored = turned(operations, weights)
    of_now, of_before = np.zeros_like(stretches[0]), np.zeros_like(stretches[0])
    for step in range(of_pixels.shape[1] - 1, -1, -1):
        before, now = stretches[step], stretches[step + 1]
        of_before[cleared:] = 0
        add_to(pixels_at, of_now, of_pixels[:, step])
        add_to(codes_at, of_now, of_codes[:, step])
        for line in range(len(operations) - 1, -1, -1):
            op = operations[line]
            x, of_x = (now, of_now) if op.source_now else (before, of_before)
            of_y = of_now if op.target_now else of_before
            if op.kind == CONVOLVE:
                convolve_back(op, of_x, of_y, mirrored)
                if learned:
                    learn_convolution(op, x, of_y, of_weights)
            elif op.kind == APPLY:
                apply_back(op, x, of_x, of_y, weights, of_weights, learned)
            elif op.kind == SPREAD:
                spread(moves[1, op.first : op.first + op.count], moves[0, op.first : op.first + op.count], of_y, of_x, op.factor)
            elif op.kind == GATE:
                open_gates_back(op, now, before, of_now, of_before)
            elif op.kind == SQUASH:
                squash_back(op, now, of_now, of_weights)
            else:
                encode_back(op, now, of_now, of_weights)
        of_now, of_before = of_before, of_now
    read(begun_at, of_now, of_begun)
