"""Training with the ideas beyond the paper, and the memory of the demonstrations that is kept beside the weights."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from preimage.network.config import ModelConfig
from preimage.presets.options import TrainOptions
from preimage.storage.run_files import HELD_OUT, MEMORY

if TYPE_CHECKING:
    from preimage.compute.processes import ProcessGroup
    from preimage.ideas.memory import DemonstrationMemory
    from preimage.network.pdvmrnn import PDVMRNN
    from preimage.records import Demonstration


def train(
    demonstrations: "Sequence[Demonstration]",
    model_config: ModelConfig | None = None,
    *,
    config: TrainOptions | None = None,
    folder: Path | str | None = None,
    held_out: "Sequence[Demonstration]" = (),
    group: "ProcessGroup | None" = None,
    **more: Any,
) -> "PDVMRNN":
    """Learn weights and intentions that regenerate the demonstrations (`method.train.train`); their memory is kept in the run folder,
    anew at every checkpoint.

    Args:
        config: how the network learns, with the ideas beyond the paper.
        held_out: episodes whose errors are kept in the run folder at every checkpoint; nothing is learned from them.
        more: as `method.train.train` takes it.
    """
    from preimage.compute.processes import ProcessGroup
    from preimage.method.train import train as train_by_the_paper
    from preimage.storage.checkpoints import append_to_log
    from preimage.storage.networks import write_tensors

    config, group = config or TrainOptions(), group or ProcessGroup()

    def keep_memory(model: "PDVMRNN") -> None:
        if folder is not None and group.first:
            write_tensors(Path(folder) / MEMORY, remember(demonstrations, model).tensors())

    def at_checkpoint(model: "PDVMRNN", update: int) -> None:
        keep_memory(model)
        if held_out:
            look_at_held_out(model, update)

    def look_at_held_out(model: "PDVMRNN", update: int) -> None:
        from preimage.ideas.held_out_error import held_out_error

        began = time.perf_counter()
        error = held_out_error(model, held_out, precision=config.precision)
        line = {"update": update} | error | {"seconds": time.perf_counter() - began}
        append_to_log(Path(folder or ""), line, name=HELD_OUT)

    more |= {"augmentations": config.augmentations(), "at_checkpoint": at_checkpoint}
    model = train_by_the_paper(demonstrations, model_config, config=config, folder=folder, group=group, **more)
    keep_memory(model)  # a run that was killed after its last checkpoint, and goes on, has no other
    return model


def remember(demonstrations: "Sequence[Demonstration]", model: "PDVMRNN") -> "DemonstrationMemory":
    """The memory of the demonstrations that a network was trained on, for `Planner`."""
    from preimage.data.sequences import pad
    from preimage.ideas.memory import DemonstrationMemory

    return DemonstrationMemory.of(pad(demonstrations, rate_hz=model.config.rate_hz), model.coding)
