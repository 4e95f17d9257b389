"""The compiled loops: they run a `fast.program` step by step, forward and backward.

A program is a list of operations on a buffer of numbers. Each kind of operation has a function for the forward and one for the backward
pass; `go_forward` and `go_backward` call them line by line, without Python in between. A channel holds the images of a batch one below
the other, with a row and a column of zeros between them. So the nine taps of a 3x3 convolution are nine constant offsets in a flat
channel, and the zero padding comes for free.

Loops other than those of the convolutions (`fast.convolution`) are vectorised by the compiler, where they count from 0, go through few
arrays (slices that begin at 0) and divide without a check.
"""

import numpy as np
from numba import njit

from preimage.fast.convolution import OPTIONS
from preimage.fast.linear import (
    convolution_backward,
    convolution_forward,
    convolution_weight_gradient,
    matrix_backward,
    matrix_forward,
    record,
)
from preimage.fast.operations import CONVOLUTION, GATES, MATRIX, PIXELS, POINTS, SCATTER, add_scaled, clear_padding
from preimage.fast.simd import tanh


@njit(**OPTIONS)
def read(indices, numbers, tensor):
    for row in range(len(indices)):
        for i in range(indices.shape[1]):
            tensor[row, i] = numbers[indices[row, i]]


@njit(**OPTIONS)
def add_to(indices, numbers, tensor):
    """The backward pass of `read`."""
    for row in range(len(indices)):
        for i in range(indices.shape[1]):
            numbers[indices[row, i]] += tensor[row, i]


@njit(**OPTIONS)
def scatter(sources, targets, x, y, factor):
    """Rearrange, or take means; the backward pass is the same with the indices exchanged."""
    factor = x.dtype.type(factor)
    for i in range(len(sources)):
        y[targets[i]] += factor * x[sources[i]]


@njit(**OPTIONS)
def points_forward(op, x, y):
    """The mean positions under the softmax of each map (`network.cells.expected_positions`), which takes the place of the map."""
    height, width, factor = op.image // op.row - 1, op.row - 1, x.dtype.type(op.factor)
    for n in range(op.inputs):
        for sequence in range(op.batch):
            first = op.source + n * op.size + sequence * op.image
            heat = x[first : first + op.image]
            largest = heat[0]
            for line in range(height):
                for p in range(line * op.row, line * op.row + width):
                    largest = max(largest, heat[p])
            total = of_columns = of_lines = x.dtype.type(0)
            for line in range(height):
                of_line = x.dtype.type(0)
                for column in range(width):
                    weight = np.exp(factor * (heat[line * op.row + column] - largest))
                    heat[line * op.row + column] = weight
                    of_line += weight
                    of_columns += weight * column
                total += of_line
                of_lines += of_line * line
            for p in range(op.image):
                heat[p] /= total
            y[op.target + n * op.batch + sequence] = 2 * of_columns / (total * max(width - 1, 1)) - 1
            y[op.target + (op.inputs + n) * op.batch + sequence] = 2 * of_lines / (total * max(height - 1, 1)) - 1


@njit(**OPTIONS)
def points_backward(op, x, y, grad_x, grad_y):
    height, width, factor = op.image // op.row - 1, op.row - 1, x.dtype.type(op.factor)
    to_column, to_line = x.dtype.type(2 / max(width - 1, 1)), x.dtype.type(2 / max(height - 1, 1))
    for n in range(op.inputs):
        for sequence in range(op.batch):
            first, one = op.source + n * op.size + sequence * op.image, op.target + n * op.batch + sequence
            other = one + op.inputs * op.batch
            weights, grad_heat = x[first : first + op.image], grad_x[first : first + op.image]
            for line in range(height):
                of_line = grad_y[other] * (to_line * line - 1 - y[other])
                for column in range(width):
                    p = line * op.row + column
                    grad_heat[p] = factor * weights[p] * (of_line + grad_y[one] * (to_column * column - 1 - y[one]))


@njit(**OPTIONS)
def split_gates(numbers, first, size):
    """Input, forget and output gate and candidate, in their order in memory."""
    b, c, d = first + size, first + 2 * size, first + 3 * size
    return numbers[first:b], numbers[b:c], numbers[c:d], numbers[d : d + size]


