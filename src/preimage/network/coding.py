"""Joint angles as population codes, frames as pixels in [-1, 1].

Each joint is encoded by a few units, as in the paper (section II-A, "sparse encoding"): the angle is scaled to [-1, 1] between the
joint's limits and every unit responds with a Gaussian of its distance to the angle, normalised by a softmax. Decoding takes the mean of
the centres under that distribution.

>>> import torch
>>> coding = JointCoding(torch.tensor([-1.0, 0.0]), torch.tensor([1.0, 2.0]))
>>> joints = torch.tensor([[0.3, 1.9]])
>>> codes = coding.encode(joints)
>>> codes.shape, bool((coding.decode(codes) - joints).abs().max() < 0.003)
(torch.Size([1, 2, 10]), True)
"""

import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

SPAN = 1.25
"""The centres span [-SPAN, SPAN], wider than the joints' [-1, 1]: near the outermost centres decoding would no longer invert encoding."""
WIDTH = 0.8
"""Width of a unit's response, in spacings of the centres."""


class JointCoding(nn.Module):
    """Joint angles (rad) to population codes and back; the limits and centres are saved with the weights.

    Args:
        lower: smallest angle of each joint (rad), code -1.
        upper: largest angle of each joint (rad), code +1.
        units: number of units K a joint.
    """

    lower: Tensor
    upper: Tensor
    centres: Tensor

    def __init__(self, lower: Float[Tensor, " J"], upper: Float[Tensor, " J"], units: int = 10) -> None:
        super().__init__()
        if not bool((upper > lower).all()):
            raise ValueError(f"upper {upper.tolist()} must lie above lower {lower.tolist()} for every joint")
        self.register_buffer("lower", lower)
        self.register_buffer("upper", upper)
        self.register_buffer("centres", torch.linspace(-SPAN, SPAN, units, dtype=lower.dtype))

    def encode(self, joints: Float[Tensor, "*batch J"]) -> Float[Tensor, "*batch J K"]:
        """The codes of joint angles (rad): softmax of -(x - centre)^2 / width^2, summing to one over the units of a joint."""
        scaled = 2 * (joints - self.lower) / (self.upper - self.lower) - 1
        width = WIDTH * (self.centres[1] - self.centres[0])
        return torch.softmax(-(((scaled[..., None] - self.centres) / width) ** 2), dim=-1)

    def decode(self, codes: Float[Tensor, "*batch J K"]) -> Float[Tensor, "*batch J"]:
        """The joint angles (rad) that codes stand for: the mean of the centres under the code."""
        scaled = (codes * self.centres).sum(-1)
        return self.lower + (scaled + 1) / 2 * (self.upper - self.lower)


def to_pixels(frames: UInt8[Tensor, "*batch H W C"]) -> Float[Tensor, "*batch C H W"]:
    """8-bit frames as the network takes them: channels first, values in [-1, 1]."""
    return frames.movedim(-1, -3) / 127.5 - 1


def to_frames(pixels: Float[Tensor, "*batch C H W"]) -> UInt8[Tensor, "*batch H W C"]:
    """The inverse of `to_pixels`, rounded and clipped to 8 bits."""
    return ((pixels.float() + 1) * 127.5).round().clamp(0, 255).to(torch.uint8).movedim(-3, -1)
