"""The batch of an update: which sequences it shows, as a function of the seed and the number of the update alone, and its error."""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor, nn

from preimage.compute.devices import recorded_with_gradients
from preimage.compute.precision import resolve_precision
from preimage.data.sequences import Sequences
from preimage.method.config import TrainConfig
from preimage.method.learner import Learner
from preimage.method.prediction_error import SequenceError, sequence_error
from preimage.method.seam import Batch
from preimage.network.coding import to_pixels
from preimage.network.intention import unflatten
from preimage.network.pdvmrnn import PDVMRNN, Generated


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
