"""`python -m preimage.fast` compiles the loops for this machine, for which the first plan and the first update wait otherwise.

What is compiled lies on disk, so that once is enough for each release of the program and each processor.
"""

import torch

from preimage import fast
from preimage.network.config import ModelConfig, Sensors
from preimage.network.pdvmrnn import PDVMRNN


def compile_loops() -> None:
    """Both passes of the loop in float32, and in bfloat16 where that is compiled; a file beside the cache says that it was done."""
    from preimage.fast.ahead import mark
    from preimage.fast.convolution import OPTIONS
    from preimage.fast.loop import closed_loop

    model = PDVMRNN(ModelConfig.tiny(), Sensors(16, 16, 1, ("joint",), (-1.0,), (1.0,)))
    states = model.initial_states(model.intention_table.prior_mean(1))
    start = model.home_pixels[None], model.coding.encode(model.home_joints)[None]
    for narrow in {False, fast.is_narrow(model, torch.bfloat16)}:
        pixels, log_codes = closed_loop(model, states, start, num_steps=1, narrow=narrow)
        (pixels.sum() + log_codes.sum()).backward(retain_graph=True)
    if OPTIONS["cache"]:
        mark().touch()


if __name__ == "__main__" and fast.is_available():
    compile_loops()
