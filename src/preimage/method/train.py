"""Training: back-propagation through time on the weights and the intention table together (section II-B).

Every update draws a few demonstrations, generates each from its own intention in closed loop, and lowers the prediction error of both
modalities by Adam. A share of them may begin at a later step, drawn anew each time: what is wanted stays the same wherever the
robot stands, so that the intention learns to hold where the way leads and leaves to the percept where it starts. Another share are blends
of alike demonstrations (`ideas.mixup`), so that what lies between them is learned as well. What an update draws depends on the seed and its
number alone, so that a training that was stopped and resumed gives the same weights, bit for bit on a CPU, as one that never stopped, and
several processes those of one, to rounding (docs/many_machines.md).
"""

import math
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from preimage.compute.devices import recorded_with_gradients
from preimage.compute.freed_memory import keep_freed_memory
from preimage.compute.interrupts import saved_on_interrupt
from preimage.compute.processes import Crew
from preimage.data.sequences import Sequences, pad, sensors_of
from preimage.ideas.mixup import draw_blends
from preimage.method.batch_error import BatchError
from preimage.method.beginning import start_from
from preimage.method.prediction_error import SequenceError
from preimage.network.config import ModelConfig
from preimage.network.intention import IntentionState
from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Demonstration
from preimage.storage.checkpoints import append_to_log, open_run, save_checkpoint, write_non_finite


@dataclass(frozen=True)
class TrainConfig:
    """How the network learns."""

    updates: int = 1400
    """Number of updates of weights and intentions."""
    batch_size: int = 10
    """Demonstrations an update."""
    learning_rate: float = 2e-3
    """Adam's rate for the weights at its highest; it warms up, then falls along a cosine."""
    intention_learning_rate: float = 2e-2
    """Adam's rate for the intentions, on the same course."""
    warmup_updates: int = 20
    """Updates over which the rates rise."""
    final_share: float = 0.05
    """Share of the rates that is left at the end."""
    gradient_norm: float = 1.0
    """Largest norm of the weights' gradient; longer ones are shortened to it."""
    open_loop_share: float = 0.0
    """Share of the sensed percept in the network's input: 0 closed loop, 1 open loop."""
    later_starts: float = 0.0
    """Share of an update's sequences that begin at a later step of their demonstration, under the same intention."""
    start_noise: float = 0.0
    """Standard deviation of the noise on the first frame, in half ranges of a pixel: what is seen of it has to bear a little change."""
    blends: float = 0.0
    """Share of an update's sequences that are blends of alike demonstrations (`ideas.mixup`); less than 1."""
    blend_parts: int = 3
    """Demonstrations in a blend."""
    blend_reach: float = 1.3
    """How far blends reach, in sizes of what their demonstrations span; beyond 1 some lie outside of it."""
    rest_steps: int = 30
    """Steps of rest after a demonstration's end that count: the arm learns to stay at the goal."""
    precision: Literal["bfloat16", "float32"] = "bfloat16"
    """Precision of the layers' arithmetic; weights, states and errors stay float32."""
    checkpoint_every: int = 100
    """Updates between two checkpoints."""
    seed: int = 0
    """Draws the first weights, the batches and the noise."""


class NonFinite(RuntimeError):
    """The training met a number that is not finite; the text says where, and what would do."""


@dataclass
class Learner:
    """What changes while training: network, optimiser and the number of updates done."""

    model: PDVMRNN
    optimiser: torch.optim.Optimizer
    update: int = 0
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
    """What a watcher of the training is told after each update."""

    update: int
    updates: int
    visual: float
    """Squared error of a frame, summed over pixels, mean of the demonstrations of the batch, its blends aside."""
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
    crew: Crew = Crew(),  # noqa: B008, frozen
) -> PDVMRNN:
    """Learn weights and intentions that regenerate the demonstrations.

    Args:
        demonstrations: the sequences to learn; frames of one size, the same joints.
        folder: run folder for checkpoints and log; without one nothing is written.
        resume: go on from the folder's last checkpoint, or from the beginning where it has none yet.
        about: more to write into the run's config.json.
        progress: called after every update.
        crew: the processes that train together, of which only the first writes and tells.

    Returns:
        the trained network, its weights frozen.

    Raises:
        ValueError: the demonstrations do not fit together or are too few for the crew, the folder holds a run already or none to resume.
        NonFinite: an error or a gradient is no longer finite.
        ProcessLost: another process of the crew is no longer there.
        KeyboardInterrupt: the training was interrupted; the last update is saved.
    """
    model_config, config = model_config or ModelConfig.small(), config or TrainConfig()
    model_config = replace(model_config, rate_hz=min([model_config.rate_hz, *(one.rate_hz for one in demonstrations)]))
    sequences = pad(demonstrations, rate_hz=model_config.rate_hz, rest_steps=config.rest_steps)
    model = PDVMRNN(model_config, sensors_of(demonstrations), len(sequences), config.seed)
    crew.refuse_fewer(min(config.batch_size, len(sequences)))
    start_from(model, sequences)
    learner = Learner(model.to(crew.device), optimiser_of(model, config))
    keep_freed_memory()
    kept = {"settings": asdict(config), "about": about or {}, "resume": resume}
    opened = open_run(Path(folder), learner, demonstrations, **kept) if folder is not None and crew.first else nullcontext()
    with opened as run, saved_on_interrupt() as interrupted:
        if crew.size > 1:  # a checkpoint may lie where the others cannot see it, and another machine may round otherwise
            learner.load(crew.of_first(learner.state()))
        stop = False
        while learner.update < config.updates and not stop:
            told = one_update(learner, sequences, config, run, crew)
            if progress and crew.first:
                progress(told)
            stop = crew.any(interrupted())
            if run and (learner.update % config.checkpoint_every == 0 or learner.update == config.updates or stop):
                save_checkpoint(run, learner)
        crew.any(stop)  # all wait until the last checkpoint is written
    if stop:
        raise KeyboardInterrupt
    return model.requires_grad_(False).eval()


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


