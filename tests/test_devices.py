"""Where the arithmetic is done is told in one word, and a GPU gets what a CPU gets."""

from dataclasses import replace

import pytest
import torch

from changes import apart, learning_nothing
from preimage.compute.devices import CPU, torch_device
from preimage.compute.processes import ProcessGroup
from preimage.method.config import PlanConfig
from preimage.method.seam import Problem
from preimage.method.train import train
from preimage.network.config import ModelConfig
from preimage.network.inputs import home
from preimage.network.pdvmrnn import PDVMRNN, Generated
from test_train import CONFIG, demonstrations

needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")


def test_a_gpu_is_taken_where_there_is_one(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert [torch_device(device).type for device in ("auto", "cpu", "cuda")] == ["cuda", "cpu", "cuda"]


def test_a_gpu_that_is_not_there_is_refused(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert torch_device("auto") == CPU
    with pytest.raises(ValueError, match="give cpu, or auto"):
        torch_device("cuda")


@needs_gpu
def test_a_gpu_learns_what_a_cpu_learns():
    exact = replace(CONFIG, precision="float32")
    by_cpu, by_gpu = (
        train(demonstrations(), ModelConfig.tiny(), config=exact, group=ProcessGroup(device=torch_device(d))) for d in ("cpu", "cuda")
    )
    begun = train(demonstrations(), ModelConfig.tiny(), config=learning_nothing(exact))
    assert apart(by_gpu, by_cpu, begun=begun) < 0.01


def rollouts(model: PDVMRNN) -> Generated:
    return Problem.between(model, home(model), home(model), PlanConfig(precision="float32")).rollouts


@needs_gpu
def test_what_is_recorded_follows_the_weights():
    model = train(demonstrations(), ModelConfig.tiny(), config=CONFIG)
    seen = rollouts(model)
    there = model.to("cuda")
    for _ in range(2):  # recorded, then replayed
        torch.testing.assert_close(rollouts(there).pixels.cpu(), seen.pixels, rtol=0, atol=0.05)
    with torch.no_grad():
        there.pixel_bias.fill_(9.0)
    assert rollouts(there).pixels.min() > 0.9
    assert isinstance(there, PDVMRNN)
