"""Laws of the network: what depends on what, Table I, and the agreement of its two ways to generate."""

from dataclasses import replace

import torch

from preimage.network.config import ModelConfig, Sensors
from preimage.network.pdvmrnn import PDVMRNN, Generated, Inputs, InputSequence

SENSORS = Sensors(16, 16, 1, ("a", "b"), (-1.0, -1.0), (1.0, 1.0))


def network(**changes) -> PDVMRNN:
    return PDVMRNN(ModelConfig.tiny(), SENSORS, num_sequences=3, seed=1, **changes).double()


def percepts(num_steps: int) -> InputSequence:
    generator = torch.Generator().manual_seed(0)
    pixels = torch.rand(3, num_steps, 1, 16, 16, generator=generator, dtype=torch.float64)
    codes = torch.randn(3, num_steps, 2, 10, generator=generator, dtype=torch.float64).softmax(-1)
    return pixels, codes


def start_of(sensed: InputSequence) -> Inputs:
    return sensed[0][:, 0], sensed[1][:, 0]


def assert_same(one: Generated, other: Generated) -> None:
    torch.testing.assert_close(one.pixels, other.pixels)
    torch.testing.assert_close(one.log_codes, other.log_codes)


def test_paper_is_table_1() -> None:
    sensors = Sensors(64, 64, 1, ("a", "b", "c", "d"), (-1.0,) * 4, (1.0,) * 4)
    model = PDVMRNN(ModelConfig.paper(), sensors)
    states = model.initial_states(model.intention_table.prior_mean(1))
    sizes = {name: tuple(hidden.shape[1:]) for name, (hidden, _) in states.items()}
    assert sizes == {
        "vision1": (40, 32, 32),
        "vision2": (80, 16, 16),
        "vision3": (80, 8, 8),
        "motor1": (1024,),
        "motor2": (1024,),
        "motor3": (16,),
        "top": (12, 4, 4),
    }
    with torch.no_grad():
        codes = torch.full((1, 4, 10), 0.1)
        assert codes.numel() == 40
        generated = model.generate_closed_loop(model.intention_table.prior_mean(1), (torch.zeros(1, 1, 64, 64), codes), num_steps=1)
    assert generated.pixels.shape == (1, 1, 1, 64, 64)
    assert generated.log_codes.shape == (1, 1, 4, 10)


def test_sizes_come_from_the_data() -> None:
    sensors = Sensors(32, 48, 3, ("a", "b", "c"), (0.0,) * 3, (1.0,) * 3)
    model = PDVMRNN(ModelConfig.small(), sensors, num_sequences=2)
    start = torch.zeros(2, 3, 32, 48), torch.full((2, 3, 10), 0.1)
    generated = model.generate_closed_loop(model.intention_table.intentions(), start, num_steps=2)
    assert generated.pixels.shape == (2, 2, 3, 32, 48)
    assert generated.log_codes.shape == (2, 2, 3, 10)


def test_a_sequence_does_not_depend_on_the_others_in_the_batch() -> None:
    model, start = network(), start_of(percepts(1))
    intention = model.intention_table.intentions()
    together = model.generate_closed_loop(intention, start, num_steps=4)
    for row in range(3):
        alone = model.generate_closed_loop(intention[torch.tensor([row])], (start[0][row : row + 1], start[1][row : row + 1]), num_steps=4)
        torch.testing.assert_close(alone.pixels[0], together.pixels[row])
        torch.testing.assert_close(alone.log_codes[0], together.log_codes[row])


def test_what_is_sensed_later_changes_nothing_before() -> None:
    model, sensed = network(), percepts(5)
    before = model.generate_open_loop(model.intention_table.intentions(), sensed)
    changed = sensed[0].clone(), sensed[1].clone()
    changed[0][:, 2] += 1
    after = model.generate_open_loop(model.intention_table.intentions(), changed)
    torch.testing.assert_close(after.pixels[:, :3], before.pixels[:, :3])  # step 3 is the first to hear of step 2
    assert (after.pixels[:, 3] - before.pixels[:, 3]).abs().max() > 0


def test_a_longer_horizon_begins_as_a_shorter_one() -> None:
    model, start = network(), start_of(percepts(1))
    intention = model.intention_table.intentions()
    long, short = (model.generate_closed_loop(intention, start, num_steps=steps) for steps in (6, 3))
    torch.testing.assert_close(long.pixels[:, :3], short.pixels)


@torch.no_grad()
def test_both_loops_are_the_network_step_by_step() -> None:
    """In open loop with what was sensed before, in closed loop with what was imagined before; the first percept stands before the first."""
    model, sensed = network(), percepts(4)
    intention, step = model.intention_table.intentions(), model.at(torch.float64)
    for closed in (False, True):
        inputs, states, outputs = start_of(sensed), model.initial_states(intention), []
        for number in range(4):
            (pixels, log_codes), states = step(inputs, states)
            outputs.append((pixels, log_codes))
            inputs = (pixels, log_codes.exp()) if closed else (sensed[0][:, number], sensed[1][:, number])
        by_hand = Generated(*(torch.stack(parts, 1) for parts in zip(*outputs, strict=True)))
        at_once = model.generate_closed_loop(intention, start_of(sensed), num_steps=4) if closed else None
        assert_same(at_once or model.generate_open_loop(intention, sensed), by_hand)


def test_a_network_with_keypoints_hears_where_things_are() -> None:
    """The motors' first prediction changes with where a thing lies, through the keypoints alone, and every weight gets a gradient."""
    config = replace(ModelConfig.tiny(), keypoints=3)
    model = PDVMRNN(config, SENSORS, num_sequences=2, seed=1).double()
    start = torch.rand(2, 1, 16, 16, generator=torch.Generator().manual_seed(0)).double(), torch.full((2, 2, 10), 0.1).double()
    generated = model.generate_closed_loop(model.intention_table.intentions(), start, num_steps=4)
    (generated.pixels.square().sum() + generated.log_codes.square().sum()).backward()
    assert not [name for name, value in model.named_parameters() if value.grad is None and "log_deviation" not in name]
    assert generated.log_codes.isfinite().all()
    plain = PDVMRNN(replace(config, keypoints=0), SENSORS, num_sequences=2, seed=1)
    assert sum(p.numel() for p in model.parameters()) > sum(p.numel() for p in plain.parameters())
