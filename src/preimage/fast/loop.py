"""The closed loop of a network run by its `fast.program`, with gradients, a part of the sequences on each thread.

Sequences know nothing of each other, so the threads meet twice an update: before the loop and after it. Each adds up the gradients of the
small weights for itself, and these are summed in the order of the parts; a matrix gets its gradient from all steps of all sequences at
once, by one product that torch makes. So the same sequences on as many threads give the same numbers, bit for bit.
"""

# pyright: reportIncompatibleMethodOverride=false
# torch declares forward and backward of a Function with any arguments.

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional

from preimage.fast.compiled import go_backward, go_forward
from preimage.fast.linear import flipped, paired
from preimage.fast.operations import MATRIX
from preimage.fast.program import Program
from preimage.fast.simd import VECTOR_SIZE
from preimage.network.cells import State, space_to_depth
from preimage.network.linear import Conv

MOST_AT_ONCE = 16
"""Sequences of a part: with more of them what a step computes leaves the caches."""

PROGRAMS: WeakKeyDictionary[nn.Module, dict[int, Program]] = WeakKeyDictionary()
"""Programs already written, by network and number of sequences."""
LAYOUTS: WeakKeyDictionary[nn.Module, tuple[tuple[Any, ...], "Layout"]] = WeakKeyDictionary()
"""Of frozen networks, with what tells whether their weights are still the same."""


@dataclass(frozen=True, eq=False)
class Layout:
    """All weights of a network as its programs need them."""

    operations: Any
    weights: Tensor
    """In the order of a program: convolutions, the outputs' biases, matrices."""
    narrow: bool
    """Whether convolutions are in bfloat16."""

    @cached_property
    def forward(self) -> Any:
        """The convolutions' weights for the forward pass."""
        return paired(self.operations, self.weights.numpy(), False) if self.narrow else self.weights.numpy()

    @cached_property
    def backward(self) -> Any:
        """The convolutions' weights for the backward pass."""
        kernels = flipped(self.operations, self.weights.numpy())
        return paired(self.operations, kernels, True) if self.narrow else kernels

    @cached_property
    def total(self) -> Tensor:
        """Their sum, which is finite only if all are."""
        return self.weights.sum()


def closed_loop(
    model: Any, states: Mapping[str, State], start: tuple[Tensor, Tensor], *, num_steps: int, narrow: bool = False
) -> tuple[Tensor, Tensor]:
    """The predicted pixels (B, T, C, H, W) and log codes (B, T, J, K).

    Args:
        model: a `PDVMRNN` on the CPU, in single or double precision.
        states: hidden and cell state of every layer before the first step.
        start: pixels (B, C, H, W) and codes (B, J, K) of the first input.
        narrow: convolve in bfloat16, which `fast.bfloat16` has to be compiled for; the weights are in single precision.
    """
    pixels, codes = start
    programs = [program_of(model, count) for count in parts_of(len(pixels), torch.get_num_threads())]
    initial = torch.cat(
        [part.flatten(1) for part in (*(part for name in programs[0].hidden for part in states[name]), pixels, codes)], dim=1
    )
    weights, layout = layout_of(model, programs[0], narrow)
    keep_steps = torch.is_grad_enabled() and (initial.requires_grad or weights.requires_grad)
    predicted, log_codes = ClosedLoop.apply(weights, initial, programs, layout, num_steps, keep_steps)  # pyright: ignore[reportGeneralTypeIssues]
    return predicted.unflatten(2, pixels.shape[1:]), log_codes.unflatten(2, codes.shape[1:])


