"""How large the network is, and what it sees and feels.

>>> ModelConfig.paper().motor_units
(1024, 1024, 16)
"""

from dataclasses import dataclass, replace
from typing import Literal, Self

from preimage.network.ranges import validate


@dataclass(frozen=True)
class ModelConfig:
    """Sizes of the network and the capacity of its intention. Frame size, channels and joints come from the data (`Sensors`)."""

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
    intention: Literal["latent", "free"] = "latent"
    """latent: a few Gaussian numbers make an intention (`LatentTable`); free: the initial states themselves, as in the paper."""
    intention_layers: tuple[str, ...] | None = ("top", "vision3", "motor3")
    """Layers whose initial states are the intention, None: all; the others start from a learned state that all sequences share."""
    intention_dimensions: int = 16
    """Gaussian numbers of a latent intention."""
    intention_cost: float = 0.005
    """Charge while training for the information in an intention (a nat), or, where it is free, for its squared size."""
    intention_noise: float = 0.0
    """Standard deviation of the noise on a free intention while training, in those of the training intentions."""
    rate_hz: float = 2.5
    """Steps a second that the model runs at; recordings are brought to it, slower ones keep their rate."""

    def __post_init__(self) -> None:
        at_least = {"intention_dimensions": 1, "seen_channels": 1, "intention_cost": 0, "intention_noise": 0, "keypoints": 0}
        validate(self, at_least=at_least, held=("intention_dimensions", "seen_channels", "keypoints"), rates=("rate_hz",))

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
    def table_1(cls) -> Self:
        """The sizes of the paper's Table I."""
        return cls(vision_channels=(40, 80, 80), motor_units=(1024, 1024, 16))

    @classmethod
    def paper(cls) -> Self:
        """The paper's network: Table I, free initial states, one set a sequence, at 10 Hz."""
        return replace(cls.table_1().as_paper(), rate_hz=10.0)

    def as_paper(self) -> Self:
        """A network of this size with the paper's intention: free initial states of the top and the highest level of both paths.

        With those of all layers, what is found shows the goal as well, and its joints are further off (docs/log.md).
        """
        layers = "top", f"vision{self.num_levels}", f"motor{self.num_levels}"
        return replace(self, intention="free", intention_layers=layers, intention_cost=1e-4, intention_noise=0.2, keypoints=0)

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
    unknown = [name for name in config.intention_layers or () if name not in known]
    if unknown or config.intention_layers == ():
        raise ValueError(f"intention_layers names {unknown or 'no layer'}; choose among {', '.join(known)}")
