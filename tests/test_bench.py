"""The operations that are counted are those that a network needs, and a short run gives every figure."""

import pytest
import torch

from preimage.evaluation.bench import PEER, PEER_CONFIG, Work, flops_of_step, limit_gflops, timed_training
from preimage.network.config import ModelConfig, Sensors
from preimage.network.linear import Conv, Linear
from preimage.network.pdvmrnn import PDVMRNN

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
    place = torch.device("cpu")
    limits = {"fp32": limit_gflops(place, torch.float32)}
    told = timed_training(Work(ModelConfig.tiny(), SENSORS, batch=2, steps=3, dtype=torch.float32), place, limits, lambda _: None, "tiny")
    assert 0 < told["fraction_of_limit"] < 1
    assert told["seq_steps_per_s"] > 0