def parts_of(count: int, threads: int) -> list[int]:
    """How many sequences each part has, as equal as can be: a part for every thread, or several.

    >>> parts_of(10, 2), parts_of(2, 4), parts_of(40, 2)
    ([5, 5], [1, 1], [14, 13, 13])
    """
    parts = max(min(count, threads), -(-count // MOST_AT_ONCE))
    return [count // parts + (part < count % parts) for part in range(parts)]


def program_of(model: nn.Module, count: int) -> Program:
    programs = PROGRAMS.setdefault(model, {})
    return programs.get(count) or programs.setdefault(count, Program(model, count))


def layout_of(model: nn.Module, program: Program, narrow: bool) -> tuple[Tensor, Layout]:
    """The weights of a network in the order of a program, through which gradients go back, and their layout, which frozen ones keep."""
    parameters = list(model.parameters())
    if any(each.requires_grad or each.is_inference() for each in parameters):
        weights = weights_of(model, program)
        return weights, Layout(program.operations, weights.detach(), narrow)
    state = narrow, *((each.data_ptr(), each._version) for each in parameters)
    known, layout = LAYOUTS.get(model, (None, None))
    if layout is None or known != state:
        layout = Layout(program.operations, weights_of(model, program), narrow)
        LAYOUTS[model] = state, layout
    return layout.weights, layout


def weights_of(model: Any, program: Program) -> Tensor:
    """All weights in the order of the program, concatenated: convolutions, the outputs' biases, matrices."""
    small, large = [], []
    for name, kind in program.maps:
        layer = model.get_submodule(name)
        if kind == MATRIX:
            large += [layer.weight, layer.bias]
        else:
            small += [layer.weight if isinstance(layer, Conv) else functional.pad(layer.weight[..., None, None], (1, 1, 1, 1)), layer.bias]
    channels = functional.pad(space_to_depth(model.pixel_bias[None]), (0, 1, 0, 1))  # (1, 4 C, H / 2 + 1, W / 2 + 1)
    behind = model.code_bias.new_zeros(VECTOR_SIZE)  # the last vector of the last row reaches into it
    return torch.cat([part.flatten() for part in (*small, channels, model.code_bias, *large, behind)])


def side_by_side(work: Callable[..., None], parts: list[tuple[Any, ...]], threads: int) -> None:
    """The work on all parts, so many at a time."""
    if len(parts) == 1 or threads == 1:
        for part in parts:
            work(*part)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, *zip(*parts, strict=True)))


class ClosedLoop(torch.autograd.Function):
    """From all weights and the initial values of a closed loop to its predictions."""

    @staticmethod
    def forward(
        ctx: Any, weights: Tensor, initial: Tensor, programs: list[Program], layout: Layout, num_steps: int, keep_steps: bool
    ) -> tuple[Tensor, ...]:
        predicted = [weights.new_empty(len(initial), num_steps, indices.shape[1]) for indices in programs[0].read]
        buffers = [weights.new_empty(num_steps + 1 if keep_steps else 2, program.length) for program in programs]
        rows = [each.split([program.batch for program in programs]) for each in (initial, *predicted)]
        numbers = layout.weights.numpy(), layout.forward
        parts = zip(programs, buffers, *rows, strict=True)
        given = [(*program.lists, *numbers, scratch_of(program, layout.narrow), *in_numpy(*each)) for program, *each in parts]
        ctx.threads = torch.get_num_threads()
        side_by_side(go_forward, given, ctx.threads)
        if not (layout.total + initial.sum()).isfinite():  # fast arithmetic assumes that all are; a sum tells in a twentieth of the time
            predicted = [each.fill_(torch.nan) for each in predicted]
        ctx.programs, ctx.layout = programs, layout
        ctx.save_for_backward(*buffers)
        return tuple(predicted)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_predicted: Tensor) -> tuple[Tensor | None, ...]:
        buffers, layout = list(ctx.saved_tensors), ctx.layout
        programs, weights, learned = ctx.programs, layout.weights, ctx.needs_input_grad[0]
        counts, num_steps = [program.batch for program in programs], len(buffers[0]) - 1
        grad_initial = weights.new_empty(sum(counts), programs[0].initial.shape[1])
        grad_small = weights.new_zeros(len(programs), programs[0].num_weights)
        tapes = [weights.new_empty(num_steps if learned else 0, program.tape) for program in programs]
        grad_pixels, grad_codes, initial = (each.contiguous().split(counts) for each in (*grad_predicted, grad_initial))
        parts = zip(programs, buffers, grad_pixels, grad_codes, grad_small, initial, tapes, strict=True)
        numbers = weights.numpy(), layout.backward
        given = [(*program.lists, *numbers, scratch_of(program, layout.narrow), *in_numpy(*each), learned) for program, *each in parts]
        side_by_side(go_backward, given, ctx.threads)
        grad_weights = gradient_of(weights, grad_small.sum(0), programs, buffers, tapes) if learned else None
        return grad_weights, grad_initial, None, None, None, None


def in_numpy(*tensors: Tensor) -> list[Any]:
    return [each.detach().numpy() for each in tensors]


def scratch_of(program: Program, narrow: bool) -> Any:
    """Room for the inputs and the gradients of the largest convolution in bfloat16, whose kind says that this is asked for."""
    return np.zeros((2, program.scratch), np.uint32) if narrow else np.empty((2, 0), np.float32)


def gradient_of(weights: Tensor, grad_small: Tensor, programs: list[Program], buffers: list[Tensor], tapes: list[Tensor]) -> Tensor:
    """The gradient of all weights: that of the small ones is given, a matrix gets its own from all steps of all parts at once."""
    result = torch.zeros_like(weights)
    result[: len(grad_small)] = grad_small
    for lines in zip(*(program.operations[program.operations["kind"] == MATRIX] for program in programs), strict=True):
        inputs, outputs, weight, bias = (int(lines[0][name]) for name in ("inputs", "outputs", "weight", "bias"))
        x, gradients = [], []
        for line, buffer, tape in zip(lines, buffers, tapes, strict=True):
            x.append(over_steps(buffer[1:] if line["source_now"] else buffer[:-1], line["source"], inputs, line["size"]))
            gradients.append(over_steps(tape, line["tape"], outputs, line["size"]))
        all_gradients = torch.cat(gradients, dim=1)
        torch.mm(all_gradients, torch.cat(x, dim=1).T, out=result[weight:bias].view(outputs, inputs))
        result[bias : bias + outputs] = all_gradients.sum(1)
    return result


def over_steps(steps: Tensor, first: int, channels: int, batch: int) -> Tensor:
    """A vector of all steps, (channels, T * batch)."""
    return steps[:, first : first + channels * batch].unflatten(1, (channels, -1)).transpose(0, 1).flatten(1)
