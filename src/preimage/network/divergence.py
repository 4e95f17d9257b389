"""How far a predicted percept is from the one it should be, as an error and as residuals, whose squares sum to about the error.

Vision is a squared error summed over pixels, the motors a Kullback-Leibler divergence summed over joints, KL(target || predicted); the
paper writes the arguments the other way round, see docs/paper.md. Frames of another size are charged as if they had 64x64 pixels, so
that the balance of the two modalities does not depend on the camera.
"""

import torch
from jaxtyping import Float
from torch import Tensor

VISUAL_WEIGHT = 1 / 40
"""Weight of the visual error beside the joints' KL: chosen so that both fall together; the paper does not say."""
REFERENCE_PIXELS = 64 * 64


def pixel_scale(frames: Float[Tensor, "*batch C H W"]) -> float:
    """What a pixel counts, so that all frames count as if they had 64x64 of them."""
    return REFERENCE_PIXELS / frames.shape[-3:].numel()


def visual_error(predicted: Float[Tensor, "*batch C H W"], target: Float[Tensor, "*#batch C H W"]) -> Float[Tensor, "*batch"]:
    """Squared error summed over pixels, as of a frame of 64x64."""
    return pixel_scale(target) * (predicted - target).square().sum((-1, -2, -3))


def proprioceptive_error(log_predicted: Float[Tensor, "*batch J K"], target: Float[Tensor, "*#batch J K"]) -> Float[Tensor, "*batch"]:
    """KL(target || predicted) of the codes, summed over joints (nats)."""
    return (torch.special.xlogy(target, target) - target * log_predicted).sum((-1, -2))


def sensed_log(codes: Float[Tensor, "*batch J K"]) -> Float[Tensor, "*batch J K"]:
    """Log codes of what was sensed, which may hold zeros, as if they were predicted."""
    return codes.clamp(min=1e-12).log()


def visual_residuals(predicted: Float[Tensor, "*batch C H W"], target: Float[Tensor, "*#batch C H W"]) -> Float[Tensor, "..."]:
    """Numbers whose squares sum to the weighted visual error."""
    return (VISUAL_WEIGHT * pixel_scale(target)) ** 0.5 * (predicted - target)


def proprioceptive_residuals(
    log_predicted: Float[Tensor, "*batch J K"], target: Float[Tensor, "*#batch J K"]
) -> Float[Tensor, "*batch J K"]:
    """Numbers whose squares sum to the KL to second order: sqrt(2) times the difference of the roots (Hellinger)."""
    return 2**0.5 * ((log_predicted / 2).exp() - target.sqrt())
