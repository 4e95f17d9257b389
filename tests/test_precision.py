"""The precision follows the machine: bfloat16 where it is native, float32 elsewhere, and what was asked for by name always."""

import os
import subprocess
import sys

import pytest
import torch

from preimage.compute import precision
from preimage.compute.devices import CPU
from preimage.compute.precision import computes_bfloat16, describe_precision, resolve_precision


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
