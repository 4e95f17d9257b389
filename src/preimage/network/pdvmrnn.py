"""The P-DVMRNN: two ladders of recurrent layers, one for vision and one for the motors, that meet in a shared top.

What the network generates is decided by what it starts from: its *intention state*, the initial states of chosen layers, and the first
percept that is observed. One step goes from the top down. The top moves first, then level 3, 2 and 1 of both ladders; each layer hears
itself, the layer below and its counterpart as they were one step before, and the layer above as it is now; the lowest level then
predicts a frame and the joint codes. Fed with its own predictions the network imagines (closed loop); fed with what is sensed it
predicts one step ahead (open loop).

Steps are counted as the percepts are: output t is the prediction of percept t. Its input is percept t-1, imagined or sensed, and
percept 1 for t = 1, since the robot rests before it starts.

>>> import torch
>>> model = PDVMRNN(ModelConfig.tiny(), Sensors(16, 16, 1, ("a", "b"), (-1.0, -1.0), (1.0, 1.0)))
>>> start = torch.zeros(3, 1, 16, 16), torch.full((3, 2, 10), 0.1)
>>> imagined = model.generate_closed_loop(model.intention_table.prior_mean(3), start, num_steps=4)
>>> imagined.pixels.shape, imagined.log_codes.shape
(torch.Size([3, 4, 1, 16, 16]), torch.Size([3, 4, 2, 10]))
"""

# pyright: reportCallIssue=false, reportArgumentType=false
# What a ModuleList holds, and how long the shape of a layer is, its types do not tell.

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import torch
from jaxtyping import Float
from torch import Tensor, nn

from preimage.compute.devices import Recorded
from preimage.network import engines
from preimage.network.cells import LSTM, ConvLSTM, Down, Lateral, State, Up
from preimage.network.coding import JointCoding
from preimage.network.config import ModelConfig, Sensors, check_sizes
from preimage.network.intention import FreeTable, IntentionState, IntentionTable, LatentTable, unflatten
from preimage.network.linear import Linear

Inputs = tuple[Float[Tensor, "B C H W"], Float[Tensor, "B J K"]]
"""What enters the lowest level at one step: pixels in [-1, 1] and joint codes."""
Sensed = tuple[Float[Tensor, "C H W"], Float[Tensor, "J K"]]
"""One percept as the network takes it, without a batch."""
InputSequence = tuple[Float[Tensor, "B T C H W"], Float[Tensor, "B T J K"]]
"""The same for all steps of sequences."""
NetworkStep = Callable[[Inputs, Mapping[str, State]], tuple[Inputs, dict[str, State]]]
"""From inputs and the states before to the predicted pixels and log codes, and the states after."""


@dataclass(frozen=True, eq=False)
class Generated:
    """Predicted percepts of B sequences and T steps."""

    pixels: Float[Tensor, "B T C H W"]
    log_codes: Float[Tensor, "B T J K"]

    def __getitem__(self, rows: Tensor) -> "Generated":
        return Generated(self.pixels[rows], self.log_codes[rows])


