"""The parts of one time step: the LSTM cells, and the connections between layers.

A cell, like the layers of `network.linear` that it is made of, is first prepared by `at` in a precision, for the steps of one sequence,
and then called at each of them:

>>> import torch
>>> cell = LSTM(inputs=3, units=5)
>>> step = cell.at(torch.float32)
>>> step([torch.zeros(2, 3)], (torch.zeros(2, 5), torch.zeros(2, 5)))[0].shape
torch.Size([2, 5])
"""

# pyright: reportIncompatibleMethodOverride=false
# torch declares forward and backward of a Function with any arguments.

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from preimage.network.linear import Conv, Layer, Linear, Step, Tape, empty, prepared

State = tuple[Tensor, Tensor]
"""Hidden state h and cell state c of one layer, each (B, units) or (B, channels, height, width)."""
CellFunction = Callable[[Sequence[Tensor], State], State]


class CellStep(torch.autograd.Function):
    """One step of an LSTM: from the concatenated inputs through a layer to the gates, and through these to the new state.

    The gates are input, forget, output and candidate, stacked along dimension 1: c' = f c + i g and h' = o tanh(c'), with i, f, o
    sigmoids and g a tanh of them. The cell state keeps its own precision; the hidden state comes in that of the layer.
    """

    @staticmethod
    def forward(ctx: Any, cell: Tensor, weight: Tensor, bias: Tensor, layer: Layer, tape: Tape | None, *inputs: Tensor) -> State:
        joined, ctx.number = tape.record(inputs) if tape else (torch.cat(inputs, dim=1), 0)
        gates = layer.value(joined, weight, bias, tape and tape.packed)
        activated = activated_gates(gates, cell.dtype)
        input_gate, forget_gate, output_gate, candidate = activated.movedim(-1, 2)
        new_cell = torch.addcmul(forget_gate * cell, input_gate, candidate)
        tanh_cell = new_cell.tanh() if new_cell.is_cuda else (2 * new_cell).sigmoid_().mul_(2).sub_(1)
        ctx.layer, ctx.tape, ctx.channels = layer, tape, [part.shape[1] for part in inputs]
        ctx.save_for_backward(weight, activated, cell, tanh_cell, *(() if tape else (joined,)))
        return (output_gate * tanh_cell).to(gates.dtype), new_cell

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_hidden: Tensor, grad_cell: Tensor) -> tuple[Tensor | None, ...]:
        weight, activated, cell, tanh_cell, *saved = ctx.saved_tensors
        input_gate, forget_gate, output_gate, candidate = activated.movedim(-1, 2)
        grad_hidden = grad_hidden.to(cell.dtype)
        # Into a tensor of the usual memory layout: the first gradients are zeros of another, which all later ones would inherit.
        grad_cell = torch.ops.aten.tanh_backward(grad_hidden * output_gate, tanh_cell).add_(grad_cell)
        back = torch.empty_like(activated)
        gates = back.movedim(-1, 2)
        torch.mul(grad_cell, candidate, out=gates[0])
        torch.mul(grad_cell, cell, out=gates[1])
        torch.mul(grad_hidden, tanh_cell, out=gates[2])
        torch.mul(grad_cell, input_gate, out=gates[3])
        torch.ops.aten.sigmoid_backward(back[:3], activated[:3], grad_input=back[:3])
        torch.ops.aten.tanh_backward(back[3], activated[3], grad_input=back[3])
        (joined,) = saved or (ctx.tape.at(ctx.number),)
        shape = len(cell), 4 * cell.shape[1], *cell.shape[2:]
        grad_gates = ctx.tape.gradient_buffer(ctx.number, shape) if ctx.tape else empty(shape, joined, ctx.layer.layout)
        grad_gates.movedim(1, -1).unflatten(-1, (4, -1)).movedim(-2, 0).copy_(back)
        grad_inputs = ctx.layer.input_gradient(grad_gates, joined, weight, ctx.tape and ctx.tape.packed)
        return grad_cell * forget_gate, None, None, None, None, *grad_inputs.split(ctx.channels, dim=1)


