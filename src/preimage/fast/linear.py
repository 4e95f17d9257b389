"""The linear lines of a `fast.program`, convolutions and matrices, forward and backward, by the kernels for them.

Which kernels a convolution takes, in its own precision or in bfloat16, is chosen when it is compiled, by the kind of the scratch that it
gets: pairs (uint32) ask for the latter.
"""

# pyright: reportGeneralTypeIssues=false, reportArgumentType=false
# What an intrinsic returns, and what options it takes, cannot be seen from its declaration.

import numpy as np
from numba import njit, types
from numba.extending import overload

from preimage.fast.bfloat16 import halve, margin_of, pair_channels, pair_weights
from preimage.fast.convolution import LINES, OPTIONS, correlate, products
from preimage.fast.matrix import multiply, multiply_transposed
from preimage.fast.operations import CONVOLUTION, clear_padding, sum_of
from preimage.fast.simd import VECTOR_SIZE, horizontal_sum

CHUNK = 2048
"""Numbers of a channel that a weight gradient goes through before the next channel: three such chunks and the taps fit the first cache."""

INLINED = {name: OPTIONS[name] for name in ("fastmath", "error_model")}
"""Options of what becomes part of the function that calls it."""


def add_correlation(x, source, inputs, y, target, outputs, op, kernels, scratch):
    """Add a 3x3 correlation of the inputs to the outputs, in bfloat16 where the scratch is for pairs of that."""
    raise NotImplementedError


@overload(add_correlation, jit_options=INLINED)
def add_correlation_at(x, source, inputs, y, target, outputs, op, kernels, scratch):
    def whole(x, source, inputs, y, target, outputs, op, kernels, scratch):
        correlate(x, source, inputs, y, target, outputs, op.size, op.row, kernels, op.weight, op.spare)

    def in_pairs(x, source, inputs, y, target, outputs, op, kernels, scratch):
        margin = margin_of(op.row)
        count = pair_channels(x, source, inputs, op.size, scratch[0], margin)
        correlate(scratch[0], margin, count, y, target, outputs, op.size, op.row, kernels, op.weight, op.spare)

    return in_pairs if scratch.dtype == types.uint32 else whole


@njit(**OPTIONS)
def convolution_forward(op, x, y, weights, kernels, scratch):
    """A 3x3 convolution that keeps the size of the feature maps."""
    for n in range(op.outputs):
        y[op.target + n * op.size : op.target + (n + 1) * op.size] = weights[op.bias + n]
    add_correlation(x, op.source, op.inputs, y, op.target, op.outputs, op, kernels, scratch)
    clear_padding(y, op.target, op.outputs, op)


@njit(**OPTIONS)
def flipped(operations, weights):
    """The weights of all convolutions as the backward pass needs them: inputs and outputs exchanged, kernels flipped."""
    result = np.empty_like(weights)
    for line in range(len(operations)):
        op = operations[line]
        if op.kind == CONVOLUTION:
            for n in range(op.outputs):
                for i in range(op.inputs):
                    for tap in range(9):
                        result[op.weight + 9 * (i * op.outputs + n) + 8 - tap] = weights[op.weight + 9 * (n * op.inputs + i) + tap]
    return result


@njit(**OPTIONS)
def paired(operations, weights, exchanged):
    """The weights of all convolutions in bfloat16, after or before inputs and outputs are exchanged."""
    result = np.empty(len(weights), np.uint32)
    for line in range(len(operations)):
        op = operations[line]
        if op.kind == CONVOLUTION:
            outputs, inputs = (op.inputs, op.outputs) if exchanged else (op.outputs, op.inputs)
            pair_weights(weights, op.weight, outputs, inputs, result)
    return result


@njit(**OPTIONS)
def convolution_backward(op, grad_x, grad_y, kernels, scratch):
    add_correlation(grad_y, op.target, op.outputs, grad_x, op.source, op.inputs, op, kernels, scratch)
    clear_padding(grad_x, op.source, op.inputs, op)


@njit(**OPTIONS)
def convolution_weight_gradient(op, x, grad_y, grad_weights, scratch):
    for n in range(op.outputs):
        grad_weights[op.bias + n] += sum_of(grad_y[op.target + n * op.size : op.target + (n + 1) * op.size])
    add_products(x, grad_y, op, grad_weights, scratch)


def add_products(x, grad_y, op, grad_weights, scratch):
    """Add the gradients of a convolution's kernels, in bfloat16 where the scratch is for pairs of that."""
    raise NotImplementedError


@overload(add_products, jit_options=INLINED)
def add_products_at(x, grad_y, op, grad_weights, scratch):
    def whole(x, grad_y, op, grad_weights, scratch):
        add_products_of(x, op.source, grad_y, op.target, op, grad_weights, VECTOR_SIZE)

    def in_pairs(x, grad_y, op, grad_weights, scratch):
        margin, halves, gradients = margin_of(op.row), scratch[0].view(np.uint16), scratch[1].view(np.uint16)
        halve(x, op.source, op.inputs * op.size, halves, margin)
        halve(grad_y, op.target, op.outputs * op.size, gradients, margin)
        add_products_of(halves, margin, gradients, margin, op, grad_weights, 2 * VECTOR_SIZE)

    return in_pairs if scratch.dtype == types.uint32 else whole


@njit(**OPTIONS)
def add_products_of(x, source, grad_y, target, op, grad_weights, in_vector):
    """Of three channels at a time, and of as many lines of the kernel as fit the registers."""
    size, step, zero = op.size, 9 * op.inputs, grad_weights.dtype.type(0)
    for begin in range(0, size, CHUNK):
        length = min(CHUNK, size - begin)
        for n in range(0, op.outputs, 3):
            a, left = target + n * size + begin, op.outputs - 1 - n
            b, c = a + min(1, left) * size, a + min(2, left) * size
            for i in range(op.inputs):
                for line in range(0, 3, LINES):
                    upper = source + i * size + begin + (line - 1) * op.row
                    sums = products(x, upper, length, op.row, grad_y, a, b, c, zero, in_vector)
                    first = op.weight + 9 * (n * op.inputs + i) + 3 * line
                    for k in range(min(3, left + 1)):
                        for tap in range(3 * LINES):
                            grad_weights[first + k * step + tap] += horizontal_sum(sums[tap][k])


@njit(**OPTIONS)
def matrix_forward(op, x, y, weights):
    batch = op.size
    for n in range(op.outputs):
        y[op.target + n * batch : op.target + (n + 1) * batch] = weights[op.bias + n]
    multiply(weights, op.weight, op.inputs, op.outputs, x, op.source, batch, y, op.target)


@njit(**OPTIONS)
def matrix_backward(op, grad_x, grad_y, weights):
    multiply_transposed(weights, op.weight, op.inputs, op.outputs, grad_y, op.target, op.size, grad_x, op.source)


@njit(**OPTIONS)
def record(op, grad_y, tape):
    """The weights of a matrix get their gradients from the outputs' of all steps, by one large product (`fast.loop`)."""
    count = op.outputs * op.size
    tape[op.tape : op.tape + count] = grad_y[op.target : op.target + count]
