"""The operations that are counted are those that a network needs, and a short run gives every figure."""

import pytest
import torch

from preimage.compute.devices import CPU
from preimage.compute.precision import Resolved
from preimage.evaluation import bench
from preimage.evaluation.bench import PEER, PEER_CONFIG, Work, flops_of_step, limit_gflops, timed_training
from preimage.network.config import ModelConfig, Sensors
from preimage.network.linear import Conv, Linear
from preimage.network.pdvmrnn import PDVMRNN
from preimage.presets import TrainOptions
from preimage.report.tables import speed_table

SENSORS = Sensors(16, 16, 1, ("a", "b"), (-1.0, -1.0), (1.0, 1.0))


def test_operations_are_counted_as_by_hand() -> None:
    model = PDVMRNN(ModelConfig.tiny(), SENSORS)
    by_hand, seen = 0, []
    for layer in model.modules():
        if isinstance(layer, Conv | Linear):
            value = layer.value
            layer.value = lambda inputs, *given, value=value: seen.append((inputs.shape, given[0])) or value(inputs, *given)
    counted = flops_of_step(model)
    for shape, weight in seen:
        places = shape[-1] * shape[-2] if weight.dim() == 4 else torch.Size(shape[:-1]).numel()
        by_hand += 2 * weight.numel() * places
    by_hand += 2 * model.intention_table.onto_states.numel()  # the intention is thrown onto the initial states once
    assert counted == by_hand


def test_the_peers_network_has_about_as_many_weights() -> None:
    model = PDVMRNN(PEER_CONFIG, PEER)
    weights = sum(p.numel() for name, p in model.named_parameters() if not name.startswith(("intention_table.", "pixel_bias", "shared.")))
    assert weights == pytest.approx(42_000, rel=0.15)


def test_training_is_timed_beside_the_limit() -> None:
    limits = {"fp32": limit_gflops(CPU, torch.float32)}
    said: list[str] = []
    timed = timed_training(Work(ModelConfig.tiny(), SENSORS, batch=2, steps=3, precision="float32"), CPU, limits, said.append, "tiny")
    assert 0 < timed["fraction_of_limit"] < 1
    assert timed["seq_steps_per_s"] > 0
    assert said == [f"train tiny: {timed['seq_steps_per_s']} sequence steps a second, {timed['fraction_of_limit']:.0%} of the limit"]


@pytest.mark.parametrize(("taken", "other"), [("bfloat16", "float32"), ("float32", "bfloat16")])
def test_both_precisions_are_shown_and_the_one_that_is_taken_bears_the_plain_name(monkeypatch, taken: Resolved, other: Resolved) -> None:
    monkeypatch.setattr(bench, "computes_bfloat16", lambda _device: taken == "bfloat16")
    works = bench.works_at(taken, other, CPU, quick=False)
    assert {name: work.precision for name, work in works.items() if name != "peer"} == {
        "small": taken,
        f"small, {other}": other,
        "paper": taken,
        f"paper, {other}": other,
    }
    assert works["paper"].steps == 60
    assert works[f"paper, {other}"].steps == (6 if other == "bfloat16" else 60), "what is emulated is cut short"
    assert set(bench.works_at(taken, other, CPU, quick=True)) == {"small", f"small, {other}", "peer"}


def test_long_work_is_timed_once_and_short_work_as_often_as_asked(monkeypatch) -> None:
    now = 0.0

    def lasting(seconds: float):
        nonlocal now
        now += seconds
        return seconds

    monkeypatch.setattr(bench.time, "perf_counter", lambda: now)
    assert len(bench.repeated(lambda: lasting(bench.AT_MOST_S), 6)) == 1
    assert len(bench.repeated(lambda: lasting(0.4 * bench.AT_MOST_S), 6)) == 2
    assert len(bench.repeated(lambda: lasting(bench.AT_MOST_S / 100), 6)) == 6


def test_a_start_is_timed_in_a_python_of_its_own() -> None:
    assert 0 < bench.seconds_of_start(("-c", "pass")) < 5


def test_a_whole_training_says_what_it_was_extrapolated_from(monkeypatch, demonstrations) -> None:
    monkeypatch.setattr(bench, "read_settings", lambda kind, *_: TrainOptions() if kind is TrainOptions else ModelConfig.tiny())
    said: list[str] = []
    timed = bench.whole_training(demonstrations, CPU, "float32", said.append)
    assert timed["updates"] == TrainOptions().updates
    by_hand = timed["updates"] * timed["s_per_update"] / 60
    assert timed["minutes_extrapolated"] == pytest.approx(by_hand, abs=0.1)  # both are rounded
    assert f"extrapolated from {timed['measured_updates']} of its {timed['updates']} updates" in said[0]


def test_the_page_of_results_tells_of_a_whole_training_and_of_starting() -> None:
    whole = {"task": "reach", "precision": "float32", "updates": 1400, "measured_updates": 5, "minutes_extrapolated": 12.5}
    start_up = {"import_s": 0.02, "import_all_s": 2.5, "help_s": 0.05}
    page = speed_table([{"device": "cpu", "threads": 2, "whole_training": whole, "start_up": start_up}])
    assert "| train reach, whole | 12.5 minutes (extrapolated from 5 of 1400 updates), float32 |" in page
    assert "| start | import 0.02 s, all names 2.5 s, --help 0.05 s |" in page
