"""The precision follows the machine: bfloat16 where it is native, float32 elsewhere, and what was asked for by name always."""

import os
import subprocess
import sys

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from preimage.compute import precision
from preimage.compute.devices import CPU
from preimage.compute.precision import computes_bfloat16, describe_precision, instruction_set, resolve_precision
from preimage.network.config import ModelConfig, Sensors
from preimage.network.pdvmrnn import PDVMRNN


@pytest.mark.parametrize(("native", "taken"), [(True, "bfloat16"), (False, "float32")])
def test_auto_follows_the_machine_and_a_name_does_not(monkeypatch: pytest.MonkeyPatch, native: bool, taken: str) -> None:
    monkeypatch.setattr(precision, "computes_bfloat16", lambda _device: native)
    assert resolve_precision("auto", CPU) == taken
    assert resolve_precision("bfloat16", CPU) == "bfloat16"
    assert resolve_precision("float32", CPU) == "float32"


def test_the_choice_is_said_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(precision, "computes_bfloat16", lambda _device: True)
    assert describe_precision("auto", CPU) == "precision: bfloat16 (this processor computes it natively)"
    assert describe_precision("auto", torch.device("cuda")) == "precision: bfloat16 (this GPU computes it natively)"
    assert describe_precision("float32", CPU) == "precision: float32 (as asked for)"
    monkeypatch.setattr(precision, "computes_bfloat16", lambda _device: False)
    assert describe_precision("auto", CPU) == "precision: float32 (this processor would only emulate bfloat16)"


def test_who_asks_for_an_emulated_precision_is_told_what_it_costs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(precision, "computes_bfloat16", lambda _device: False)
    line = describe_precision("bfloat16", CPU)
    assert line.startswith("precision: bfloat16 (this processor emulates it: ")
    assert precision.COST_OF_EMULATION in line


@pytest.mark.parametrize(("library", "processor"), [(False, True), (True, False), (False, False)])
def test_both_the_library_and_the_processor_have_to_say_yes(monkeypatch: pytest.MonkeyPatch, library: bool, processor: bool) -> None:
    monkeypatch.setattr("platform.machine", lambda: "x86_64")
    monkeypatch.setattr(torch.ops.mkldnn, "_is_mkldnn_bf16_supported", lambda: library, raising=False)
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: processor, raising=False)
    assert not computes_bfloat16(CPU)


def test_on_arm_the_library_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("platform.machine", lambda: "arm64")
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: False, raising=False)
    for answer in (True, False):
        monkeypatch.setattr(torch.ops.mkldnn, "_is_mkldnn_bf16_supported", lambda answer=answer: answer, raising=False)
        assert computes_bfloat16(CPU) is answer


def test_without_onednn_there_is_float32(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.ops, "mkldnn", object())
    assert not computes_bfloat16(CPU)


class Dtypes(TorchDispatchMode):
    """Notes the types of all tensors that are computed."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: set[torch.dtype] = set()

    def __torch_dispatch__(self, operator, types, arguments=(), keywords=None):
        computed = operator(*arguments, **(keywords or {}))
        self.seen |= {value.dtype for value in tree_leaves(computed) if isinstance(value, torch.Tensor)}
        return computed


@pytest.mark.parametrize("native", [True, False])
def test_where_the_machine_says_no_nothing_runs_in_bfloat16(monkeypatch: pytest.MonkeyPatch, native: bool) -> None:
    monkeypatch.setattr(precision, "computes_bfloat16", lambda _device: native)
    model = PDVMRNN(ModelConfig.tiny(), Sensors(16, 16, 1, ("a", "b"), (-1.0, -1.0), (1.0, 1.0)))
    start = torch.zeros(1, 1, 16, 16), torch.full((1, 2, 10), 0.1)
    with Dtypes() as computed:
        dtype = getattr(torch, resolve_precision("auto", CPU))
        generated = model.generate_closed_loop(model.intention_table.prior_mean(1), start, num_steps=2, dtype=dtype)
        (generated.pixels.sum() + generated.log_codes.sum()).backward()
    assert (torch.bfloat16 in computed.seen) == native


@pytest.mark.slow
def test_a_machine_with_avx2_alone_takes_float32() -> None:
    told = subprocess.run(
        [sys.executable, "-c", "import torch, preimage.compute.precision as p; print(p.resolve_precision('auto', torch.device('cpu')))"],
        env=os.environ | {"ONEDNN_MAX_CPU_ISA": "AVX2"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert told.stdout == "float32\n"


def test_the_instruction_set_says_whether_bfloat16_is_in_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: "AVX512")
    for native, name in ((True, "AVX512 with bfloat16"), (False, "AVX512")):
        monkeypatch.setattr(precision, "computes_bfloat16", lambda _device, native=native: native)
        assert instruction_set(CPU) == name