class PDVMRNN(nn.Module):
    """Predictive-coding deep visuomotor recurrent neural network (section II-A, figure 1, Table I).

    Args:
        config: sizes of the network.
        sensors: frame size and joints, as they are in the data.
        num_sequences: rows of the intention table, one per training demonstration.
        seed: draws the first weights.
    """

    home_pixels: Float[Tensor, "C H W"]
    """Mean first frame of the demonstrations."""
    home_joints: Float[Tensor, " J"]
    """Mean first joint angles of the demonstrations (rad)."""
    longest: Tensor
    """Steps of the longest demonstration: how far ahead is imagined unless something else is asked for."""
    shortest: Tensor
    """Steps of the shortest demonstration."""
    intention_table: IntentionTable

    def __init__(self, config: ModelConfig, sensors: Sensors, num_sequences: int = 1, seed: int = 0) -> None:
        super().__init__()
        self.config, self.sensors = config, sensors
        self._recorded: dict[tuple[int, int, torch.dtype], Recorded] = {}
        check_sizes(config, sensors)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self._build(num_sequences)
        generator = torch.Generator().manual_seed(seed)
        shapes = {name: self.state_shapes[name] for name in config.intention_layers or self.state_shapes}
        if config.intention == "free":
            self.intention_table = FreeTable(shapes, num_sequences=num_sequences, noise=config.intention_noise, generator=generator)
        else:
            self.intention_table = LatentTable(
                shapes, num_sequences=num_sequences, dimensions=config.intention_dimensions, generator=generator
            )

    def _build(self, num_sequences: int) -> None:
        config, sensors, shapes = self.config, self.sensors, self.state_shapes
        vision, motor, top, lateral = config.vision_channels, config.motor_units, config.top_channels, config.lateral_channels
        grid, top_size = shapes[f"vision{config.num_levels}"][1:], shapes["top"][1:]
        features = config.seen_channels * grid[0] * grid[1] + 2 * config.keypoints
        self.coding = JointCoding(torch.tensor(sensors.joint_lower), torch.tensor(sensors.joint_upper), config.units_per_joint)
        num_codes = sensors.num_joints * config.units_per_joint

        # What flows into a layer from around it has together as many maps as the layer itself.
        flow = [(channels - lateral) // 2 for channels in vision]
        self.ups = nn.ModuleList(Up(low, into) for low, into in zip((sensors.channels, *vision), (*flow, top), strict=True))
        self.downs = nn.ModuleList(Down(high, into) for into, high in zip(flow, (*vision[1:], top), strict=True))
        self.laterals = nn.ModuleList(
            Lateral(
                channels=c,
                units=u,
                size=shapes[f"vision{level}"][1:],
                grid=grid,
                lateral=lateral,
                seen=config.seen_channels,
                keypoints=config.keypoints,
            )
            for level, (c, u) in enumerate(zip(vision, motor, strict=True), start=1)
        )
        self.motor_to_top = Linear(motor[-1], lateral * top_size[0] * top_size[1])
        self.visions = nn.ModuleList(ConvLSTM(2 * into + lateral, channels) for into, channels in zip(flow, vision, strict=True))
        below = (num_codes, *motor[:-1])
        above = (*motor[1:], top * top_size[0] * top_size[1])
        self.motors = nn.ModuleList(LSTM(b + a + features, u) for b, a, u in zip(below, above, motor, strict=True))
        self.top = ConvLSTM(top + lateral, top)
        self.to_pixels = Down(vision[0], sensors.channels)
        self.to_codes = Linear(motor[0], num_codes)
        self.pixel_bias = nn.Parameter(torch.zeros(sensors.channels, sensors.height, sensors.width))
        self.code_bias = nn.Parameter(torch.zeros(sensors.num_joints, config.units_per_joint))
        self.shared = nn.ParameterDict({name: nn.Parameter(torch.zeros(2, *shape)) for name, shape in shapes.items()})
        self.register_buffer("home_pixels", torch.zeros(sensors.channels, sensors.height, sensors.width))
        self.register_buffer("home_joints", torch.zeros(sensors.num_joints))
        self.register_buffer("longest", torch.tensor(0.0))
        self.register_buffer("shortest", torch.tensor(0.0))

    @property
    def state_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each layer's hidden state, without the batch, from level 1 up."""
        levels = range(1, self.config.num_levels + 1)
        height, width = self.sensors.height, self.sensors.width
        shapes: dict[str, tuple[int, ...]] = {}
        for level in levels:
            shapes[f"vision{level}"] = (self.config.vision_channels[level - 1], height >> level, width >> level)
            shapes[f"motor{level}"] = (self.config.motor_units[level - 1],)
        above = self.config.num_levels + 1
        return shapes | {"top": (self.config.top_channels, height >> above, width >> above)}

    @torch.no_grad()
    def start_from_means(self, pixels: Float[Tensor, "C H W"], codes: Float[Tensor, "J K"]) -> None:
        """Let the untrained network predict the mean frame and the mean codes, so that learning need not spend itself on them."""
        self.pixel_bias.copy_(torch.atanh(pixels.clamp(-0.97, 0.97)))
        self.code_bias.copy_((codes + 1e-3).log())

    def initial_states(self, intention: IntentionState) -> dict[str, State]:
        """The state before the first step: h = tanh(shared + intention), c = shared + intention."""
        states = {}
        for name, shared in self.shared.items():
            values = shared + intention.layers[name] if name in intention.layers else shared.expand(len(intention), *shared.shape)
            hidden, cell = (in_channels_last(values[:, part]) for part in (0, 1))
            states[name] = torch.tanh(hidden), cell
        return states

    def at(self, dtype: torch.dtype, num_steps: int = 1) -> NetworkStep:
        """One step of the network in this precision, from the top down, for so many steps of one sequence.

        Cell states, predicted pixels and log codes keep the precision of the weights.
        """
        levels = self.config.num_levels
        top, to_pixels, to_codes, motor_to_top = (
            part.at(dtype, num_steps) for part in (self.top, self.to_pixels, self.to_codes, self.motor_to_top)
        )
        ups, downs, visions, motors = (
            [part.at(dtype, num_steps) for part in parts] for parts in (self.ups, self.downs, self.visions, self.motors)
        )
        to_vision, to_motor = (
            [direction(tie, dtype, num_steps) for tie in self.laterals] for direction in (Lateral.to_vision, Lateral.to_motor)
        )
        top_size = self.state_shapes["top"][1:]

        def read_out(vision: Tensor, motor: Tensor) -> Inputs:
            pixels = torch.tanh(to_pixels(vision).to(self.pixel_bias.dtype) + self.pixel_bias)
            logits = to_codes(motor).to(self.code_bias.dtype).unflatten(1, self.code_bias.shape) + self.code_bias
            return pixels, torch.log_softmax(logits, dim=-1)

        def step(inputs: Inputs, states: Mapping[str, State]) -> tuple[Inputs, dict[str, State]]:
            pixels, codes = inputs
            before = {name: hidden.to(dtype) for name, (hidden, _) in states.items()}
            now = {name: (before[name], cell) for name, (_, cell) in states.items()}
            below_vision = [pixels.to(dtype), *(before[f"vision{level}"] for level in range(1, levels + 1))]
            below_motor = [codes.to(dtype).flatten(1), *(before[f"motor{level}"] for level in range(1, levels + 1))]

            from_motor = motor_to_top(below_motor[-1]).unflatten(1, (*top_size, -1)).permute(0, 3, 1, 2)  # (B, lateral, height, width)
            now["top"] = top([ups[-1](below_vision[-1]), from_motor], now["top"])
            vision_above = now["top"][0]
            motor_above = vision_above.flatten(1)
            for level in range(levels, 0, -1):
                vision, motor, k = f"vision{level}", f"motor{level}", level - 1
                around = [ups[k](below_vision[k]), downs[k](vision_above), to_vision[k](before[motor])]
                beside = to_motor[k](before[vision])
                now[vision] = visions[k](around, now[vision])
                now[motor] = motors[k]([below_motor[k], motor_above, beside], now[motor])
                vision_above, motor_above = now[vision][0], now[motor][0]
            return read_out(vision_above, motor_above), now

        return step

    def generate_closed_loop(
        self, intention: IntentionState, start: Inputs, *, num_steps: int, dtype: torch.dtype | None = None
    ) -> Generated:
        """Imagine `num_steps` percepts: each prediction is the next step's input; the observed start percept is the first.

        Args:
            dtype: precision of the layers' arithmetic, at least; by default that of the weights.
        """
        dtype = dtype or self.pixel_bias.dtype
        if self.pixel_bias.is_cuda and not torch.is_grad_enabled():
            return self._replay_closed_loop(intention, start, num_steps, dtype)
        return self._generate(intention, start, num_steps, imagined, dtype)

    def _replay_closed_loop(self, intention: IntentionState, start: Inputs, num_steps: int, dtype: torch.dtype) -> Generated:
        """The same on a GPU, recorded at the first call for so many sequences, up to the next power of two."""
        count = len(intention)
        room = 1 << (count - 1).bit_length()
        rows = torch.arange(room, device=self.pixel_bias.device).clamp(max=count - 1)
        inputs = [part[rows] for part in (intention.flatten(), *start)]
        shapes = {name: self.state_shapes[name] for name in intention.layers}

        def work(intentions: Tensor, pixels: Tensor, codes: Tensor) -> tuple[Tensor, Tensor]:
            begun = unflatten(intentions, shapes), (pixels, codes)
            generated = self._generate(*begun, num_steps, imagined, dtype)
            return generated.pixels, generated.log_codes

        key = room, num_steps, dtype
        if key not in self._recorded:
            self._recorded[key] = Recorded(work, inputs)
        return Generated(*(each[:count] for each in self._recorded[key](*inputs)))

    def _apply(self, *how: Any, **more: Any) -> Self:
        self._recorded.clear()  # it reads the weights where they were
        return super()._apply(*how, **more)

    def generate_open_loop(
        self,
        intention: IntentionState,
        percepts: InputSequence,
        *,
        dtype: torch.dtype | None = None,
    ) -> Generated:
        """Predict every percept (B, T, ...) from the sensed one before it.

        Args:
            percepts: sensed pixels (B, T, C, H, W) and codes (B, T, J, K).
            dtype: precision of the layers' arithmetic, at least; by default that of the weights.
        """
        pixels, codes = percepts  # the first of them is the first input, for the robot rests before it starts
        start = pixels[:, 0], codes[:, 0]
        return self._generate(intention, start, pixels.shape[1], lambda step, _: (pixels[:, step], codes[:, step]), dtype)

    def _generate(
        self, intention: IntentionState, start: Inputs, num_steps: int, feed: Callable[[int, Inputs], Inputs], dtype: torch.dtype | None
    ) -> Generated:
        states, inputs = self.initial_states(intention), start
        for engine in engines.ENGINES if feed is imagined else ():
            predicted = engine(self, states, start, num_steps, dtype)
            if predicted is not None:
                return Generated(*predicted)
        forward = self.at(dtype or self.pixel_bias.dtype, num_steps)
        all_pixels, all_log_codes = [], []
        for step in range(num_steps):
            (pixels, log_codes), states = forward(inputs, states)
            all_pixels.append(pixels)
            all_log_codes.append(log_codes)
            inputs = feed(step, (pixels, log_codes.exp()))
        return Generated(torch.stack(all_pixels, 1), torch.stack(all_log_codes, 1))


def imagined(step: int, predicted: Inputs) -> Inputs:
    """What enters next in closed loop."""
    return predicted


def in_channels_last(values: Tensor) -> Tensor:
    return values.contiguous(memory_format=torch.channels_last) if values.dim() == 4 else values
