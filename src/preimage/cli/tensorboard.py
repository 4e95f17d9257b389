"""The scalars of a training for TensorBoard, beside the log of the run, which has them all: `tensorboard --logdir RUN`."""

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

FOLDER = "tensorboard"
"""Within the run folder."""


def validate_tensorboard() -> None:
    """Raises ValueError where TensorBoard is not installed."""
    if find_spec("tensorboard") is None:
        raise ValueError("--tensorboard needs the package tensorboard: pip install 'preimage[tensorboard]', or leave it out")


def scalars_to(run: Path) -> Callable[[Any], None]:
    """A function that adds what there is to report after each update (`method.train.Progress`), from the first that it is given on."""
    writers = []

    def add(told: Any) -> None:
        from torch.utils.tensorboard import SummaryWriter

        if not writers:  # a run that goes on shows no update twice
            writers.append(SummaryWriter(str(run / FOLDER), purge_step=told.update))
        for name in ("visual", "proprioceptive", "seconds"):
            writers[0].add_scalar(name if name == "seconds" else f"error/{name}", getattr(told, name), told.update)
        if told.update == told.updates:
            writers[0].close()

    return add