def activated_gates(gates: Tensor, dtype: torch.dtype) -> Tensor:
    """Sigmoids of input, forget and output gate and the tanh of the candidate, (4, B, *size, units).

    One contiguous block per gate: with the gates interleaved in every pixel each operation would be strided.
    """
    by_pixel = gates.movedim(1, -1)
    units = by_pixel.shape[-1] // 4
    activated = torch.empty(4, *by_pixel.shape[:-1], units, dtype=dtype, device=gates.device)
    activated.copy_(by_pixel.unflatten(-1, (4, units)).movedim(-2, 0))
    activate_gates(activated)
    return activated


def activate_gates(gates: Tensor) -> None:
    """In place, a sigmoid of input, forget and output gate and a tanh of the candidate."""
    if gates.is_cuda:  # every call is a kernel
        gates[:3].sigmoid_()
        gates[3].tanh_()
        return
    gates[3].mul_(2)
    gates.sigmoid_()
    gates[3].mul_(2).sub_(1)  # tanh x = 2 sigmoid 2x - 1, and a sigmoid is the faster of the two by far


def start_with_open_forget_gate(bias: Tensor) -> None:
    """Forget-gate bias 1 at the start, all others 0, so that the intention survives the first steps of untrained weights."""
    with torch.no_grad():
        bias.zero_()
        bias[len(bias) // 4 : len(bias) // 2] = 1.0


class LSTM(nn.Module):
    """A fully connected LSTM cell over the concatenation of its inputs and its own hidden state."""

    def __init__(self, inputs: int, units: int) -> None:
        super().__init__()
        self.gates = Linear(inputs + units, 4 * units)
        start_with_open_forget_gate(self.gates.bias)

    def at(self, dtype: torch.dtype, num_steps: int = 1) -> CellFunction:
        """The cell in this precision, for all steps of one sequence."""
        return cell_step(self.gates, dtype, num_steps)


class ConvLSTM(nn.Module):
    """A convolutional LSTM cell (Shi et al. 2015): every linear map of the LSTM is a convolution over the feature map."""

    def __init__(self, inputs: int, channels: int, kernel: int = 3) -> None:
        super().__init__()
        self.gates = Conv(inputs + channels, 4 * channels, kernel)
        assert self.gates.bias is not None
        start_with_open_forget_gate(self.gates.bias)

    def at(self, dtype: torch.dtype, num_steps: int = 1) -> CellFunction:
        """The cell in this precision, for all steps of one sequence."""
        return cell_step(self.gates, dtype, num_steps)


def cell_step(layer: Layer, dtype: torch.dtype, num_steps: int) -> CellFunction:
    weight, bias, tape = prepared(layer, dtype, num_steps)

    def step(inputs: Sequence[Tensor], state: State) -> State:
        hidden, cell = state
        return CellStep.apply(cell, weight, bias, layer, tape, *inputs, hidden)  # pyright: ignore[reportReturnType]

    return step


def space_to_depth(maps: Tensor) -> Tensor:
    """(B, C, H, W) to (B, 4C, H/2, W/2): each 2x2 patch becomes one pixel; channels last in memory."""
    batch, channels, height, width = maps.shape
    patches = maps.permute(0, 2, 3, 1).reshape(batch, height // 2, 2, width // 2, 2, channels).transpose(2, 3)
    return patches.reshape(batch, height // 2, width // 2, 4 * channels).permute(0, 3, 1, 2)  # (B, 4C, H/2, W/2)


def depth_to_space(maps: Tensor) -> Tensor:
    """The inverse of `space_to_depth`."""
    batch, channels, height, width = maps.shape
    patches = maps.permute(0, 2, 3, 1).reshape(batch, height, width, 2, 2, channels // 4).transpose(2, 3)
    return patches.reshape(batch, 2 * height, 2 * width, channels // 4).permute(0, 3, 1, 2)  # (B, C, H, W)


SHARPNESS = 10.0
"""Factor on the logits of a keypoint's map, so that an untrained network can already point at a few pixels."""


def expected_positions(heat: Tensor) -> Tensor:
    """The mean position under the softmax of each map, (B, height, width, K) to (B, 2 K): -1 at the left and upper edge, 1 at the others.

    >>> heat = torch.zeros(1, 3, 5, 1)
    >>> heat[0, 2, 1] = 100.0
    >>> expected_positions(heat).tolist()
    [[-0.5, 1.0]]
    """
    weights = heat.flatten(1, 2).softmax(1).view_as(heat)
    of_columns, of_rows = weights.sum(1), weights.sum(2)  # (B, width, K), (B, height, K)
    positions = [torch.linspace(-1, 1, each.shape[1], dtype=heat.dtype, device=heat.device) @ each for each in (of_columns, of_rows)]
    return torch.cat(positions, dim=1)


class Lateral(nn.Module):
    """The lateral connection of the two paths at one level: a few feature maps on a coarse grid, and the positions of keypoints."""

    def __init__(
        self, *, channels: int, units: int, size: tuple[int, int], grid: tuple[int, int], lateral: int, seen: int, keypoints: int
    ) -> None:
        super().__init__()
        self.grid, self.scale, self.lateral = grid, size[0] // grid[0], lateral
        self.from_motor = Linear(units, lateral * grid[0] * grid[1])
        self.from_vision = Linear(channels, seen)
        self.to_keypoints = Linear(channels, keypoints) if keypoints else None

    def to_vision(self, dtype: torch.dtype, num_steps: int = 1) -> Step:
        """(B, units) to (B, lateral, height, width)."""
        project = self.from_motor.at(dtype, num_steps)

        def step(hidden: Tensor) -> Tensor:
            coarse = project(hidden).unflatten(1, (*self.grid, self.lateral)).permute(0, 3, 1, 2)  # (B, lateral, *grid)
            return coarse if self.scale == 1 else nn.functional.interpolate(coarse, scale_factor=self.scale, mode="nearest")

        return step

    def to_motor(self, dtype: torch.dtype, num_steps: int = 1) -> Step:
        """(B, channels, height, width) to (B, seen * grid + 2 * keypoints)."""
        project = self.from_vision.at(dtype, num_steps)
        point = self.to_keypoints.at(dtype, num_steps) if self.to_keypoints else None

        def step(hidden: Tensor) -> Tensor:
            coarse = hidden if self.scale == 1 else nn.functional.avg_pool2d(hidden, self.scale)
            features = project(coarse.permute(0, 2, 3, 1)).flatten(1)
            if point is None:
                return features
            heat = SHARPNESS * point(hidden.permute(0, 2, 3, 1)).to(self.from_vision.weight.dtype)
            return torch.cat([features, expected_positions(heat).to(dtype)], dim=1)

        return step


class Up(nn.Module):
    """From a layer to the one above: a convolution of kernel 6 and stride 2, computed on 2x2 patches laid side by side."""

    def __init__(self, below: int, above: int) -> None:
        super().__init__()
        self.project = Conv(4 * below, above)

    def at(self, dtype: torch.dtype, num_steps: int = 1) -> Step:
        project = self.project.at(dtype, num_steps)
        return lambda maps: project(space_to_depth(maps))


class Down(nn.Module):
    """From a layer to the one below: a transposed convolution of kernel 6 and stride 2, computed as 2x2 patches laid side by side."""

    def __init__(self, above: int, below: int) -> None:
        super().__init__()
        self.project = Conv(above, 4 * below)

    def at(self, dtype: torch.dtype, num_steps: int = 1) -> Step:
        project = self.project.at(dtype, num_steps)
        return lambda maps: depth_to_space(project(maps))