@njit(**OPTIONS)
def gates_forward(op, now, before):
    """The LSTM equations after the linear part (`network.cells.CellStep`); what the backward pass needs stays in the buffer."""
    size = op.outputs * op.size
    input_gate, forget_gate, output_gate, candidate = split_gates(now, op.source, size)
    sigmoids, half = now[op.source : op.source + 3 * size], now.dtype.type(0.5)
    for p in range(3 * size):
        sigmoids[p] = half * tanh(half * sigmoids[p]) + half
    for p in range(size):
        candidate[p] = tanh(candidate[p])
    old, new = before[op.cell : op.cell + size], now[op.cell : op.cell + size]
    for p in range(size):
        new[p] = forget_gate[p] * old[p] + input_gate[p] * candidate[p]
    tanh_cell, hidden = now[op.tanh_cell : op.tanh_cell + size], now[op.target : op.target + size]
    for p in range(size):
        tanh_cell[p] = tanh(new[p])
        hidden[p] = output_gate[p] * tanh_cell[p]
    if op.image > 1:
        clear_padding(now, op.target, op.outputs, op)


@njit(**OPTIONS)
def gates_backward(op, now, before, grad_now, grad_before):
    size = op.outputs * op.size
    input_gate, forget_gate, output_gate, candidate = split_gates(now, op.source, size)
    grad_input_gate, grad_forget_gate, grad_output_gate, grad_candidate = split_gates(grad_now, op.source, size)
    tanh_cell, grad_hidden = now[op.tanh_cell : op.tanh_cell + size], grad_now[op.target : op.target + size]
    old, grad_old, grad_cell = before[op.cell : op.cell + size], grad_before[op.cell : op.cell + size], grad_now[op.cell : op.cell + size]
    one = now.dtype.type(1)
    for p in range(size):  # three loops: with more arrays in one the compiler no longer checks that they do not overlap
        grad_cell[p] += grad_hidden[p] * output_gate[p] * (one - tanh_cell[p] * tanh_cell[p])
        grad_output_gate[p] = grad_hidden[p] * tanh_cell[p] * output_gate[p] * (one - output_gate[p])
    for p in range(size):
        grad_input_gate[p] = grad_cell[p] * candidate[p] * input_gate[p] * (one - input_gate[p])
        grad_candidate[p] = grad_cell[p] * input_gate[p] * (one - candidate[p] * candidate[p])
    for p in range(size):
        grad_forget_gate[p] = grad_cell[p] * old[p] * forget_gate[p] * (one - forget_gate[p])
        grad_old[p] = grad_cell[p] * forget_gate[p]


@njit(**OPTIONS)
def pixels_forward(op, now, weights):
    """Pixels: the tanh of the last layer's output plus a bias for every pixel."""
    for n in range(op.outputs):
        bias = weights[op.bias + n * op.image : op.bias + (n + 1) * op.image]
        for first in range(n * op.size, n * op.size + op.batch * op.image, op.image):
            x, y = now[op.source + first : op.source + first + op.image], now[op.target + first : op.target + first + op.image]
            for p in range(op.image):
                y[p] = tanh(x[p] + bias[p])


@njit(**OPTIONS)
def pixels_backward(op, now, grad_now, grad_weights):
    one = now.dtype.type(1)
    for n in range(op.outputs):
        grad_bias = grad_weights[op.bias + n * op.image : op.bias + (n + 1) * op.image]
        for first in range(n * op.size, n * op.size + op.batch * op.image, op.image):
            y, grad_y = now[op.target + first : op.target + first + op.image], grad_now[op.target + first : op.target + first + op.image]
            grad_x = grad_now[op.source + first : op.source + first + op.image]
            for p in range(op.image):
                grad_x[p] = grad_y[p] * (one - y[p] * y[p])
            add_scaled(grad_bias, grad_x, one)