def one_update(learner: Learner, sequences: Sequences, config: TrainConfig, run: Path | None, crew: Crew) -> Progress:
    """One step of Adam on one batch, of which this process generates its share."""
    began = time.perf_counter()
    model, optimiser = learner.model, learner.optimiser
    rows = batch_of(learner.update, len(sequences), config)
    generator = torch.Generator().manual_seed(config.seed * 1_000_003 + learner.update)
    blends = draw_blends(rows, sequences, generator, share=config.blends, parts=config.blend_parts, reach=config.blend_reach)
    parts, charges = model.intention_table.draw(blends.rows.flatten(), generator)
    intention, charge = blends.intention(parts), charges.view_as(blends.rows)[:, 0]
    steps = begin_steps(sequences.lengths[rows], config, generator)
    noise = config.start_noise * torch.randn(len(rows), *model.pixel_bias.shape, generator=generator)
    mine = crew.share(len(rows))
    shown = blends[mine].sequences(sequences, steps[mine])
    error = error_of(learner, intention[mine], shown, noise[mine], blends.blended[mine], config)
    for group in optimiser.param_groups:
        group["lr"] = group["peak"] * share_of_rate(learner.update, config)
    optimiser.zero_grad()
    ((error.total + model.config.intention_cost * charge[mine]).sum() / len(rows)).backward()
    crew.add_gradients(model.parameters())
    error = error_of_all(error, mine, len(rows), crew)
    norm = nn.utils.clip_grad_norm_(optimiser.param_groups[0]["params"], config.gradient_norm)
    refuse_non_finite(learner, error, charge, norm, run)
    optimiser.step()
    learner.update += 1
    visual, proprioceptive = (each[~blends.blended].mean().item() for each in (error.visual, error.proprioceptive))
    told = Progress(learner.update, config.updates, visual, proprioceptive, time.perf_counter() - began)
    if run:
        append_to_log(run, asdict(told))
    return told


def begin_steps(lengths: Int[Tensor, " B"], config: TrainConfig, generator: torch.Generator) -> Int[Tensor, " B"]:
    """Where each sequence begins: at its first step, or, a share of them, at any step of it."""
    later, where = torch.rand(2, len(lengths), generator=generator)
    return (where * lengths).long() * (later < config.later_starts)


def error_of(
    learner: Learner,
    intention: IntentionState,
    sequences: Sequences,
    noise: Float[Tensor, "B C H W"],
    blended: Bool[Tensor, " B"],
    config: TrainConfig,
) -> SequenceError:
    """The errors of a batch, by what was recorded at the first one."""
    given = sequences.frames, sequences.joints, sequences.mask, noise, blended
    inputs = [intention.flatten(), *(each.to(learner.model.pixel_bias.device) for each in given)]
    if learner.batch_error is None:
        how = {"share": config.open_loop_share, "dtype": getattr(torch, config.precision), "blends": config.blends > 0}
        learner.batch_error = recorded_with_gradients(BatchError(learner.model, **how), inputs)
    return SequenceError(*learner.batch_error(*inputs))


def error_of_all(error: SequenceError, mine: Int[Tensor, " S"], count: int, crew: Crew) -> SequenceError:
    """The errors of all sequences of an update, of which this process knows its own."""
    own = torch.stack([error.visual, error.proprioceptive]).detach()
    return SequenceError(*crew.add(own.new_zeros(2, count).index_copy_(1, mine.to(own.device), own)))


def refuse_non_finite(learner: Learner, error: SequenceError, charge: Tensor, norm: Tensor, run: Path | None) -> None:
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
