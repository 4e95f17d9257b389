"""What an update of the training lowers, as a function of tensors alone, so that a GPU can record it (`compute.devices`)."""

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor, nn

from preimage.ideas.image_features import BLUR
from preimage.method.prediction_error import sequence_error
from preimage.network.coding import to_pixels
from preimage.network.intention import unflatten
from preimage.network.pdvmrnn import PDVMRNN


class BatchError(nn.Module):
    """Generate a batch from its intentions and compare.

    Args:
        share: how much of the input is sensed (`PDVMRNN.generate_open_loop`).
        dtype: precision of the layers' arithmetic.
        blends: whether there are blends in a batch, whose pictures are compared coarsely.
    """

    def __init__(self, model: PDVMRNN, *, share: float, dtype: torch.dtype, blends: bool) -> None:
        super().__init__()
        self.model, self.share, self.dtype, self.blends = model, share, dtype, blends

    def forward(
        self,
        intention: Float[Tensor, "B D"],
        frames: UInt8[Tensor, "B T H W C"],
        joints: Float[Tensor, "B T J"],
        mask: Float[Tensor, "B T"],
        noise: Float[Tensor, "B C H W"],
        blended: Bool[Tensor, " B"],
    ) -> tuple[Float[Tensor, " B"], Float[Tensor, " B"]]:
        """The visual and the proprioceptive error of each sequence.

        Args:
            intention: flattened (`IntentionState.flatten`).
            joints: angles (rad).
            mask: 1 where a step counts.
            noise: on the first frame as it is looked at.
            blended: which sequences are blends.
        """
        model = self.model
        pixels, codes = to_pixels(frames), model.coding.encode(joints.clamp(model.coding.lower, model.coding.upper))
        intentions = unflatten(intention, model.intention_table.shapes)
        start = pixels[:, 0] + noise, codes[:, 0]
        generated = model.generate_open_loop(intentions, (pixels, codes), start=start, share=self.share, dtype=self.dtype)
        error = sequence_error(generated, pixels, codes, mask)
        if not self.blends:
            return error.visual, error.proprioceptive
        coarse = sequence_error(generated, pixels, codes, mask, BLUR)
        return torch.where(blended, coarse.visual, error.visual), error.proprioceptive