@njit(**OPTIONS)
def codes_forward(op, now, weights):
    """Log codes: the log-softmax over the units of a joint; and the codes."""
    units, batch = op.count, op.size
    for joint in range(op.outputs // units):
        for row in range(batch):
            first, last = joint * units * batch + row, (joint + 1) * units * batch
            logits, codes = now[op.target + first : op.target + last : batch], now[op.cell + first : op.cell + last : batch]
            for unit in range(units):
                logits[unit] = now[op.source + first + unit * batch] + weights[op.bias + joint * units + unit]
            largest, total = logits[0], now.dtype.type(0)
            for unit in range(1, units):
                largest = max(largest, logits[unit])
            for unit in range(units):
                codes[unit] = np.exp(logits[unit] - largest)
            for unit in range(units):
                total += codes[unit]
            largest += np.log(total)
            for unit in range(units):
                logits[unit] -= largest
                codes[unit] = np.exp(logits[unit])


@njit(**OPTIONS)
def codes_backward(op, now, grad_now, grad_weights):
    units, batch = op.count, op.size
    for joint in range(op.outputs // units):
        for row in range(batch):
            first, total = joint * units * batch + row, now.dtype.type(0)
            for p in range(first, first + units * batch, batch):
                grad_now[op.source + p] = grad_now[op.target + p] + now[op.cell + p] * grad_now[op.cell + p]
                total += grad_now[op.source + p]
            for unit in range(units):
                p = first + unit * batch
                grad_now[op.source + p] -= now[op.cell + p] * total
                grad_weights[op.bias + joint * units + unit] += grad_now[op.source + p]


@njit(**OPTIONS)
def go_forward(operations, cleared, moves, initial_at, pixels_at, codes_at, weights, kernels, scratch, buffers, initial, pixels, log_codes):
    """All steps; the buffers are used in turn where there are fewer of them than steps."""
    buffers[0] = 0
    add_to(initial_at, buffers[0], initial)
    for step in range(pixels.shape[1]):
        before, now = buffers[step % len(buffers)], buffers[(step + 1) % len(buffers)]
        now[cleared:] = 0
        for line in range(len(operations)):
            op = operations[line]
            x, y = now if op.source_now else before, now if op.target_now else before
            if op.kind == CONVOLUTION:
                convolution_forward(op, x, y, weights, kernels, scratch)
            elif op.kind == MATRIX:
                matrix_forward(op, x, y, weights)
            elif op.kind == SCATTER:
                scatter(moves[0, op.first : op.first + op.count], moves[1, op.first : op.first + op.count], x, y, op.factor)
            elif op.kind == POINTS:
                points_forward(op, x, y)
            elif op.kind == GATES:
                gates_forward(op, now, before)
            elif op.kind == PIXELS:
                pixels_forward(op, now, weights)
            else:
                codes_forward(op, now, weights)
        read(pixels_at, now, pixels[:, step])
        read(codes_at, now, log_codes[:, step])


@njit(**OPTIONS)
def go_backward(
    operations,
    cleared,
    moves,
    initial_at,
    pixels_at,
    codes_at,
    weights,
    kernels,
    scratch,
    buffers,
    grad_pixels,
    grad_codes,
    grad_weights,
    grad_initial,
    tape,
    learned,
):
    """The gradients of all weights, where these are learned, and of the loop's initial values."""
    grad_now, grad_before = np.zeros_like(buffers[0]), np.zeros_like(buffers[0])
    for step in range(grad_pixels.shape[1] - 1, -1, -1):
        before, now = buffers[step], buffers[step + 1]
        grad_before[cleared:] = 0
        add_to(pixels_at, grad_now, grad_pixels[:, step])
        add_to(codes_at, grad_now, grad_codes[:, step])
        for line in range(len(operations) - 1, -1, -1):
            op = operations[line]
            x, grad_x = (now, grad_now) if op.source_now else (before, grad_before)
            y, grad_y = (now, grad_now) if op.target_now else (before, grad_before)
            if op.kind == CONVOLUTION:
                convolution_backward(op, grad_x, grad_y, kernels, scratch)
                if learned:
                    convolution_weight_gradient(op, x, grad_y, grad_weights, scratch)
            elif op.kind == MATRIX:
                matrix_backward(op, grad_x, grad_y, weights)
                if learned:
                    record(op, grad_y, tape[step])
            elif op.kind == SCATTER:
                scatter(moves[1, op.first : op.first + op.count], moves[0, op.first : op.first + op.count], grad_y, grad_x, op.factor)
            elif op.kind == POINTS:
                points_backward(op, x, y, grad_x, grad_y)
            elif op.kind == GATES:
                gates_backward(op, now, before, grad_now, grad_before)
            elif op.kind == PIXELS:
                pixels_backward(op, now, grad_now, grad_weights)
            else:
                codes_backward(op, now, grad_now, grad_weights)
        grad_now, grad_before = grad_before, grad_now
    read(initial_at, grad_now, grad_initial)
