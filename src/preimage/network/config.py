"""How large the network is, and what it sees and feels.

>>> ModelConfig.paper().motor_units
(1024, 1024, 16)
"""

from dataclasses import dataclass
from typing import Self


@dataclass(frozen=True)
class ModelConfig:
    """Sizes of the network and the room of its intention. Frame size, channels and joints come from the data (`Sensors`)."""

    vision_channels: tuple[int, ...] = (16, 32, 32)
    """Feature maps of the vision path, from level 1 up; each level halves height and width (Table I)."""
    motor_units: tuple[int, ...] = (512, 256, 16)
    """LSTM units of the motor path, from level 1 up (Table I)."""
    top_channels: int = 12
    """Feature maps of the shared top (Table I)."""
    units_per_joint: int = 10
    """Units K of the population code of one joint (section II-A)."""
    lateral_channels: int = 4
    """Feature maps that carry the motor path to the vision path; the paper does not say how many."""
    seen_channels: int = 4
    """Feature maps that carry the vision path to the motor path; the paper does not say how many."""
    keypoints: int = 0
    """Points of the feature maps whose places go from vision to the motors besides (spatial softmax, Levine et al. 2016)."""
    intention_layers: tuple[str, ...] = ("top", "vision3", "motor3")
    """Layers whose initial states are the intention; the others start from a learned state that all sequences share."""
    intention_dimensions: int | None = 16
    """Gaussian numbers that make an intention (`LatentTable`); None: the initial states themselves, as in the paper (`FreeTable`)."""
    intention_cost: float = 0.005
    """Charge while training for what an intention tells (a nat), or, where it is free, for its squared size: the walls of its room."""
    intention_noise: float = 0.0
    """Standard deviation of the noise on a free intention while training."""
    rate_hz: float = 2.5
    """Steps a second that the model runs at; recordings are brought to it, slower ones keep their rate."""

    @classmethod
    def tiny(cls) -> Self:
        """For tests: learns nothing worth seeing, in seconds."""
        layers = "top", "vision2", "motor2"
        return cls((6, 8), (12, 8), top_channels=4, lateral_channels=2, seen_channels=2, intention_layers=layers, intention_dimensions=4)

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


def check_sizes(config: ModelConfig, sensors: Sensors) -> None:
    """Raises ValueError where the ladder does not fit the frames, or the intention names a layer that is not there."""
    levels = config.num_levels
    if len(config.motor_units) != levels:
        raise ValueError(f"vision_channels has {levels} levels and motor_units {len(config.motor_units)}: give both the same number")
    if min(config.vision_channels) < config.lateral_channels + 2:
        raise ValueError(f"vision_channels {config.vision_channels} must all be lateral_channels ({config.lateral_channels}) + 2 or more")
    step = 2 ** (levels + 1)
    if sensors.height % step or sensors.width % step:
        raise ValueError(f"frames are {sensors.height}x{sensors.width}; a ladder of {levels} levels needs multiples of {step}")
    known = ["top", *(f"{path}{level}" for path in ("vision", "motor") for level in range(1, levels + 1))]
    unknown = [name for name in config.intention_layers if name not in known]
    if unknown or not config.intention_layers:
        raise ValueError(f"intention_layers names {unknown or 'no layer'}; choose among {', '.join(known)}")
