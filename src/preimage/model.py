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
>>> imagined = model.generate_closed_loop(model.prior_mean(3), start, num_steps=4)
>>> imagined.pixels.shape, imagined.log_codes.shape
(torch.Size([3, 4, 1, 16, 16]), torch.Size([3, 4, 2, 10]))
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Self

import torch
from jaxtyping import Float
from torch import Tensor, nn

from preimage.cells import LSTM, ConvLSTM, State
from preimage.coding import JointCoding

Inputs = tuple[Float[Tensor, "B C H W"], Float[Tensor, "B J K"]]
"""What enters the lowest level at one step: pixels in [-1, 1] and joint codes."""


@dataclass(frozen=True)
class ModelConfig:
    """Sizes of the network and the room of its intention. Frame size, channels and joints come from the data (`Sensors`)."""

    vision_channels: tuple[int, ...] = (16, 32, 32)
    """Feature maps of the vision path, from level 1 up; each level halves height and width (Table I)."""
    motor_units: tuple[int, ...] = (256, 128, 16)
    """LSTM units of the motor path, from level 1 up (Table I)."""
    top_channels: int = 12
    """Feature maps of the shared top (Table I)."""
    units_per_joint: int = 10
    """Units K of the population code of one joint (section II-A)."""
    lateral_channels: int = 4
    """Feature maps that carry one path to its counterpart; the paper does not say how many."""
    intention_layers: tuple[str, ...] = ("top", "vision3", "motor3")
    """Layers whose initial states are the intention; the others start from a learned state that all sequences share."""
    intention_noise: float = 0.0
    """Standard deviation of the Gaussian noise on the intention while training: more noise, less room."""
    intention_cost: float = 1e-4
    """Charge for the squared size of an intention while training: the other wall of the room."""
    rate_hz: float = 5.0
    """Steps a second that the model runs at; recordings are brought to it."""

    @classmethod
    def tiny(cls) -> Self:
        """For tests: learns nothing worth seeing, in seconds."""
        return cls(vision_channels=(4, 6), motor_units=(12, 8), top_channels=4, intention_layers=("top", "vision2", "motor2"))

    @classmethod
    def small(cls) -> Self:
        """For two cores and minutes."""
        return cls()

    @classmethod
    def paper(cls) -> Self:
        """Table I of the paper."""
        return cls(vision_channels=(40, 80, 80), motor_units=(1024, 1024, 16))

    @property
    def num_levels(self) -> int:
        return len(self.vision_channels)


@dataclass(frozen=True)
class Sensors:
    """What the network sees and feels: the size of a frame, and the joints with their limits (rad)."""

    height: int
    width: int
    channels: int
    joint_names: tuple[str, ...]
    joint_lower: tuple[float, ...]
    joint_upper: tuple[float, ...]

    @property
    def num_joints(self) -> int:
        return len(self.joint_names)


@dataclass(frozen=True, eq=False)
class IntentionState:
    """Intentions of B sequences: per chosen layer what is added to its shared initial state, (B, 2, *layer), h first, then c."""

    layers: Mapping[str, Tensor]

    def __len__(self) -> int:
        return len(next(iter(self.layers.values())))

    def __getitem__(self, rows: Tensor) -> "IntentionState":
        return IntentionState({name: values[rows] for name, values in self.layers.items()})

    def map(self, function: Callable[[Tensor], Tensor]) -> "IntentionState":
        """The same function applied to the values of every layer."""
        return IntentionState({name: function(values) for name, values in self.layers.items()})

    def flatten(self) -> Float[Tensor, "B D"]:
        """One row a sequence, the layers side by side."""
        return torch.cat([values.flatten(1) for values in self.layers.values()], dim=1)

    def unflatten(self, rows: Float[Tensor, "N D"]) -> "IntentionState":
        """Rows laid out as `flatten` does, back in the shapes of this intention's layers."""
        sizes = [values[0].numel() for values in self.layers.values()]
        parts = zip(self.layers.items(), rows.split(sizes, dim=1), strict=True)
        return IntentionState({name: part.unflatten(1, values.shape[1:]) for (name, values), part in parts})


class IntentionTable(nn.Module):
    """One intention per training demonstration, learned with the weights."""

    def __init__(self, shapes: Mapping[str, tuple[int, ...]], num_sequences: int, generator: torch.Generator) -> None:
        super().__init__()
        draw = {name: 0.1 * torch.randn(num_sequences, 2, *shape, generator=generator) for name, shape in shapes.items()}
        self.rows = nn.ParameterDict({name: nn.Parameter(values) for name, values in draw.items()})

    def intentions(self) -> IntentionState:
        return IntentionState(dict(self.rows.items()))


