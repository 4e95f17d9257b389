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

COMPILED_UP_TO = 8_000_000
"""Weights of a network, its intentions aside: beyond them torch is faster. `small` has 3.8 million and is faster compiled, or as fast;
`paper` has 21 and takes 1.1 (float32) to 1.4 times as long (bfloat16), on one core (docs/log.md)."""
TINY = 100_000
"""Up to so many weights the compiled loop is faster in float32 than torch in bfloat16."""


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
    from preimage.fast.ahead import compile_ahead
    from preimage.fast.loop import closed_loop

    compile_ahead()
    return closed_loop(model, states, start, num_steps=num_steps, narrow=is_narrow(model, dtype))


def serves(model: "PDVMRNN", start: "Inputs", dtype: "torch.dtype | None") -> bool:
    """Whether the closed loop from this start can be compiled, at this precision at least, and is faster for it.

    It is for networks of up to `COMPILED_UP_TO` weights; but where bfloat16 is asked for, and the processor has it for torch alone, for
    those that are `TINY`.
    """
    import torch

    from preimage.compute.precision import computes_bfloat16

    weights, pixels = model.pixel_bias, start[0]
    possible = weights.device.type == "cpu" and pixels.dtype == weights.dtype and dtype in (None, weights.dtype, torch.bfloat16)
    count = sum(value.numel() for name, value in model.named_parameters() if not name.startswith("intention_table."))
    if not possible or count > COMPILED_UP_TO:
        return False
    return dtype != torch.bfloat16 or count <= TINY or is_narrow(model, dtype) or not computes_bfloat16(weights.device)


def is_narrow(model: "PDVMRNN", dtype: "torch.dtype | None") -> bool:
    """Whether bfloat16 is asked for, and compiled."""
    import torch

    from preimage.fast.bfloat16 import is_compiled

    return dtype == torch.bfloat16 and model.pixel_bias.dtype == torch.float32 and is_compiled()
