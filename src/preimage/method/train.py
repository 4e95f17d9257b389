"""Training: back-propagation through time on the weights and the intention table together (section II-B).

Every update draws a few demonstrations, generates each from its own intention in closed loop, and lowers the prediction error of both
modalities (equation 1) by Adam. What an update draws depends on the seed and its number alone, so that a training that was stopped and
resumed gives the same weights, bit for bit on a CPU, as one that never stopped, and several processes those of one, to rounding
(docs/many_machines.md).
"""

import math
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor, nn

from preimage.compute.devices import recorded_with_gradients
from preimage.compute.freed_memory import keep_freed_memory
from preimage.compute.interrupts import saved_on_interrupt
from preimage.compute.precision import resolve_precision
from preimage.compute.processes import ProcessGroup
from preimage.data.sequences import Sequences, pad, sensors_of
from preimage.method.config import TrainConfig
from preimage.method.prediction_error import SequenceError, sequence_error
from preimage.method.seam import Augmentation, Batch
from preimage.network.coding import to_pixels
from preimage.network.config import ModelConfig
from preimage.network.intention import IntentionTable, unflatten
from preimage.network.pdvmrnn import PDVMRNN, Generated
from preimage.records import Demonstration
from preimage.storage.checkpoints import append_to_log, open_run, save_checkpoint, write_non_finite


class NonFinite(RuntimeError):
    """The training met a number that is not finite; the text says where, and what would do."""


