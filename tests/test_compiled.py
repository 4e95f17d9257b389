"""The compiled loop is the network's own: the same values and gradients as torch's step gives, in every shape that is served."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from changes import apart, learning_nothing
from preimage.data.lerobot_writer import write_files
from preimage.fast import closed_loop_engine, serves
from preimage.method.train import TrainConfig, train
from preimage.network.config import ModelConfig, Sensors
from preimage.network.pdvmrnn import PDVMRNN, Generated, imagined
from preimage.storage.run_files import WEIGHTS
from shared import make_demonstration

pytest.importorskip("numba")
from preimage.fast.ahead import compile_ahead
from preimage.fast.bfloat16 import is_compiled
from preimage.fast.convolution import can_cache, forget_outdated

pytestmark = pytest.mark.slow  # the first time on a machine it is all compiled, in half a minute

THREE_LEVELS = ModelConfig(vision_channels=(5, 6, 8), motor_units=(9, 8, 7), top_channels=6, lateral_channels=2, seen_channels=3)
CASES = {
    "two levels": (ModelConfig.tiny(), (16, 16, 1), 3),
    "one sequence, wide, in colour": (ModelConfig.tiny(), (16, 24, 3), 1),
    "three levels": (THREE_LEVELS, (32, 16, 1), 2),
    "keypoints": (replace(THREE_LEVELS, keypoints=3), (32, 16, 1), 3),
    "more places than a chunk": (ModelConfig.tiny(), (64, 64, 1), 3),
    "more sequences than are served at once": (ModelConfig.tiny(), (16, 16, 1), 19),
    "small": (replace(ModelConfig.small(), keypoints=2), (64, 64, 1), 2),
}
NUM_STEPS = 4
SMALL = Sensors(16, 16, 1, ("a", "b"), (-1.0, -1.0), (1.0, 1.0))


@pytest.fixture(autouse=True)
def compiling(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """By the compiled loop, on two threads."""
    monkeypatch.setattr("preimage.network.engines.ENGINES", [closed_loop_engine])
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(threads)


def network(config: ModelConfig, size: tuple[int, int, int], batch: int, dtype: torch.dtype) -> PDVMRNN:
    """With weights, biases and states that are not zero anywhere."""
    model = PDVMRNN(config, Sensors(*size, ("a", "b"), (-1.0, -1.0), (1.0, 1.0)), num_sequences=batch).to(dtype)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for value in model.parameters():
            value += 0.1 * torch.randn(value.shape, generator=generator)
    return model


def start_of(model: PDVMRNN, batch: int) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(2)
    pixels = torch.randn(batch, *model.pixel_bias.shape, generator=generator)
    codes = torch.randn(batch, *model.code_bias.shape, generator=generator).softmax(-1)
    return pixels.to(model.pixel_bias.dtype), codes.to(model.code_bias.dtype)


def by_torch(model: PDVMRNN, start: tuple[Tensor, Tensor], dtype: torch.dtype | None = None) -> Generated:
    """The same loop, that the model does not recognise as one it may compile."""
    intention = model.intention_table.intentions()
    return model._generate(intention, start, NUM_STEPS, lambda step, predicted: predicted, dtype)


def compiled(model: PDVMRNN, start: tuple[Tensor, Tensor], dtype: torch.dtype | None = None) -> Generated:
    assert serves(model, start, dtype)
    return model.generate_closed_loop(model.intention_table.intentions(), start, num_steps=NUM_STEPS, dtype=dtype)


def answers(model: PDVMRNN, batch: int, loop: Callable[[PDVMRNN, tuple[Tensor, Tensor]], Generated]) -> dict[str, Tensor | None]:
    """What is predicted, and the gradients of a sum of it with arbitrary weights."""
    model.zero_grad()
    start = tuple(part.requires_grad_() for part in start_of(model, batch))
    generated = loop(model, start)
    generator = torch.Generator().manual_seed(3)
    parts = generated.pixels, generated.log_codes
    sum((part * torch.randn(part.shape, generator=generator).to(part)).sum() for part in parts).backward()
    told = {"pixels": parts[0].detach(), "log codes": parts[1].detach(), "start": start[0].grad, "start codes": start[1].grad}
    return told | {name: value.grad for name, value in model.named_parameters()}


@pytest.mark.parametrize("case", CASES)
def test_values_and_gradients_are_those_of_torch(case: str) -> None:
    config, size, batch = CASES[case]
    model = network(config, size, batch, torch.float64)
    expected = answers(model, batch, by_torch)
    assert [name for name, value in expected.items() if value is None] == ["intention_table.log_deviation"]
    torch.testing.assert_close(answers(model, batch, compiled), expected, rtol=1e-10, atol=1e-10)


def test_single_precision_rounds_as_it_should() -> None:
    model = network(THREE_LEVELS, (32, 16, 3), 2, torch.float32)
    told = answers(model, 2, compiled)
    exact = answers(deepcopy(model).double(), 2, by_torch)
    for name, value in exact.items():
        if value is None:
            assert told[name] is None
            continue
        torch.testing.assert_close(told[name], value.float(), rtol=0, atol=1e-5 * max(1.0, value.abs().max().item()), msg=name)


def test_sequences_on_threads_are_the_same_sequences_and_bit_for_bit_every_time() -> None:
    model = network(THREE_LEVELS, (32, 16, 1), 5, torch.float32)
    first, again = (answers(model, 5, compiled) for _ in range(2))
    torch.set_num_threads(1)
    alone = answers(model, 5, compiled)
    for name, value in first.items():
        if value is not None:
            assert torch.equal(value, again[name]), name
    torch.testing.assert_close(first, alone, rtol=1e-4, atol=1e-5)


@pytest.mark.skipif(not is_compiled(), reason="this processor has no bfloat16 that is compiled for")
def test_bfloat16_rounds_no_more_than_it_does_in_torch() -> None:
    config = replace(THREE_LEVELS, keypoints=3, seen_channels=4)
    model = network(config, (32, 16, 3), 3, torch.float32)
    exact = answers(deepcopy(model).double(), 3, by_torch)
    told = answers(model, 3, lambda model, start: compiled(model, start, torch.bfloat16))
    rounded = answers(model, 3, lambda model, start: by_torch(model, start, torch.bfloat16))
    for name, value in exact.items():
        if value is not None and "to_keypoints.bias" not in name:  # which has no effect: the gradient is noise
            errors = [(each[name] - value).norm() / value.norm() for each in (told, rounded)]
            assert errors[0] < 2 * errors[1] + 1e-3, name
    assert (told["pixels"] - exact["pixels"]).norm() > 1e-4 * exact["pixels"].norm(), "it is bfloat16 that was taken"


def test_frozen_weights_get_no_gradient_and_the_intention_the_same() -> None:
    model = network(ModelConfig.tiny(), (16, 16, 1), 3, torch.float64)
    expected = answers(model, 3, by_torch)
    for name, value in model.named_parameters():
        value.requires_grad_(name.startswith("intention_table."))
    told = answers(model, 3, compiled)
    kept = {name for name, value in model.named_parameters() if not value.requires_grad}
    assert all(told.pop(name) is None and expected.pop(name) is not None for name in kept)
    torch.testing.assert_close(told, expected, rtol=1e-10, atol=1e-10)


CHANGES: dict[str, Callable[[PDVMRNN], object]] = {
    "in place": lambda model: model.to_codes.weight.mul_(0.5),
    "in its data": lambda model: setattr(model.to_codes.weight, "data", 0.5 * model.to_codes.weight),
    "loaded": lambda model: model.load_state_dict({name: 0.5 * value for name, value in model.state_dict().items()}),
}


@pytest.mark.parametrize("how", CHANGES)
def test_what_is_kept_of_frozen_weights_is_not_believed_once_they_change(how: str) -> None:
    model = network(ModelConfig.tiny(), (16, 16, 1), 2, torch.float32).requires_grad_(False)
    start = start_of(model, 2)
    before = compiled(model, start)
    with torch.no_grad():
        CHANGES[how](model)
    after = compiled(model, start)
    assert (after.log_codes - before.log_codes).abs().max() > 1e-3
    torch.testing.assert_close(after.log_codes, by_torch(model, start).log_codes, rtol=1e-4, atol=1e-4)


def test_without_gradients_the_same_is_imagined_in_two_steps_memory() -> None:
    model = network(THREE_LEVELS, (32, 16, 1), 2, torch.float64)
    with torch.no_grad():
        bare, told = by_torch(model, start_of(model, 2)), compiled(model, start_of(model, 2))
    torch.testing.assert_close(told.pixels, bare.pixels, rtol=1e-10, atol=1e-10)
    torch.testing.assert_close(told.log_codes, bare.log_codes, rtol=1e-10, atol=1e-10)
    assert not told.pixels.requires_grad


@pytest.mark.parametrize("where", ["weights", "start"])
def test_what_is_not_finite_comes_to_light(where: str) -> None:
    model = network(ModelConfig.tiny(), (16, 16, 1), 1, torch.float32)
    start = start_of(model, 1)
    with torch.no_grad():
        (model.to_codes.weight if where == "weights" else start[0])[0, 0] = torch.nan
        told = compiled(model, start)
    assert not told.pixels.isfinite().any()
    assert not told.log_codes.isfinite().any()


def test_once_the_loops_are_compiled_neither_plans_nor_training_compile_more() -> None:
    from preimage.fast.__main__ import compile_loops
    from preimage.fast.compiled import go_backward, go_forward

    compile_loops()
    compiled_for = [*go_forward.signatures, *go_backward.signatures]
    model = network(THREE_LEVELS, (32, 16, 1), 3, torch.float32)
    for dtype in (torch.float32, torch.bfloat16):
        if serves(model, start_of(model, 3), dtype):
            answers(model, 3, lambda model, start, dtype=dtype: compiled(model, start, dtype))
            with torch.no_grad():
                compiled(model, start_of(model, 3), dtype)
    assert [*go_forward.signatures, *go_backward.signatures] == compiled_for


def test_the_first_training_on_a_machine_gives_the_weights_of_the_second(tmp_path: Path) -> None:
    """Where nothing was compiled yet, in a cache of its own; code just compiled rounds otherwise than the same read from there."""
    data = tmp_path / "data"
    data.mkdir()
    write_files([make_demonstration(seed, size=(16, 16, 1)) for seed in range(3)], data, task="move")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "OMP_NUM_THREADS": "1"}
    words = [sys.executable, "-m", "preimage", "train", str(data), "--size", "tiny", "--updates", "3", "--precision", "float32", "--out"]
    for name in ("first", "second"):
        subprocess.run([*words, str(tmp_path / name)], env=environment, check=True, capture_output=True)
    first, second = ((tmp_path / name / WEIGHTS).read_bytes() for name in ("first", "second"))
    assert first == second
    assert list((tmp_path / "cache").rglob("compiled-*"))


def test_what_was_compiled_is_not_compiled_again(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[object] = []
    monkeypatch.setattr("subprocess.run", lambda words, **more: started.append(words))
    monkeypatch.setattr("preimage.fast.ahead.mark", lambda: Path(__file__))
    compile_ahead.__wrapped__()
    assert not started
    monkeypatch.setattr("preimage.fast.ahead.mark", lambda: Path(__file__).with_name("not there"))
    compile_ahead.__wrapped__()
    assert started == [[sys.executable, "-m", "preimage.fast"]]


def test_where_no_folder_can_be_written_to_nothing_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    from numba.core import caching

    assert can_cache()
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    assert not can_cache()


def test_code_that_was_compiled_before_any_of_its_sources_changed_is_compiled_again(tmp_path: Path) -> None:
    sources, compiled = [tmp_path / "kernel.py", tmp_path / "loop.py"], [tmp_path / "loop.nbi", tmp_path / "loop.nbc"]
    for age, path in enumerate([sources[1], *compiled, sources[0]]):
        path.touch()
        os.utime(path, (1e9 + age, 1e9 + age))
    forget_outdated(sources[1:], compiled)
    assert all(path.exists() for path in compiled)
    forget_outdated(sources, compiled)
    assert not any(path.exists() for path in compiled)


def test_a_training_goes_the_same_way(monkeypatch: pytest.MonkeyPatch) -> None:
    demonstrations, config = [make_demonstration(seed, size=(16, 16, 1)) for seed in range(3)], TrainConfig(updates=3, precision="float32")
    quick = train(demonstrations, ModelConfig.tiny(), config=config)
    monkeypatch.setattr("preimage.network.engines.ENGINES", [])
    slow, begun = (train(demonstrations, ModelConfig.tiny(), config=each) for each in (config, learning_nothing(config)))
    assert 0 < apart(quick, slow, begun=begun) < 1e-4


def test_what_it_cannot_or_need_not_do_is_left_to_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    tiny, small, paper = (PDVMRNN(config, SMALL) for config in (ModelConfig.tiny(), ModelConfig.small(), ModelConfig.paper()))
    start = start_of(tiny, 1)
    assert serves(small, start, torch.float32)
    assert not serves(paper, start, torch.float32)
    assert not serves(small, start, torch.float64)
    assert not serves(small, (start[0].double(), start[1]), None)
    for natively, by_us in ((True, True), (True, False), (False, False)):
        monkeypatch.setattr("preimage.compute.precision.computes_bfloat16", lambda device, answer=natively: answer)
        monkeypatch.setattr("preimage.fast.bfloat16.is_compiled", lambda answer=by_us: answer)
        assert serves(small, start, torch.bfloat16) == (by_us or not natively), "emulated it is slower than float32"
        assert serves(tiny, start, torch.bfloat16)
    assert imagined(0, start) is start
