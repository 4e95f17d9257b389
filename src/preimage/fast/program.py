"""A small network written down as a list of operations, and its closed loop by them.

In a network of a few maps a call of torch takes far longer than the arithmetic it asks for. Here the network is first written down: a
`Program` lists what a step does with one stretch of numbers, which holds all that the step computes. Compiled loops (`fast.compiled`) then
go through the list, step by step, forward and back. What `PDVMRNN.at` does to tensors, `Program` does to places.

* Every rearrangement (patches laid side by side, a map made larger, a map read as a vector) is a list of places, found by handing
  numbered places to the very function that rearranges tensors. A mean over patches is the same with a factor.
* An operation reads and writes the stretch of the step itself or that of the step before. What enters a cell is gathered in the stretch
  before, around the hidden state, which lies there already; so states are never copied.
* The loop keeps every step's stretch, so that the way back finds what it needs, or two in turn where no gradient is asked for.

>>> from preimage.network.pdvmrnn import PDVMRNN
>>> from preimage.network.config import ModelConfig, Sensors
>>> program = Program(PDVMRNN(ModelConfig.tiny(), Sensors(16, 16, 1, ("a", "b"), (-1.0, -1.0), (1.0, 1.0))), batch=3)
>>> len(program.operations), len(program.maps), program.maps[0][0]
(39, 17, 'ups.2.project')
"""

# pyright: reportIncompatibleMethodOverride=false, reportCallIssue=false, reportArgumentType=false
# torch declares forward and backward of a Function with any arguments; what a ModuleList holds its type does not tell.

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional

from preimage.fast.compiled import APPLY, CONVOLVE, ENCODE, GATE, OPERATION, SPREAD, SQUASH, go_backward, go_forward
from preimage.fast.planes import TILE
from preimage.network.cells import State, depth_to_space, space_to_depth
from preimage.network.linear import Conv