@dataclass(frozen=True, eq=False)
class Generated:
    """Predicted percepts of B sequences and T steps."""

    pixels: Float[Tensor, "B T C H W"]
    log_codes: Float[Tensor, "B T J K"]


class Lateral(nn.Module):
    """The tie between the two paths at one level, through a few feature maps on a coarse grid."""

    def __init__(self, *, channels: int, units: int, size: tuple[int, int], grid: tuple[int, int], lateral: int) -> None:
        super().__init__()
        self.grid, self.size, self.lateral = grid, size, lateral
        self.features = lateral * grid[0] * grid[1]
        self.from_motor = nn.Linear(units, self.features)
        self.from_vision = nn.Conv2d(channels, lateral, 1)

    def to_vision(self, hidden: Float[Tensor, "B units"]) -> Float[Tensor, "B lateral height width"]:
        coarse = self.from_motor(hidden).unflatten(1, (self.lateral, *self.grid))
        return coarse if self.size == self.grid else nn.functional.interpolate(coarse, size=self.size, mode="nearest")

    def to_motor(self, hidden: Float[Tensor, "B channels height width"]) -> Float[Tensor, "B features"]:
        return nn.functional.adaptive_avg_pool2d(self.from_vision(hidden), self.grid).flatten(1)


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

    def __init__(self, config: ModelConfig, sensors: Sensors, num_sequences: int = 1, seed: int = 0) -> None:
        super().__init__()
        self.config, self.sensors = config, sensors
        check_sizes(config, sensors)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self._build()
        generator = torch.Generator().manual_seed(seed)
        shapes = {name: self.state_shapes[name] for name in config.intention_layers}
        self.intention_table = IntentionTable(shapes, num_sequences, generator)

    def _build(self) -> None:
        config, sensors, shapes = self.config, self.sensors, self.state_shapes
        vision, motor, top = config.vision_channels, config.motor_units, config.top_channels
        grid = shapes[f"vision{config.num_levels}"][1:]
        top_size = shapes["top"][1:]
        lateral = config.lateral_channels
        self.coding = JointCoding(torch.tensor(sensors.joint_lower), torch.tensor(sensors.joint_upper), config.units_per_joint)
        num_codes = sensors.num_joints * config.units_per_joint

        def up(below: int, above: int) -> nn.Module:
            return nn.Conv2d(below, above, kernel_size=4, stride=2, padding=1)

        def down(above: int, below: int) -> nn.Module:
            return nn.ConvTranspose2d(above, below, kernel_size=4, stride=2, padding=1)

        self.ups = nn.ModuleList([up(low, high) for low, high in zip((sensors.channels, *vision), (*vision, top), strict=True)])
        self.downs = nn.ModuleList([down(high, low) for low, high in zip(vision, (*vision[1:], top), strict=True)])
        self.laterals = nn.ModuleList(
            [
                Lateral(channels=c, units=u, size=shapes[f"vision{level}"][1:], grid=grid, lateral=lateral)
                for level, (c, u) in enumerate(zip(vision, motor, strict=True), start=1)
            ]
        )
        features = lateral * grid[0] * grid[1]
        self.motor_to_top = nn.Linear(motor[-1], lateral * top_size[0] * top_size[1])
        self.visions = nn.ModuleList([ConvLSTM(2 * channels + lateral, channels) for channels in vision])
        below = (num_codes, *motor[:-1])
        above = (*motor[1:], top * top_size[0] * top_size[1])
        self.motors = nn.ModuleList([LSTM(b + a + features, u) for b, a, u in zip(below, above, motor, strict=True)])
        self.top = ConvLSTM(top + lateral, top)
        self.to_pixels = down(vision[0], sensors.channels)
        self.to_codes = nn.Linear(motor[0], num_codes)
        self.pixel_bias = nn.Parameter(torch.zeros(sensors.channels, sensors.height, sensors.width))
        self.code_bias = nn.Parameter(torch.zeros(sensors.num_joints, config.units_per_joint))
        self.shared = nn.ParameterDict({name: nn.Parameter(torch.zeros(2, *shape)) for name, shape in shapes.items()})
        self.register_buffer("home_pixels", torch.zeros(sensors.channels, sensors.height, sensors.width))
        self.register_buffer("home_joints", torch.zeros(sensors.num_joints))
        self.register_buffer("longest", torch.tensor(0.0))
        for module in self.modules():
            if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
                module.to(memory_format=torch.channels_last)  # about twice as fast on a CPU

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

    def prior_mean(self, num_sequences: int) -> IntentionState:
        """The intention that adds nothing to the shared initial states."""
        return self.intention_table.intentions().map(lambda rows: rows.new_zeros(num_sequences, *rows.shape[1:]))

    def initial_states(self, intention: IntentionState) -> dict[str, State]:
        """The state before the first step: h = tanh(shared + intention), c = shared + intention."""
        states = {}
        for name, shared in self.shared.items():
            values = shared + intention.layers[name] if name in intention.layers else shared.expand(len(intention), *shared.shape)
            states[name] = torch.tanh(values[:, 0]), values[:, 1]
        return states

    def step(self, inputs: Inputs, states: Mapping[str, State]) -> tuple[Inputs, dict[str, State]]:
        """One step, from the top down.

        Returns:
            the predicted pixels (B, C, H, W) and log codes (B, J, K), and the new state of every layer.
        """
        pixels, codes = inputs
        levels = self.config.num_levels
        before = {name: hidden for name, (hidden, _) in states.items()}
        below_vision = [pixels, *(before[f"vision{level}"] for level in range(1, levels + 1))]
        below_motor = [codes.flatten(1), *(before[f"motor{level}"] for level in range(1, levels + 1))]

        to_top = self.motor_to_top(below_motor[-1]).unflatten(1, (-1, *self.state_shapes["top"][1:]))
        now = {"top": self.top([self.ups[-1](below_vision[-1]), to_top], states["top"])}
        vision_above = now["top"][0]
        motor_above = vision_above.flatten(1)
        for level in range(levels, 0, -1):
            vision, motor, k = f"vision{level}", f"motor{level}", level - 1
            from_motor = self.laterals[k].to_vision(before[motor])
            from_vision = self.laterals[k].to_motor(before[vision])
            around = [self.ups[k](below_vision[k]), self.downs[k](vision_above), from_motor]
            now[vision] = self.visions[k](around, states[vision])
            now[motor] = self.motors[k]([below_motor[k], motor_above, from_vision], states[motor])
            vision_above, motor_above = now[vision][0], now[motor][0]
        return self.read_out(vision_above, motor_above), now

    def read_out(self, vision: Tensor, motor: Tensor) -> Inputs:
        """Pixels and log codes from the hidden states of level 1; float32 or wider whatever the precision of the layers."""
        pixels = torch.tanh(self.to_pixels(vision).to(self.pixel_bias.dtype) + self.pixel_bias)
        logits = self.to_codes(motor).to(self.code_bias.dtype).unflatten(1, self.code_bias.shape) + self.code_bias
        return pixels, torch.log_softmax(logits, dim=-1)

    def generate_closed_loop(self, intention: IntentionState, start: Inputs, *, num_steps: int) -> Generated:
        """Imagine `num_steps` percepts: each prediction is the next step's input; the observed start percept is the first."""
        return self._generate(intention, start, num_steps, lambda step, predicted: predicted)

    def generate_open_loop(self, intention: IntentionState, percepts: Inputs, *, share: float = 1.0) -> Generated:
        """Predict every percept (B, T, ...) from the sensed one before it.

        Args:
            percepts: sensed pixels (B, T, C, H, W) and codes (B, T, J, K).
            share: how much of the input is sensed, the rest is the network's own prediction; 0 is the closed loop.
        """
        pixels, codes = percepts

        def mix(step: int, predicted: Inputs) -> Inputs:
            return share * pixels[:, step] + (1 - share) * predicted[0], share * codes[:, step] + (1 - share) * predicted[1]

        return self._generate(intention, (pixels[:, 0], codes[:, 0]), pixels.shape[1], mix)

    def _generate(self, intention: IntentionState, start: Inputs, num_steps: int, feed: Callable[[int, Inputs], Inputs]) -> Generated:
        states, inputs = self.initial_states(intention), start
        all_pixels, all_log_codes = [], []
        for step in range(num_steps):
            (pixels, log_codes), states = self.step(inputs, states)
            all_pixels.append(pixels)
            all_log_codes.append(log_codes)
            inputs = feed(step, (pixels, log_codes.exp()))
        return Generated(torch.stack(all_pixels, 1), torch.stack(all_log_codes, 1))


def check_sizes(config: ModelConfig, sensors: Sensors) -> None:
    """Raises ValueError where the ladder does not fit the frames, or the intention names a layer that is not there."""
    levels = config.num_levels
    if len(config.motor_units) != levels:
        raise ValueError(f"vision_channels has {levels} levels and motor_units {len(config.motor_units)}: give both the same number")
    step = 2 ** (levels + 1)
    if sensors.height % step or sensors.width % step:
        raise ValueError(f"frames are {sensors.height}x{sensors.width}; a ladder of {levels} levels needs multiples of {step}")
    known = ["top", *(f"{path}{level}" for path in ("vision", "motor") for level in range(1, levels + 1))]
    unknown = [name for name in config.intention_layers if name not in known]
    if unknown or not config.intention_layers:
        raise ValueError(f"intention_layers names {unknown or 'no layer'}; choose among {', '.join(known)}")
