"""Where the arithmetic is done: on the CPU, or on a GPU, where its kernels are recorded once and started again as a whole.

One step of the network is some hundred small kernels, and a GPU runs each of them in less time than it takes to start it from Python. A
CUDA graph holds all kernels of a piece of work, from tensors at fixed places to tensors at fixed places.
"""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from preimage.compute.choices import Device

CPU = torch.device("cpu")


def torch_device(device: Device) -> torch.device:
    """The device of that name.

    Raises:
        ValueError: cuda is asked for, and there is none.
    """
    there = torch.cuda.is_available()
    if device == "cuda" and not there:
        raise ValueError("--device is cuda, and there is none on this machine: give cpu, or auto")
    return torch.device("cuda" if there and device != "cpu" else "cpu")


def chip_of(place: torch.device) -> str:
    """The chip's name, as results tell it."""
    return torch.cuda.get_device_name(place) if place.type == "cuda" else "cpu"


class Recorded:
    """Work without gradients on a GPU, recorded for inputs of these shapes."""

    def __init__(self, work: Callable[..., Sequence[Tensor]], inputs: Sequence[Tensor]) -> None:
        self._inputs = [each.clone() for each in inputs]
        self._graph = torch.cuda.CUDAGraph()
        beside = torch.cuda.Stream()
        beside.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(beside):
            work(*self._inputs)  # libraries prepare themselves at a first call, which cannot be recorded
        torch.cuda.current_stream().wait_stream(beside)
        with torch.cuda.graph(self._graph):
            self._outputs = work(*self._inputs)

    def __call__(self, *inputs: Tensor) -> list[Tensor]:
        for place, given in zip(self._inputs, inputs, strict=True):
            place.copy_(given)
        self._graph.replay()
        return [each.clone() for each in self._outputs]


def recorded_with_gradients(work: nn.Module, inputs: Sequence[Tensor]) -> Callable[..., tuple[Tensor, ...]]:
    """Work with gradients, to be called with inputs of these shapes; recorded where they lie on a GPU, as it is elsewhere."""
    if not inputs[0].is_cuda:
        return work
    # The recording keeps nodes of the stream it was made on, which costs one wait an update; newer versions of torch warn of it.
    warn = getattr(torch.autograd.graph, "set_warn_on_accumulate_grad_stream_mismatch", None)
    if warn:
        warn(False)
    samples = tuple(each.detach().clone().requires_grad_(each.requires_grad) for each in inputs)
    return torch.cuda.make_graphed_callables(work, samples, allow_unused_input=True)  # pyright: ignore[reportReturnType]