class Block(NamedTuple):
    """Planes that lie one behind the other, each with all sequences of the batch."""

    offset: int
    planes: int
    batch: int
    height: int
    width: int
    margin: int
    """1 for maps, 0 for vectors."""
    now: bool = True
    """Whether in the step's own stretch or in that of the step before."""

    @property
    def row(self) -> int:
        return self.width + self.margin

    @property
    def image(self) -> int:
        return (self.height + self.margin) * self.row

    @property
    def size(self) -> int:
        """Numbers of a plane; maps fill whole tiles."""
        return -(-self.batch * self.image // TILE) * TILE if self.margin else self.batch

    @property
    def before(self) -> "Block":
        return self._replace(now=False)

    def part(self, first: int, planes: int) -> "Block":
        return self._replace(offset=self.offset + first * self.size, planes=planes)

    def places(self) -> Tensor:
        """Where each number of a tensor (B, planes, height, width) lies."""
        plane, sequence = torch.arange(self.planes)[:, None, None], torch.arange(self.batch)[:, None, None, None]
        line, column = torch.arange(self.height)[:, None], torch.arange(self.width)
        return self.offset + plane * self.size + sequence * self.image + line * self.row + column


class Program:
    """A network as a list of operations, for so many sequences."""

    def __init__(self, model: Any, batch: int) -> None:
        self.batch, self.length, self.num_weights = batch, 0, 0
        self.maps: list[tuple[str, int]] = []
        self.lines: list[dict[str, float]] = []
        self.moves: list[Tensor] = []
        sensors, shapes = model.sensors, model.state_shapes
        self.gates = {name: self.block(4 * shape[0], *shape[1:]) for name, shape in shapes.items()}
        self.squashed = {name: self.block(*shape) for name, shape in shapes.items()}
        picture, num_codes = (4 * sensors.channels, sensors.height // 2, sensors.width // 2), model.code_bias.numel()
        self.drawn, self.logits = self.block(*picture), self.block(num_codes)
        self.cleared = self.length
        """Before it lies what a step writes over, from here on what it adds to: this is zeros when the step begins."""
        self.pixels, self.codes, self.log_codes = self.block(*picture), self.block(num_codes), self.block(num_codes)
        self.cells = {name: self.block(*shape) for name, shape in shapes.items()}
        entering = {name: model.get_submodule(cell_of(name)).gates.weight.shape[1] for name in shapes}
        self.into = {name: self.block(entering[name], *shape[1:]).before for name, shape in shapes.items()}
        self.hidden = {name: self.into[name].part(entering[name] - shape[0], shape[0]) for name, shape in shapes.items()}
        self.spare = self.block(TILE)
        self._write_step(model)
        self.length += max(block.row for block in (self.pixels, *self.into.values())) + 1  # zeros behind the last plane
        self.operations = np.array([tuple(line.get(name, 0) for name in OPERATION.names or ()) for line in self.lines], OPERATION)
        self.places = torch.cat(self.moves, dim=1).int().numpy()  # (2, number of moves): from where and to where
        read = depth_to_space(self.pixels.places()).flatten(1), self.log_codes.places().flatten(1)
        self.read = [places.int().contiguous().numpy() for places in read]
        states = [part[name].places() for name in shapes for part in (self.hidden, self.cells)]
        begun = [*states, depth_to_space(self.pixels.places()), self.codes.places()]
        self.begun = torch.cat([places.flatten() for places in begun])[None].int().numpy()
        self.lists = self.operations, self.cleared, self.places, self.begun, *self.read

    def block(self, planes: int, height: int = 0, width: int = 0) -> Block:
        """Room for maps of this size, with zeros before them, or, without a size, for a vector."""
        margin = int(height > 0)
        block = Block(self.length + margin * (width + 2), planes, self.batch, max(height, 1), max(width, 1), margin)
        self.length = block.offset + planes * block.size
        return block

    def write(self, kind: int, source: Block, target: Block, **more: float) -> None:
        line = {"kind": kind, "source": source.offset, "source_now": source.now, "target": target.offset, "target_now": target.now}
        shape = {"inputs": source.planes, "outputs": target.planes, "size": target.size, "row": target.row, "image": target.image}
        self.lines.append(line | shape | {"batch": self.batch, "spare": self.spare.offset} | more)

    def map(self, kind: int, name: str, source: Block, target: Block) -> None:
        """A linear map by the weights of the part of the network that has this name."""
        bias = self.num_weights + source.planes * target.planes * (9 if kind == CONVOLVE else 1)
        self.write(kind, source, target, weight=self.num_weights, bias=bias)
        self.maps.append((name, kind))
        self.num_weights = bias + target.planes

    def move(self, source: Block, target: Block, rearranged: Callable[[Tensor], Tensor] = lambda maps: maps) -> None:
        self.add(source, target, rearranged(source.places()), target.places())

    def add(self, source: Block, target: Block, from_where: Tensor, to_where: Tensor, factor: float = 1.0) -> None:
        """Add the numbers of some places, times a factor, to those of others, which are zeros at first."""
        pairs = torch.stack([from_where.flatten(), to_where.flatten()])
        self.write(SPREAD, source, target, first=sum(each.shape[1] for each in self.moves), count=pairs.shape[1], factor=factor)
        self.moves.append(pairs)

    def gate(self, name: str) -> None:
        """Move a layer: what enters its cell is there."""
        cell, gates = self.cells[name], self.gates[name]
        self.map(CONVOLVE if cell.margin else APPLY, f"{cell_of(name)}.gates", self.into[name], gates)
        self.write(GATE, gates, self.hidden[name]._replace(now=True), cell=cell.offset, squashed=self.squashed[name].offset)

    def up(self, k: int, below: Block, into: Block) -> None:
        """`network.cells.Up`, from level k to the one above."""
        laid = below
        if k > 0:  # the pixels lie so already
            laid = self.block(4 * below.planes, below.height // 2, below.width // 2)
            self.move(below, laid, space_to_depth)
        self.map(CONVOLVE, f"ups.{k}.project", laid, into)

    def down(self, k: int, above: Block, into: Block) -> None:
        """`network.cells.Down`, to level k from the one above."""
        laid = self.block(4 * into.planes, above.height, above.width)
        self.map(CONVOLVE, f"downs.{k}.project", above, laid)
        self.move(laid, into, depth_to_space)

    def to_maps(self, name: str, units: Block, grid: tuple[int, int], into: Block) -> None:
        """`network.cells.Lateral.to_vision`: from a layer of the motors to maps on a grid, made as large as those they enter."""
        coarse = self.block(into.planes * grid[0] * grid[1])
        self.map(APPLY, name, units, coarse)
        scale = into.height // grid[0]
        self.move(coarse, into, lambda places: enlarged(places.flatten(1).unflatten(1, (*grid, -1)).permute(0, 3, 1, 2), scale))

    def from_maps(self, name: str, maps: Block, grid: tuple[int, int], seen: int, into: Block) -> None:
        """`network.cells.Lateral.to_motor`: from maps, by their means on a grid, to what a layer of the motors sees of them."""
        scale = maps.height // grid[0]
        coarse, features = self.block(maps.planes, *grid), self.block(seen, *grid)
        self.add(maps, coarse, maps.places(), enlarged(coarse.places(), scale), 1 / scale**2)
        self.map(CONVOLVE, name, coarse, features)
        self.move(features, into, lambda places: places.permute(0, 2, 3, 1))

    def _write_step(self, model: Any) -> None:
        """`PDVMRNN.at`, operation by operation."""
        config, into, before = model.config, self.into, self.hidden
        levels, lateral, grid = config.num_levels, config.lateral_channels, model.laterals[0].grid
        now = {name: block._replace(now=True) for name, block in before.items()}
        below_vision = [self.pixels.before, *(before[f"vision{level}"] for level in range(1, levels + 1))]
        below_motor = [self.codes.before, *(before[f"motor{level}"] for level in range(1, levels + 1))]
        top = before["top"]
        self.up(levels, below_vision[-1], into["top"].part(0, top.planes))
        self.to_maps("motor_to_top", below_motor[-1], (top.height, top.width), into["top"].part(top.planes, lateral))
        self.gate("top")
        vision_above = motor_above = now["top"]
        for level in range(levels, 0, -1):
            vision, motor, k = f"vision{level}", f"motor{level}", level - 1
            flow = (before[vision].planes - lateral) // 2
            self.up(k, below_vision[k], into[vision].part(0, flow))
            self.down(k, vision_above, into[vision].part(flow, flow))
            self.to_maps(f"laterals.{k}.from_motor", before[motor], grid, into[vision].part(2 * flow, lateral))
            heard, above = below_motor[k].planes, motor_above.places()[0].numel()
            self.move(below_motor[k], into[motor].part(0, heard))
            self.move(motor_above, into[motor].part(heard, above))
            features = into[motor].part(heard + above, config.seen_channels * grid[0] * grid[1])
            self.from_maps(f"laterals.{k}.from_vision", before[vision], grid, config.seen_channels, features)
            self.gate(vision)
            self.gate(motor)
            vision_above, motor_above = now[vision], now[motor]
        self._read_out(vision_above, motor_above, config.units_per_joint)

    def _read_out(self, vision: Block, motor: Block, units_per_joint: int) -> None:
        self.map(CONVOLVE, "to_pixels.project", vision, self.drawn)
        self.map(APPLY, "to_codes", motor, self.logits)
        of_pixels, of_codes = self.num_weights, self.num_weights + self.drawn.planes * self.drawn.size
        self.write(SQUASH, self.drawn, self.pixels, bias=of_pixels)
        self.write(ENCODE, self.logits, self.log_codes, cell=self.codes.offset, bias=of_codes, count=units_per_joint)


def cell_of(name: str) -> str:
    """The part of the network that moves a layer: "vision1" is "visions.0"."""
    path = name.rstrip("0123456789")
    return name if name == path else f"{path}s.{int(name.removeprefix(path)) - 1}"


def enlarged(places: Tensor, scale: int) -> Tensor:
    return places.repeat_interleave(scale, -2).repeat_interleave(scale, -1)


def weights_of(model: Any, program: Program) -> Tensor:
    """All weights in the order of the program, on end."""
    parts = []
    for name, kind in program.maps:
        layer = model.get_submodule(name)
        if kind == APPLY:
            weight = layer.weight.t()  # one input's weights lie together, so that those of all outputs make a vector
        else:
            weight = layer.weight if isinstance(layer, Conv) else functional.pad(layer.weight[..., None, None], (1, 1, 1, 1))
        parts += [weight, layer.bias]
    drawn = program.drawn
    planes = space_to_depth(model.pixel_bias[None]).movedim(0, 1).expand(-1, program.batch, -1, -1)  # (4 C, B, H / 2, W / 2)
    planes = functional.pad(planes, (0, 1, 0, 1)).flatten(1)
    planes = functional.pad(planes, (0, drawn.size - planes.shape[1]))  # (4 C, numbers of a plane)
    return torch.cat([part.flatten() for part in (*parts, planes, model.code_bias)])


PROGRAMS: WeakKeyDictionary[nn.Module, dict[int, Program]] = WeakKeyDictionary()
"""What was written, by network and number of sequences."""


def closed_loop(model: Any, states: Mapping[str, State], start: tuple[Tensor, Tensor], *, num_steps: int) -> tuple[Tensor, Tensor]:
    """The predicted pixels (B, T, C, H, W) and log codes (B, T, J, K).

    Args:
        model: a `PDVMRNN` without keypoints, on the CPU, in single or double precision.
        states: hidden and cell state of every layer before the first step.
        start: pixels (B, C, H, W) and codes (B, J, K) of the first input.
    """
    pixels, codes = start
    programs = PROGRAMS.setdefault(model, {})
    program = programs.get(len(pixels)) or programs.setdefault(len(pixels), Program(model, len(pixels)))
    parts = [*(part for name in program.hidden for part in states[name]), pixels, codes]
    begun = torch.cat([part.flatten() for part in parts])[None]
    weights = weights_of(model, program)
    recorded = torch.is_grad_enabled() and (begun.requires_grad or weights.requires_grad)
    drawn, log_codes = ClosedLoop.apply(weights, begun, program, num_steps, recorded)  # pyright: ignore[reportGeneralTypeIssues]
    return drawn.unflatten(2, pixels.shape[1:]), log_codes.unflatten(2, codes.shape[1:])


class ClosedLoop(torch.autograd.Function):
    """From all weights and what a closed loop starts from to what it predicts."""

    @staticmethod
    def forward(ctx: Any, weights: Tensor, begun: Tensor, program: Program, num_steps: int, recorded: bool) -> tuple[Tensor, ...]:
        predicted = [weights.new_empty(len(places), num_steps, places.shape[1]) for places in program.read]
        stretches = weights.new_empty(num_steps + 1 if recorded else 2, program.length)
        go_forward(*program.lists, *(each.detach().numpy() for each in (weights, stretches, begun, *predicted)))
        if not (weights.isfinite().all() and begun.isfinite().all()):  # of which fast arithmetic knows nothing
            predicted = [each.fill_(torch.nan) for each in predicted]
        ctx.program = program
        ctx.save_for_backward(weights, stretches)
        return tuple(predicted)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *of_predicted: Tensor) -> tuple[Tensor | None, ...]:
        weights, stretches = ctx.saved_tensors
        learned = ctx.needs_input_grad[0]
        of_weights, of_begun = torch.zeros_like(weights), weights.new_empty(ctx.program.begun.shape)
        given = weights, stretches, *(each.contiguous() for each in of_predicted), of_weights, of_begun
        go_backward(*ctx.program.lists, *(each.detach().numpy() for each in given), learned)
        return of_weights if learned else None, of_begun, None, None, None
