"""Training: back-propagation through time on the weights and the intention table together (section II-B).

Every update draws a few demonstrations, generates each from its own intention in closed loop, and lowers the prediction error of both
modalities (equation 1) by Adam. What an update draws depends on the seed and its number alone, so that a training that was stopped and
resumed gives the same weights, bit for bit on a CPU, as one that never stopped, and several processes those of one, to rounding
(docs/many_machines.md).
"""

import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch
from torch import nn

from preimage.compute.freed_memory import keep_freed_memory
from preimage.compute.interrupts import saved_on_interrupt
from preimage.compute.precision import resolve_precision
from preimage.compute.processes import ProcessGroup
from preimage.data.sequences import Sequences, pad, sensors_of
from preimage.method.batches import batch_of, error_of, plain_batch
from preimage.method.config import TrainConfig
from preimage.method.initialisation import start_from_demonstrations
from preimage.method.learner import Learner, Progress, optimiser_of, share_of_rate, validate_finite
from preimage.method.prediction_error import SequenceError
from preimage.method.seam import Augmentation
from preimage.network.config import ModelConfig
from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Demonstration
from preimage.storage.checkpoints import append_to_log, open_run, save_checkpoint


def train(
    demonstrations: Sequence[Demonstration],
    model_config: ModelConfig | None = None,
    *,
    config: TrainConfig | None = None,
    folder: Path | str | None = None,
    resume: bool = False,
    about: dict[str, Any] | None = None,
    progress: Callable[[Progress], None] | None = None,
    at_checkpoint: Callable[[PDVMRNN, int], None] | None = None,
    augmentations: Sequence[Augmentation] = (),
    group: ProcessGroup = ProcessGroup(),  # noqa: B008, frozen
) -> PDVMRNN:
    """Learn weights and intentions that regenerate the demonstrations.

    Args:
        demonstrations: the sequences to learn; frames of one size, the same joints.
        folder: run folder for checkpoints and log; without one nothing is written.
        resume: go on from the folder's last checkpoint, or from the beginning where it has none yet.
        about: more to write into the run's config.json.
        progress: called after every update.
        at_checkpoint: called after every checkpoint, with the network as it is and the number of the update.
        augmentations: what is made of every batch before it is generated; by the paper nothing.
        group: the processes that train together, of which only the first writes and reports.

    Returns:
        the trained network, its weights frozen.

    Raises:
        ValueError: the demonstrations do not fit together or are too few for the group, the folder holds a run already or none to resume,
            or is to be resumed and there is none.
        NonFinite: an error or a gradient is no longer finite.
        ProcessLost: another process of the group is no longer there.
        KeyboardInterrupt: the training was interrupted; the last update is saved.
    """
    model_config, config = model_config or ModelConfig.small(), config or TrainConfig()
    if resume and folder is None:
        raise ValueError("resume goes on with the run in a folder, and no folder is given")
    config = replace(config, precision=resolve_precision(config.precision, group.device))  # a resumed run goes on as it began
    model_config = replace(model_config, rate_hz=min([model_config.rate_hz, *(one.rate_hz for one in demonstrations)]))
    sequences = pad(demonstrations, rate_hz=model_config.rate_hz, rest_steps=config.rest_steps)
    model = PDVMRNN(model_config, sensors_of(demonstrations), len(sequences), config.seed)
    group.validate_share(min(config.batch_size, len(sequences)))
    start_from_demonstrations(model, sequences)
    learner = Learner(model.to(group.device), optimiser_of(model, config), augmentations=augmentations)
    keep_freed_memory()
    kept = {"settings": asdict(config), "about": about or {}, "resume": resume}
    opened = open_run(Path(folder), learner, demonstrations, **kept) if folder is not None and group.first else nullcontext()
    with opened as run, saved_on_interrupt() as interrupted:
        if group.size > 1:  # a checkpoint may lie where the others cannot see it, and another machine may round otherwise
            learner.load(group.broadcast(learner.state()))
        stop = False
        while learner.update < config.updates and not stop:
            done = one_update(learner, sequences, config, run, group)
            if progress and group.first:
                progress(done)
            stop = group.any(interrupted())
            if run and (learner.update % config.checkpoint_every == 0 or learner.update == config.updates or stop):
                save_checkpoint(run, learner)
                if at_checkpoint:
                    at_checkpoint(model, learner.update)
        group.any(stop)  # all wait until the last checkpoint is written
    if stop:
        raise KeyboardInterrupt
    return model.requires_grad_(False).eval()


def one_update(learner: Learner, sequences: Sequences, config: TrainConfig, run: Path | None, group: ProcessGroup) -> Progress:
    """One step of Adam on one batch, of which this process generates its share."""
    began = time.perf_counter()
    model, optimiser = learner.model, learner.optimiser
    generator = torch.Generator().manual_seed(config.seed * 1_000_003 + learner.update)
    batch = plain_batch(batch_of(learner.update, len(sequences), config), sequences)
    for augment in learner.augmentations:
        batch = augment(batch, sequences, generator)
    drawn, charges = model.intention_table.draw(batch.rows.flatten(), generator)
    intention = torch.einsum("bpd,bp->bd", drawn.flatten().unflatten(0, batch.rows.shape), batch.weights.to(charges))
    charge = charges.view_as(batch.rows)[:, 0]
    mine = group.share(len(batch.rows))
    error = error_of(learner, intention[mine], batch[mine], config)
    for parameters in optimiser.param_groups:
        parameters["lr"] = parameters["peak"] * share_of_rate(learner.update, config)
    optimiser.zero_grad()
    ((error.total + model.config.intention_cost * charge[mine]).sum() / len(batch.rows)).backward()
    group.add_gradients(model.parameters())
    error = SequenceError(*group.add_rows(torch.stack([error.visual, error.proprioceptive]).detach(), mine, len(batch.rows)))
    norm = nn.utils.clip_grad_norm_(optimiser.param_groups[0]["params"], config.gradient_norm)
    errors = {"the visual error": error.visual, "the proprioceptive error": error.proprioceptive, "the charge for the intention": charge}
    validate_finite(learner, errors, norm, run)
    optimiser.step()
    learner.update += 1
    visual, proprioceptive = (each[~batch.blurred].mean().item() for each in (error.visual, error.proprioceptive))
    done = Progress(learner.update, config.updates, visual, proprioceptive, time.perf_counter() - began)
    if run:
        append_to_log(run, asdict(done))
    return done
