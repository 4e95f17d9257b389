"""What the policy is told."""

from dataclasses import dataclass
from typing import get_args

from lerobot.configs import PreTrainedConfig

from preimage.compute.precision import Precision
from preimage.presets import Preset


@PreTrainedConfig.register_subclass("preimage")
@dataclass
class PreimageConfig(PreTrainedConfig):
    """A trained run, a goal, and how they are used."""

    run: str = ""
    """Run folder of `preimage train`, the name of a bundled model, or hf:OWNER/NAME of the Hugging Face Hub."""
    goal: str = ""
    """Image file, or DATA:EPISODE or DATA:EPISODE:STEP of a data set; without one the observation has to hold `goal_key`."""
    goal_key: str = "observation.images.goal"
    """Key of the goal image in the observation."""
    camera: str = ""
    """Key of the camera in the observation; by default that of the run's recordings, or the only one there is."""
    fps: float = 30.0
    """Calls of `select_action` a second."""
    n_action_steps: int = 1
    """Calls from one look to the next, in whole steps of the run, at least one; 0 goes the whole way blind."""
    preset: str = "full"
    """paper, regression or full: how plans are searched for, as by `preimage plan --as`."""
    iterations: int | None = None
    """Iterations of the error regression; by default those of the preset."""
    precision: str = "auto"
    """bfloat16, float32, or auto: bfloat16 where the device computes it natively, float32 elsewhere."""
    anyway: bool = False
    """Whether to move to a goal that is refused; otherwise the arm holds its joints, and the log says why."""
    save_predicted_video: bool = False
    """Whether `lerobot-eval` writes what was imagined."""

    def validate_features(self) -> None:
        """Raises ValueError where nothing could be planned."""
        if not self.run:
            raise ValueError("the policy has no run: give --policy.run, a folder that `preimage train` wrote or a bundled name")
        if not self.fps > 0:
            raise ValueError(f"--policy.fps is {self.fps}: give the calls of select_action a second, a number above 0")
        if self.n_action_steps < 0:
            raise ValueError(f"--policy.n_action_steps is {self.n_action_steps}: give calls from one look to the next, or 0 to go blind")
        if self.preset not in get_args(Preset):
            raise ValueError(f"--policy.preset is {self.preset}: give {', '.join(get_args(Preset))}")
        if self.precision not in get_args(Precision):
            raise ValueError(f"--policy.precision is {self.precision}: give {', '.join(get_args(Precision))}")

    def get_optimizer_preset(self) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        return None

    def get_scheduler_preset(self) -> None:
        return None

    @property
    def observation_delta_indices(self) -> None:
        return None

    @property
    def action_delta_indices(self) -> None:
        return None

    @property
    def reward_delta_indices(self) -> None:
        return None
