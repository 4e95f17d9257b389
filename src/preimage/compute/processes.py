"""Processes that work together: each takes its share of an update's sequences, whose gradients are summed, or of the goals planned to.

What an update draws is drawn for all of its sequences in every process, so that it does not matter how many share them.

>>> ProcessGroup(rank=1, size=3).share(7)
tensor([1, 4])
"""

import atexit
import contextlib
import logging
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

import torch
from jaxtyping import Float, Int
from torch import Tensor, distributed, nn

from preimage.compute.choices import Device
from preimage.compute.devices import CPU, torch_device

Told = TypeVar("Told")


class ProcessLost(RuntimeError):
    """Another process of the group has stopped, so that its share of the work is missing."""


@dataclass(frozen=True)
class ProcessGroup:
    """One of the processes that train together; by itself the only one."""

    rank: int = 0
    size: int = 1
    device: torch.device = CPU
    """Where this process computes."""

    @property
    def first(self) -> bool:
        """Whether this process is the one that writes and tells."""
        return self.rank == 0

    def validate_share(self, count: int) -> None:
        """Raises ValueError where an update of `count` sequences would leave a process without one."""
        if count < self.size:
            raise ValueError(
                f"{self.size} processes cannot share an update of {count} sequences: give fewer devices, or more data or --batch-size"
            )

    def share(self, count: int) -> Int[Tensor, " S"]:
        """Which of `count` sequences this process takes."""
        return torch.arange(self.rank, count, self.size)

    def add(self, values: Tensor) -> Tensor:
        """The sum of what all processes have, in place.

        Raises:
            ProcessLost: another process is no longer there.
        """
        if self.size > 1:
            with lost_processes_raise():
                distributed.all_reduce(values)
        return values

    def add_rows(self, values: Float[Tensor, "K S"], rows: Int[Tensor, " S"], count: int) -> Float[Tensor, "K count"]:
        """The values of all rows, of which each process has its own.

        Raises:
            ProcessLost: as in `add`.
        """
        return self.add(values.new_zeros(len(values), count).index_copy_(1, rows.to(values.device), values))

    def add_gradients(self, parameters: Iterable[nn.Parameter]) -> None:
        """Every gradient becomes its sum over all processes, by one exchange."""
        if self.size == 1:
            return
        gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
        sums = self.add(torch.cat([gradient.flatten() for gradient in gradients])).split([gradient.numel() for gradient in gradients])
        for gradient, of_all in zip(gradients, sums, strict=True):
            gradient.copy_(of_all.view_as(gradient))

    def any(self, here: bool) -> bool:
        """Whether it is so in any process: all get the same answer, where each by itself would see a Ctrl-C at another update."""
        return bool(self.add(torch.tensor(float(here), device=self.device)) > 0)

    def broadcast(self, told: Told) -> Told:
        """What the first process has.

        Raises:
            ProcessLost: as in `add`.
        """
        box = [told]
        if self.size > 1:
            with lost_processes_raise():
                distributed.broadcast_object_list(box, device=self.device)
        return box[0]

    def gather(self, told: Mapping[int, Told]) -> list[Told]:
        """What all processes have, each under numbers of its own, in the order of the numbers.

        Raises:
            ProcessLost: as in `add`.
        """
        of_each = [told] * self.size
        if self.size > 1:
            with lost_processes_raise():
                distributed.all_gather_object(of_each, told)
        of_all = {number: one for some in of_each for number, one in some.items()}
        return [of_all[number] for number in sorted(of_all)]


@contextlib.contextmanager
def lost_processes_raise() -> Iterator[None]:
    try:
        yield
    except RuntimeError as error:  # all that torch raises where the other side of a connection is gone
        text = "another process of this training has stopped: what it says tells why; --resume goes on"
        raise ProcessLost(text) from error.with_traceback(None)  # whose frames may hold the connection past its end


def join_processes(*, devices: int, num_nodes: int, device: Device = "auto") -> ProcessGroup:
    """Start the other processes with the words of this one, unless torchrun or Slurm has, and join them.

    Args:
        devices: processes on each machine.
        num_nodes: machines.
        device: what each computes on; auto: a GPU of its own where there is one for every process of a machine, otherwise the CPU.

    Raises:
        ValueError: lightning-fabric is missing, another number of processes was started, or there are too few GPUs.
    """
    if min(devices, num_nodes) < 1:
        raise ValueError(f"--devices is {devices} and --num-nodes {num_nodes}: give 1 or more")
    if devices * num_nodes == 1 and not distributed.is_torchelastic_launched():
        return ProcessGroup(device=torch_device(device))
    try:
        from lightning_fabric import Fabric  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ValueError("several processes need lightning-fabric: pip install 'preimage[many]'") from error
    logging.getLogger("lightning_fabric").setLevel(logging.WARNING)
    enough = torch.cuda.device_count() >= devices
    if device == "cuda" and not enough:
        raise ValueError(f"--device is cuda, and there are {torch.cuda.device_count()} for --devices {devices}: give fewer, or cpu")
    accelerator = "cuda" if enough and device != "cpu" else "cpu"
    try:
        fabric = Fabric(accelerator=accelerator, devices=devices, num_nodes=num_nodes, strategy="ddp")
        fabric.launch()
    except ValueError as error:
        reason = " ".join(str(error).split()).rstrip(".")
        text = f"other processes were started than --devices {devices} and --num-nodes {num_nodes} say ({reason}): give both as they are"
        raise ValueError(text) from error
    atexit.register(distributed.destroy_process_group)  # or its threads abort a process that ends while they run
    return ProcessGroup(fabric.global_rank, fabric.world_size, fabric.device)
