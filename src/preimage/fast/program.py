"""A network written as a list of operations, and its closed loop run by them.

In a network of few channels a call of torch takes far longer than the arithmetic it asks for. So the network is first written down: a
`Program` lists what a step does with one buffer of numbers, which holds everything the step computes. Compiled loops (`fast.compiled`)
then run the list, step by step, forward and backward. What `PDVMRNN.at` does with tensors, `Program` does with indices.

* Every rearrangement (patches laid side by side, a feature map enlarged, a feature map read as a vector) is a list of indices, found by
  handing a tensor of indices to the very function that rearranges tensors. A mean over patches is the same with a factor.
* An operation reads and writes the buffer of its own step or that of the step before. The inputs of a cell are gathered in the buffer of
  the step before, around the hidden state, which is there already; so states are never copied.
* The loop keeps every step's buffer for the backward pass, or uses two in turn where no gradient is needed.

>>> from preimage.network.pdvmrnn import PDVMRNN
>>> from preimage.network.config import ModelConfig, Sensors
>>> program = Program(PDVMRNN(ModelConfig.tiny(), Sensors(16, 16, 1, ("a", "b"), (-1.0, -1.0), (1.0, 1.0))), batch=3)
>>> len(program.operations), len(program.maps), program.maps[0][0]
(39, 17, 'ups.2.project')
"""

# pyright: reportIncompatibleMethodOverride=false, reportCallIssue=false, reportArgumentType=false
# torch declares forward and backward of a Function with any arguments; the type of a ModuleList does not say what it holds.

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from preimage.fast.bfloat16 import margin_of
from preimage.fast.convolution import TILE
from preimage.fast.operations import CODES, CONVOLUTION, GATES, MATRIX, OPERATION, PIXELS, POINTS, SCATTER
from preimage.network.cells import SHARPNESS, depth_to_space, space_to_depth


