"""What may be asked for on the command line: the numbers with which the work can begin."""

import math
from dataclasses import asdict

from preimage.method.plan import PlanConfig
from preimage.method.train import TrainConfig
from preimage.network.config import ModelConfig

LEAST = {
    **dict.fromkeys(("updates", "batch_size", "warmup_updates", "checkpoint_every"), 1),
    **dict.fromkeys(("candidates", "guesses", "horizon", "dimensions", "intention_dimensions", "seen_channels"), 1),
    "blend_parts": 2,
    **dict.fromkeys(("rest_steps", "seed", "iterations", "intention_cost", "doubt", "keypoints", "glance", "start_noise"), 0),
}
MOST = {
    **dict.fromkeys(("updates", "iterations", "checkpoint_every", "warmup_updates"), 10**9),
    **dict.fromkeys(("batch_size", "candidates", "guesses", "horizon", "rest_steps", "blend_parts"), 10**5),
    "seed": 2**32 - 1,
    "intention_dimensions": 10**4,
    "dimensions": 10**4,
    "seen_channels": 1024,
    "keypoints": 1024,
}
"""Whole numbers beyond these are none that the work could end with."""
ABOVE_ZERO = "rate_hz", "learning_rate", "intention_learning_rate", "gradient_norm", "delay_penalty", "probe", "blend_reach"
SHARES = "final_share", "open_loop_share", "later_starts", "blends"


def refuse_out_of_range(config: ModelConfig | TrainConfig | PlanConfig) -> None:
    """Raises ValueError where a number is too small, or none, for the work to begin."""
    given = {name: value for name, value in asdict(config).items() if value is not None}
    for name, value in given.items():
        option = f"--{name.replace('_', '-')}"
        if name in LEAST and not value >= LEAST[name]:
            raise ValueError(f"{option} is {value}: give {LEAST[name]} or more")
        if name in MOST and value > MOST[name]:
            raise ValueError(f"{option} is {value}: give {MOST[name]} or less")
        if name in ABOVE_ZERO and not 0 < value < math.inf:
            raise ValueError(f"{option} is {value}: give a number above 0")
        if name in SHARES and not 0 <= value <= 1:
            raise ValueError(f"{option} is {value}: give a share between 0 and 1")
        if name == "blends" and value == 1:
            raise ValueError(f"{option} is {value}: give less than 1, so that some demonstrations are shown as they are")
