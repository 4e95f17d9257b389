"""Linear maps that are used at every step of a sequence, and whose weights learn from all steps at once.

An unrolled network applies the same weights at every step of a sequence. Summing the weights' gradient step by step costs a small
matrix product each time; here each map writes what goes in and what comes back side by side on a tape, and its gradient is one large
product over all steps when the last of them has been gone back through. That is the same sum in another order, exact in float64,
more accurate in bfloat16 (one accumulation in float32), and faster.

A map is first taken `at` a precision, for the steps of one sequence, and then called at each of them:

>>> import torch
>>> step = Linear(3, 5).at(torch.float32, num_steps=2)
>>> step(torch.zeros(4, 3)).shape
torch.Size([4, 5])
"""

# pyright: reportIncompatibleMethodOverride=false
# torch declares forward and backward of a Function with any arguments.

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from preimage.compute.precision import computes_bfloat16

Step = Callable[[Tensor], Tensor]
Packed = tuple[Tensor, Tensor] | None
"""A matrix and its transpose in the order in which a CPU multiplies them, where it pays."""
LARGE = 2**20
"""Weights from which on a matrix is packed."""


class Tape:
    """What entered a map at each step, and the gradient that came back to its output, side by side as one large batch.

    Args:
        num_steps: how many steps are to come, at most.
        layout: how batches lie in memory.
    """

    def __init__(self, num_steps: int, layout: torch.memory_format) -> None:
        self.num_steps, self.layout = num_steps, layout
        self.packed: Packed = None
        self.clear()

    def clear(self) -> None:
        """Give the memory back."""
        self.entered: Tensor | None = None
        self.returned: Tensor | None = None
        self.num_entered = 0
        self.steps_returned: set[int] = set()

    def enter(self, parts: Sequence[Tensor]) -> tuple[Tensor, int]:
        """The parts joined along dimension 1, which is the input of a new step, and the number of that step."""
        number, self.num_entered = self.num_entered, self.num_entered + 1
        if self.entered is None:
            batch, _, *size = parts[0].shape
            self.entered = self._room((batch, sum(part.shape[1] for part in parts), *size), parts[0])
        return torch.cat(list(parts), dim=1, out=self.at(number)), number

    def at(self, number: int) -> Tensor:
        """What entered at a step."""
        assert self.entered is not None
        return self._step(self.entered, number)

    def room_for(self, number: int, shape: Sequence[int]) -> Tensor:
        """Where the gradient that comes back to the output of a step, which is of this shape, is to be written."""
        if self.returned is None:
            assert self.entered is not None
            self.returned = self._room(shape, self.entered)
        self.steps_returned.add(number)
        return self._step(self.returned, number)

    def whole(self) -> tuple[Tensor, Tensor] | None:
        """All inputs and all gradients, (steps * B, ...); a step to which nothing came back counts as zero."""
        if self.entered is None or self.returned is None:
            return None
        rows = self.num_entered * (len(self.entered) // self.num_steps)
        for number in set(range(self.num_entered)) - self.steps_returned:
            self._step(self.returned, number).zero_()
        return self.entered[:rows], self.returned[:rows]

    def _step(self, steps: Tensor, number: int) -> Tensor:
        return steps.unflatten(0, (self.num_steps, -1))[number]

    def _room(self, shape: Sequence[int], like: Tensor) -> Tensor:
        return room((self.num_steps * shape[0], *shape[1:]), like, self.layout)


def room(shape: Sequence[int], like: Tensor, layout: torch.memory_format) -> Tensor:
    """A tensor to be written into, of the precision and in the place of another."""
    return torch.empty(shape, dtype=like.dtype, device=like.device, memory_format=layout)


class Linear(nn.Linear):
    """A fully connected map over the last dimension."""

    layout = torch.contiguous_format

    def at(self, dtype: torch.dtype, num_steps: int = 1) -> Step:
        """The map in this precision, for all steps of one sequence."""
        return stepwise(self, dtype, num_steps)

    def pack(self, weight: Tensor) -> Packed:
        """The weights in the order in which they are multiplied, once for all steps: few rows take less time than the ordering."""
        suits = weight.dtype == torch.bfloat16 and weight.device.type == "cpu" and weight.numel() >= LARGE
        # torch's own compiler is who calls these otherwise, so that a later torch may not have them.
        if not suits or not hasattr(torch.ops.mkldnn, "_reorder_linear_weight") or not computes_bfloat16(weight.device):
            return None
        order = torch.ops.mkldnn._reorder_linear_weight
        return order(weight), order(weight.T.contiguous())

    def value(self, inputs: Tensor, weight: Tensor, bias: Tensor, packed: Packed = None) -> Tensor:
        return nn.functional.linear(inputs, weight, bias) if packed is None else packed_product(inputs, packed[0], bias)

    def input_gradient(self, gradient: Tensor, inputs: Tensor, weight: Tensor, packed: Packed = None) -> Tensor:
        return gradient @ weight if packed is None else packed_product(gradient, packed[1])

    def weight_gradient(self, inputs: Tensor, gradients: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
        gradients, inputs = gradients.flatten(0, -2), inputs.flatten(0, -2)
        return gradients.T @ inputs, gradients.sum(0, dtype=self.weight.dtype)


def packed_product(rows: Tensor, packed: Tensor, bias: Tensor | None = None) -> Tensor:
    return torch.ops.mkldnn._linear_pointwise(rows, packed, bias, "none", [], "")


class Conv(nn.Conv2d):
    """A convolution of an odd kernel that keeps the size of the map, channels last in memory: twice as fast on a CPU."""

    layout = torch.channels_last

    def __init__(self, inputs: int, channels: int, kernel: int = 3) -> None:
        super().__init__(inputs, channels, kernel, padding=kernel // 2)
        self.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]

    def at(self, dtype: torch.dtype, num_steps: int = 1) -> Step:
        """The map in this precision, for all steps of one sequence."""
        return stepwise(self, dtype, num_steps)

    def pack(self, weight: Tensor) -> Packed:
        return None

    def value(self, inputs: Tensor, weight: Tensor, bias: Tensor, packed: Packed = None) -> Tensor:
        return nn.functional.conv2d(inputs, weight, bias, padding=self.padding)

    def input_gradient(self, gradient: Tensor, inputs: Tensor, weight: Tensor, packed: Packed = None) -> Tensor:
        return self._gradients(gradient, inputs, weight, [True, False, False])[0]

    def weight_gradient(self, inputs: Tensor, gradients: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
        _, of_weight, of_bias = self._gradients(gradients, inputs, weight, [False, True, True])
        return of_weight, of_bias

    def _gradients(self, gradient: Tensor, inputs: Tensor, weight: Tensor, wanted: list[bool]) -> Any:
        geometry = [1, 1], self.padding, [1, 1], False, [0, 0], 1
        return torch.ops.aten.convolution_backward(gradient, inputs, weight, [len(weight)], *geometry, wanted)


Map = Linear | Conv


def prepared(layer: Map, dtype: torch.dtype, num_steps: int) -> tuple[Tensor, Tensor, Tape | None]:
    """Weight and bias in this precision, for all steps of one sequence, and the tape for their gradients; none for frozen weights."""
    assert layer.bias is not None
    if not (torch.is_grad_enabled() and layer.weight.requires_grad):
        return layer.weight.to(dtype), layer.bias.to(dtype), None
    tape = Tape(num_steps, layer.layout)
    weight, bias = Weights.apply(layer.weight, layer.bias, layer, dtype, tape)  # pyright: ignore[reportGeneralTypeIssues]
    tape.packed = layer.pack(weight.detach())
    return weight, bias, tape


def stepwise(layer: Map, dtype: torch.dtype, num_steps: int) -> Step:
    """The layer in this precision as a function of one step's input."""
    weight, bias, tape = prepared(layer, dtype, num_steps)
    if tape is None:
        return lambda inputs: layer.value(inputs, weight, bias)
    return lambda inputs: MapStep.apply(inputs, weight, bias, layer, tape)  # pyright: ignore[reportReturnType]


class Weights(torch.autograd.Function):
    """A layer's weight and bias in another precision. Its backward comes last, when the tape holds every step."""

    @staticmethod
    def forward(ctx: Any, weight: Tensor, bias: Tensor, layer: Map, dtype: torch.dtype, tape: Tape) -> tuple[Tensor, Tensor]:
        ctx.layer, ctx.tape = layer, tape
        ctx.set_materialize_grads(False)
        narrow = weight.to(dtype, copy=True)
        ctx.save_for_backward(narrow)
        return narrow, bias.to(dtype, copy=True)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *_: None) -> tuple[Tensor | None, ...]:
        whole = ctx.tape.whole()
        if whole is None:
            return None, None, None, None, None
        of_weight, of_bias = ctx.layer.weight_gradient(*whole, *ctx.saved_tensors)
        ctx.tape.clear()
        return of_weight.to(ctx.layer.weight.dtype), of_bias.to(ctx.layer.bias.dtype), None, None, None


class MapStep(torch.autograd.Function):
    """One step of a layer. Its backward gives the input's gradient and leaves the weight's to `Weights`."""

    @staticmethod
    def forward(ctx: Any, inputs: Tensor, weight: Tensor, bias: Tensor, layer: Map, tape: Tape) -> Tensor:
        entered, ctx.number = tape.enter([inputs])
        ctx.layer, ctx.tape = layer, tape
        ctx.save_for_backward(weight)
        return layer.value(entered, weight, bias, tape.packed)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        (weight,) = ctx.saved_tensors
        returned = ctx.tape.room_for(ctx.number, gradient.shape).copy_(gradient)
        back = ctx.layer.input_gradient(returned, ctx.tape.at(ctx.number), weight, ctx.tape.packed) if ctx.needs_input_grad[0] else None
        return back, None, None, None, None
