"""The closed loop compiled by numba: an engine (`network.engines`) for where it is faster than torch.

Importing numba takes a while, so it is left until a loop needs it.
"""

from importlib.util import find_spec
from typing import TYPE_CHECKING

from preimage.network import engines

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from preimage.network.cells import State
    from preimage.network.pdvmrnn import PDVMRNN, Inputs

IN_BFLOAT16_UP_TO = 8_000_000
"""Weights of a network, its intentions aside, up to which the compiled loop is faster than torch also in bfloat16: it reads matrices in
single precision, which for larger ones takes longer than all the rest."""


def is_available() -> bool:
    """Whether numba is installed."""
    return find_spec("numba") is not None


def install() -> None:
    """Let the network run by `closed_loop_engine` what that serves, where numba is installed."""
    if is_available() and closed_loop_engine not in engines.ENGINES:
        engines.ENGINES.append(closed_loop_engine)


def closed_loop_engine(
    model: "PDVMRNN", states: "dict[str, State]", start: "Inputs", num_steps: int, dtype: "torch.dtype | None"
) -> "tuple[Tensor, Tensor] | None":
    """The compiled loop as an `Engine`; it computes in the precision asked for, or in that of the weights, which is more."""
    if not serves(model, start, dtype):
        return None
    from preimage.fast.loop import closed_loop

    return closed_loop(model, states, start, num_steps=num_steps, narrow=is_narrow(model, dtype))


def serves(model: "PDVMRNN", start: "Inputs", dtype: "torch.dtype | None") -> bool:
    """Whether the closed loop from this start can be compiled, at this precision at least, and is faster for it.

    It is faster in single precision, always; in bfloat16 where the processor has it for both, up to `IN_BFLOAT16_UP_TO` weights; and where
    torch would have to emulate bfloat16.
    """
    import torch

    from preimage.compute.precision import computes_bfloat16

    weights, pixels = model.pixel_bias, start[0]
    possible = weights.device.type == "cpu" and pixels.dtype == weights.dtype and dtype in (None, weights.dtype, torch.bfloat16)
    if not possible or dtype != torch.bfloat16 or not computes_bfloat16(weights.device):
        return possible
    count = sum(value.numel() for name, value in model.named_parameters() if not name.startswith("intention_table."))
    return count <= IN_BFLOAT16_UP_TO and is_narrow(model, dtype)  # in this order: the latter loads numba


def is_narrow(model: "PDVMRNN", dtype: "torch.dtype | None") -> bool:
    """Whether bfloat16 is asked for, and compiled."""
    import torch

    from preimage.fast.bfloat16 import is_compiled

    return dtype == torch.bfloat16 and model.pixel_bias.dtype == torch.float32 and is_compiled()
