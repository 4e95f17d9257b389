"""Other ways to run the closed loop than torch's, step by step: the network asks each of them in turn, and knows none.

An engine gets what a closed loop begins with, and answers with the predicted pixels (B, T, C, H, W) and log codes (B, T, J, K), or with
None where this loop is not for it. Who builds one adds it to `ENGINES` (`fast.install`).
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # whoever adds an engine need not load torch for it
    import torch
    from torch import Tensor

    from preimage.network.cells import State
    from preimage.network.pdvmrnn import PDVMRNN, Inputs

Engine = Callable[["PDVMRNN", "dict[str, State]", "Inputs", int, "torch.dtype | None"], "tuple[Tensor, Tensor] | None"]
"""From the network, the states of all layers before the first step, the first input, the number of steps and the precision asked for."""

ENGINES: list[Engine] = []
"""The first that answers runs the loop; where none does, torch does."""