class Block(NamedTuple):
    """Channels that lie one behind the other, each with all sequences of the batch."""

    offset: int
    channels: int
    batch: int
    height: int
    width: int
    padding: int
    """1 for feature maps, 0 for vectors."""
    now: bool = True
    """Whether in the step's own buffer or in that of the step before."""

    @property
    def row(self) -> int:
        return self.width + self.padding

    @property
    def image(self) -> int:
        return (self.height + self.padding) * self.row

    @property
    def size(self) -> int:
        """Numbers of a channel; feature maps fill whole tiles."""
        return -(-self.batch * self.image // TILE) * TILE if self.padding else self.batch

    @property
    def before(self) -> "Block":
        return self._replace(now=False)

    def part(self, first: int, channels: int) -> "Block":
        return self._replace(offset=self.offset + first * self.size, channels=channels)

    def indices(self) -> Tensor:
        """The index of each number of a tensor (B, channels, height, width)."""
        channel, sequence = torch.arange(self.channels)[:, None, None], torch.arange(self.batch)[:, None, None, None]
        line, column = torch.arange(self.height)[:, None], torch.arange(self.width)
        return self.offset + channel * self.size + sequence * self.image + line * self.row + column


class Program:
    """A network as a list of operations, for a batch of this size."""

    def __init__(self, model: Any, batch: int) -> None:
        self.batch, self.length, self.num_weights, self.num_matrix_weights, self.tape = batch, 0, 0, 0, 0
        self.maps: list[tuple[str, int]] = []
        self.lines: list[dict[str, float]] = []
        self.moves: list[Tensor] = []
        sensors, shapes = model.sensors, model.state_shapes
        self.gates = {name: self.block(4 * shape[0], *shape[1:]) for name, shape in shapes.items()}
        self.tanh_cells = {name: self.block(*shape) for name, shape in shapes.items()}
        frame, num_codes = (4 * sensors.channels, sensors.height // 2, sensors.width // 2), model.code_bias.numel()
        self.pixel_inputs, self.logits = self.block(*frame), self.block(num_codes)
        self.cleared = self.length
        """Before this index lies what a step overwrites, after it what it adds to, which is zeroed when the step begins."""
        self.pixels, self.codes, self.log_codes = self.block(*frame), self.block(num_codes), self.block(num_codes)
        self.cells = {name: self.block(*shape) for name, shape in shapes.items()}
        num_inputs = {name: model.get_submodule(cell_of(name)).gates.weight.shape[1] for name in shapes}
        self.inputs = {name: self.block(num_inputs[name], *shape[1:]).before for name, shape in shapes.items()}
        self.hidden = {name: self.inputs[name].part(num_inputs[name] - shape[0], shape[0]) for name, shape in shapes.items()}
        self.spare = self.block(TILE)
        self._write_step(model)
        self.length += max(block.row for block in (self.pixels, *self.inputs.values())) + 1  # zeros behind the last channel
        for line in self.lines:
            if line["kind"] == MATRIX:  # the large weights come last, for they get their gradients by themselves
                line |= {"weight": line["weight"] + self.num_weights, "bias": line["bias"] + self.num_weights}
        convolved = [line for line in self.lines if line["kind"] == CONVOLUTION]
        pairs = [((max(line["inputs"], line["outputs"]) + 1) // 2 * line["size"], margin_of(line["row"])) for line in convolved]
        self.scratch = int(max(count + 2 * margin for count, margin in pairs))
        self.operations = np.array([tuple(line.get(name, 0) for name in OPERATION.names or ()) for line in self.lines], OPERATION)
        self.indices = torch.cat(self.moves, dim=1).int().numpy()  # (2, number of moves): sources and targets
        read = depth_to_space(self.pixels.indices()).flatten(1), self.log_codes.indices().flatten(1)
        self.read = [indices.int().contiguous().numpy() for indices in read]
        states = [part[name].indices() for name in shapes for part in (self.hidden, self.cells)]
        initial = [*states, depth_to_space(self.pixels.indices()), self.codes.indices()]
        self.initial = torch.cat([indices.flatten(1) for indices in initial], dim=1).int().numpy()
        self.lists = self.operations, self.cleared, self.indices, self.initial, *self.read

    def block(self, channels: int, height: int = 0, width: int = 0) -> Block:
        """Reserve feature maps of this size, with zeros before them, or, without a size, a vector."""
        padding = int(height > 0)
        block = Block(self.length + padding * (width + 2), channels, self.batch, max(height, 1), max(width, 1), padding)
        self.length = block.offset + channels * block.size
        return block

    def write(self, kind: int, source: Block, target: Block, **more: float) -> None:
        line = {"kind": kind, "source": source.offset, "source_now": source.now, "target": target.offset, "target_now": target.now}
        shape = {"inputs": source.channels, "outputs": target.channels, "size": target.size, "row": target.row, "image": target.image}
        self.lines.append(line | shape | {"batch": self.batch, "spare": self.spare.offset} | more)

    def map(self, kind: int, name: str, source: Block, target: Block) -> None:
        """A linear map with the weights of the submodule of this name."""
        self.maps.append((name, kind))
        count = source.channels * target.channels
        if kind == MATRIX:
            self.write(kind, source, target, weight=self.num_matrix_weights, bias=self.num_matrix_weights + count, tape=self.tape)
            self.num_matrix_weights += count + target.channels
            self.tape += target.channels * self.batch
        else:
            self.write(kind, source, target, weight=self.num_weights, bias=self.num_weights + 9 * count)
            self.num_weights += 9 * count + target.channels

    def move(self, source: Block, target: Block, rearrange: Callable[[Tensor], Tensor] = lambda maps: maps) -> None:
        self.add(source, target, rearrange(source.indices()), target.indices())

    def add(self, source: Block, target: Block, sources: Tensor, targets: Tensor, factor: float = 1.0) -> None:
        """Add the numbers at some indices, times a factor, to those at others, which are zeros at first."""
        pairs = torch.stack([sources.flatten(), targets.flatten()])
        self.write(SCATTER, source, target, first=sum(each.shape[1] for each in self.moves), count=pairs.shape[1], factor=factor)
        self.moves.append(pairs)

    def gate(self, name: str) -> None:
        """The step of a layer whose inputs are in place."""
        cell, gates = self.cells[name], self.gates[name]
        self.map(CONVOLUTION if cell.padding else MATRIX, f"{cell_of(name)}.gates", self.inputs[name], gates)
        self.write(GATES, gates, self.hidden[name]._replace(now=True), cell=cell.offset, tanh_cell=self.tanh_cells[name].offset)

    def up(self, k: int, below: Block, target: Block) -> None:
        """`network.cells.Up`, from level k to the one above."""
        patches = below
        if k > 0:  # pixels are stored as patches
            patches = self.block(4 * below.channels, below.height // 2, below.width // 2)
            self.move(below, patches, space_to_depth)
        self.map(CONVOLUTION, f"ups.{k}.project", patches, target)

    def down(self, k: int, above: Block, target: Block) -> None:
        """`network.cells.Down`, to level k from the one above."""
        patches = self.block(4 * target.channels, above.height, above.width)
        self.map(CONVOLUTION, f"downs.{k}.project", above, patches)
        self.move(patches, target, depth_to_space)

    def to_maps(self, name: str, units: Block, grid: tuple[int, int], target: Block) -> None:
        """`network.cells.Lateral.to_vision`: from a motor layer to feature maps on a grid, enlarged to the size of those they enter."""
        coarse = self.block(target.channels * grid[0] * grid[1])
        self.map(MATRIX, name, units, coarse)
        scale = target.height // grid[0]
        self.move(coarse, target, lambda indices: enlarged(indices.flatten(1).unflatten(1, (*grid, -1)).permute(0, 3, 1, 2), scale))

    def from_maps(self, name: str, maps: Block, grid: tuple[int, int], seen: int, target: Block) -> None:
        """`network.cells.Lateral.to_motor`: from feature maps, by their means on a grid, to the features that a motor layer gets."""
        scale = maps.height // grid[0]
        coarse, features = self.block(maps.channels, *grid), self.block(seen, *grid)
        self.add(maps, coarse, maps.indices(), enlarged(coarse.indices(), scale), 1 / scale**2)
        self.map(CONVOLUTION, name, coarse, features)
        self.move(features, target, lambda indices: indices.permute(0, 2, 3, 1))

    def point(self, name: str, maps: Block, target: Block) -> None:
        """`network.cells.expected_positions`: from feature maps to the positions of keypoints."""
        heat = self.block(target.channels // 2, maps.height, maps.width)
        self.map(CONVOLUTION, name, maps, heat)
        shape = {"inputs": heat.channels, "size": heat.size, "row": heat.row, "image": heat.image}
        self.write(POINTS, heat, target, factor=SHARPNESS, **shape)

    def _write_step(self, model: Any) -> None:
        """`PDVMRNN.at`, operation by operation."""
        config, inputs, before = model.config, self.inputs, self.hidden
        levels, lateral, grid = config.num_levels, config.lateral_channels, model.laterals[0].grid
        now = {name: block._replace(now=True) for name, block in before.items()}
        below_vision = [self.pixels.before, *(before[f"vision{level}"] for level in range(1, levels + 1))]
        below_motor = [self.codes.before, *(before[f"motor{level}"] for level in range(1, levels + 1))]
        top = before["top"]
        self.up(levels, below_vision[-1], inputs["top"].part(0, top.channels))
        self.to_maps("motor_to_top", below_motor[-1], (top.height, top.width), inputs["top"].part(top.channels, lateral))
        self.gate("top")
        vision_above = motor_above = now["top"]
        for level in range(levels, 0, -1):
            vision, motor, k = f"vision{level}", f"motor{level}", level - 1
            flow = (before[vision].channels - lateral) // 2
            self.up(k, below_vision[k], inputs[vision].part(0, flow))
            self.down(k, vision_above, inputs[vision].part(flow, flow))
            self.to_maps(f"laterals.{k}.from_motor", before[motor], grid, inputs[vision].part(2 * flow, lateral))
            num_below, above = below_motor[k].channels, motor_above.indices()[0].numel()
            self.move(below_motor[k], inputs[motor].part(0, num_below))
            self.move(motor_above, inputs[motor].part(num_below, above))
            features = inputs[motor].part(num_below + above, config.seen_channels * grid[0] * grid[1])
            self.from_maps(f"laterals.{k}.from_vision", before[vision], grid, config.seen_channels, features)
            if config.keypoints:
                points = inputs[motor].part(num_below + above + features.channels, 2 * config.keypoints)
                self.point(f"laterals.{k}.to_keypoints", before[vision], points)
            self.gate(vision)
            self.gate(motor)
            vision_above, motor_above = now[vision], now[motor]
        self._read_out(vision_above, motor_above, config.units_per_joint)

    def _read_out(self, vision: Block, motor: Block, units_per_joint: int) -> None:
        self.map(CONVOLUTION, "to_pixels.project", vision, self.pixel_inputs)
        self.map(MATRIX, "to_codes", motor, self.logits)
        self.write(PIXELS, self.pixel_inputs, self.pixels, bias=self.num_weights)
        self.num_weights += self.pixel_inputs.channels * self.pixel_inputs.image
        self.write(CODES, self.logits, self.log_codes, cell=self.codes.offset, bias=self.num_weights, count=units_per_joint)
        self.num_weights += self.logits.channels


def cell_of(name: str) -> str:
    """The submodule that is a layer's cell: "vision1" has "visions.0"."""
    path = name.rstrip("0123456789")
    return name if name == path else f"{path}s.{int(name.removeprefix(path)) - 1}"


def enlarged(indices: Tensor, scale: int) -> Tensor:
    return indices.repeat_interleave(scale, -2).repeat_interleave(scale, -1)