@dataclass
class Learner:
    """What changes while training: network, optimiser and the number of updates done."""

    model: PDVMRNN
    optimiser: torch.optim.Optimizer
    update: int = 0
    augmentations: Sequence[Augmentation] = ()
    batch_error: Callable[..., tuple[Tensor, ...]] | None = None
    """`BatchError`, recorded at the first batch."""

    def state(self) -> dict[str, Any]:
        return {"update": self.update, "model": self.model.state_dict(), "optimiser": self.optimiser.state_dict()}

    def load(self, state: dict[str, Any]) -> None:
        self.model.load_state_dict(state["model"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.update = state["update"]


@dataclass(frozen=True)
class Progress:
    """What there is to report after each update."""

    update: int
    updates: int
    visual: float
    """Squared error of a frame, summed over pixels, mean of the demonstrations of the batch, weighted sums of several aside."""
    proprioceptive: float
    """KL of the joint codes, summed over joints, likewise (nats)."""
    seconds: float = field(compare=False)
    """Wall time of the update."""


def train(
    demonstrations: Sequence[Demonstration],
    model_config: ModelConfig | None = None,
    *,
    config: TrainConfig | None = None,
    folder: Path | str | None = None,
    resume: bool = False,
    about: dict[str, Any] | None = None,
    progress: Callable[[Progress], None] | None = None,
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
        group.any(stop)  # all wait until the last checkpoint is written
    if stop:
        raise KeyboardInterrupt
    return model.requires_grad_(False).eval()


def start_from_demonstrations(model: PDVMRNN, sequences: Sequences) -> None:
    """Start the outputs at the mean percept and the intentions as neighbours where sequences are alike; keep the mean start as home."""
    pixels, codes = to_pixels(sequences.frames), model.coding.encode(sequences.joints)
    model.start_from_means(pixels.mean((0, 1)), codes.mean((0, 1)))
    model.home_pixels.copy_(pixels[:, 0].mean(0))
    model.home_joints.copy_(sequences.joints[:, 0].mean(0))
    model.longest.fill_(sequences.frames.shape[1])
    model.shortest.fill_(sequences.lengths.min())
    spread_intentions(model.intention_table, codes.flatten(1))


def spread_intentions(table: IntentionTable, features: Float[Tensor, "N F"], components: int = 16) -> None:
    """Start the intentions where alike sequences are neighbours: at their principal components.

    The paper starts them at random. From there, learning first has to find out what an intention could be good for; from here it
    can begin with the demonstrations themselves.
    """
    centred = features - features.mean(0)
    directions, sizes, _ = torch.linalg.svd(centred, full_matrices=False)
    components = min(components, len(features))
    weights = (sizes / sizes[0].clamp(min=1e-9)).clamp(min=0.15)[:components]  # small components count, or no two would differ
    scores = len(features) ** 0.5 * directions[:, :components] * weights
    table.start_from(scores, torch.Generator().manual_seed(components))


def optimiser_of(model: PDVMRNN, config: TrainConfig) -> torch.optim.Optimizer:
    """Adam on weights and intentions, each at its own rate."""
    weights = [value for name, value in model.named_parameters() if not name.startswith("intention_table.")]
    intentions = list(model.intention_table.parameters())
    groups = [
        {"params": weights, "peak": config.learning_rate},
        {"params": intentions, "peak": config.intention_learning_rate},
    ]
    return torch.optim.Adam(groups, betas=(0.9, 0.99))


def share_of_rate(update: int, config: TrainConfig) -> float:
    """The share of the highest rate at an update: a linear rise, then half a cosine down to `final_share`."""
    rise = min(1.0, (update + 1) / config.warmup_updates)
    fall = 0.5 * (1 + math.cos(math.pi * update / config.updates))
    return rise * (config.final_share + (1 - config.final_share) * fall)


def batch_of(update: int, num_sequences: int, config: TrainConfig) -> Tensor:
    """The rows of an update: every sequence once an epoch, in an order drawn from the seed and the epoch."""
    size = min(config.batch_size, num_sequences)
    rows = []
    for position in range(update * size, (update + 1) * size):
        epoch, place = divmod(position, num_sequences)
        rows.append(shuffled(num_sequences, config.seed, epoch)[place])
    return torch.stack(rows)


def shuffled(count: int, seed: int, epoch: int) -> Tensor:
    return torch.randperm(count, generator=torch.Generator().manual_seed(seed * 1_000_003 + epoch))


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
    error = error_of_all(error, mine, len(batch.rows), group)
    norm = nn.utils.clip_grad_norm_(optimiser.param_groups[0]["params"], config.gradient_norm)
    validate_finite(learner, error, charge, norm, run)
    optimiser.step()
    learner.update += 1
    visual, proprioceptive = (each[~batch.blurred].mean().item() for each in (error.visual, error.proprioceptive))
    done = Progress(learner.update, config.updates, visual, proprioceptive, time.perf_counter() - began)
    if run:
        append_to_log(run, asdict(done))
    return done


def plain_batch(rows: Int[Tensor, " B"], sequences: Sequences) -> Batch:
    """Training sequences as they are."""
    ones, nowhere = torch.ones(len(rows), 1), torch.zeros(len(rows), dtype=torch.long)
    return Batch(rows[:, None], ones, sequences.begun_at(rows, nowhere), blurred=nowhere.bool())


def error_of(learner: Learner, intention: Float[Tensor, "B D"], batch: Batch, config: TrainConfig) -> SequenceError:
    """The errors of a batch, by what was recorded at the first one."""
    given = batch.sequences.frames, batch.sequences.joints, batch.sequences.mask, batch.blurred
    inputs = [intention, *(each.to(learner.model.pixel_bias.device) for each in given)]
    if learner.batch_error is None:
        dtype = getattr(torch, resolve_precision(config.precision, learner.model.pixel_bias.device))
        learner.batch_error = recorded_with_gradients(BatchError(learner.model, dtype=dtype, blur=batch.blur), inputs)
    return SequenceError(*learner.batch_error(*inputs))


class BatchError(nn.Module):
    """What an update lowers, as a function of tensors alone, so that a GPU can record it: generate from intentions, and compare."""

    def __init__(self, model: PDVMRNN, *, dtype: torch.dtype, blur: Callable[[Tensor], Tensor] | None = None) -> None:
        super().__init__()
        self.model, self.dtype, self.blur = model, dtype, blur

    def forward(
        self,
        intention: Float[Tensor, "B D"],
        frames: UInt8[Tensor, "B T H W C"],
        joints: Float[Tensor, "B T J"],
        mask: Float[Tensor, "B T"],
        blurred: Bool[Tensor, " B"],
    ) -> tuple[Float[Tensor, " B"], Float[Tensor, " B"]]:
        """The visual and the proprioceptive error of each sequence (`IntentionState.flatten`, angles in rad, 1 where a step counts)."""
        model = self.model
        pixels, codes = to_pixels(frames), model.coding.encode(joints.clamp(model.coding.lower, model.coding.upper))
        intentions = unflatten(intention, model.intention_table.shapes)
        generated = model.generate_closed_loop(intentions, (pixels[:, 0], codes[:, 0]), num_steps=frames.shape[1], dtype=self.dtype)
        error = sequence_error(generated, pixels, codes, mask)
        if self.blur is None:
            return error.visual, error.proprioceptive
        coarse = sequence_error(Generated(self.blur(generated.pixels), generated.log_codes), self.blur(pixels), codes, mask)
        return torch.where(blurred, coarse.visual, error.visual), error.proprioceptive


def error_of_all(error: SequenceError, mine: Int[Tensor, " S"], count: int, group: ProcessGroup) -> SequenceError:
    """The errors of all sequences of an update, of which this process knows its own."""
    own = torch.stack([error.visual, error.proprioceptive]).detach()
    return SequenceError(*group.add(own.new_zeros(2, count).index_copy_(1, mine.to(own.device), own)))


def validate_finite(learner: Learner, error: SequenceError, charge: Tensor, norm: Tensor, run: Path | None) -> None:
    """Raises NonFinite, naming the first tensor that is not finite, before it can reach the weights."""
    suspects = {"the visual error": error.visual, "the proprioceptive error": error.proprioceptive, "the charge for the intention": charge}
    if all(bool(value.isfinite().all()) for value in (*suspects.values(), norm)):
        return
    gradients = {f"the gradient of {name}": p.grad for name, p in learner.model.named_parameters() if p.grad is not None}
    broken = (name for name, value in (suspects | gradients).items() if not bool(value.isfinite().all()))
    name = next(broken, "the norm of the gradient")
    text = f"{name} is not finite at update {learner.update + 1}: a lower learning rate or precision float32 would do"
    if run:
        write_non_finite(run, learner.update + 1, name)
    raise NonFinite(text)
