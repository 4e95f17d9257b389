"""Laws of the cells: they are an LSTM's equations, and their gradients are those of plain autograd."""

import pytest
import torch
from torch import nn

from preimage.network.cells import LSTM, ConvLSTM, Lateral, depth_to_space, expected_positions, space_to_depth
from preimage.network.linear import Conv, Linear


def cell_of_torch(linear: Linear) -> nn.LSTMCell:
    """torch's LSTM cell with the weights of ours: its gates are ordered input, forget, candidate, output, its input comes first."""
    units = len(linear.weight) // 4
    cell = nn.LSTMCell(linear.in_features - units, units).double()
    order = torch.cat([torch.arange(units) + units * part for part in (0, 1, 3, 2)])
    with torch.no_grad():
        cell.weight_ih.copy_(linear.weight[order, :-units])
        cell.weight_hh.copy_(linear.weight[order, -units:])
        cell.bias_ih.copy_(linear.bias[order])
        cell.bias_hh.zero_()
    return cell


def test_lstm_is_torchs_lstm_cell() -> None:
    ours = LSTM(inputs=3, units=5).double()
    inputs, hidden, cell = (torch.randn(4, size, dtype=torch.float64) for size in (3, 5, 5))
    expected = cell_of_torch(ours.gates)(inputs, (hidden, cell))
    torch.testing.assert_close(ours.at(torch.float64)([inputs], (hidden, cell)), expected)


def test_a_1x1_conv_lstm_is_torchs_lstm_cell_at_every_place() -> None:
    ours = ConvLSTM(inputs=3, channels=5, kernel=1).double()
    inputs, hidden, cell = (torch.randn(2, size, 4, 6, dtype=torch.float64) for size in (3, 5, 5))
    linear = Linear(8, 20).double()
    with torch.no_grad():
        linear.weight.copy_(ours.gates.weight[:, :, 0, 0])
        linear.bias.copy_(ours.gates.bias)
    places = [values.permute(0, 2, 3, 1).reshape(-1, values.shape[1]) for values in (inputs, hidden, cell)]
    expected = cell_of_torch(linear)(places[0], (places[1], places[2]))
    found = ours.at(torch.float64)([inputs], (hidden, cell))
    for ours_of, expected_of in zip(found, expected, strict=True):
        torch.testing.assert_close(ours_of.permute(0, 2, 3, 1).reshape(-1, 5), expected_of)


def plain(layer: Linear | Conv, gates: torch.Tensor, cell: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    input_gate, forget_gate, output_gate, candidate = gates.chunk(4, dim=1)
    cell = torch.sigmoid(forget_gate) * cell + torch.sigmoid(input_gate) * torch.tanh(candidate)
    return torch.sigmoid(output_gate) * torch.tanh(cell), cell


@pytest.mark.parametrize("spatial", [(), (4, 6)])
def test_gradients_over_several_steps_equal_those_of_plain_autograd(spatial: tuple[int, ...]) -> None:
    ours = (ConvLSTM(inputs=3, channels=5) if spatial else LSTM(inputs=3, units=5)).double()
    inputs, hidden, cell = (torch.randn(2, size, *spatial, dtype=torch.float64, requires_grad=True) for size in (3, 5, 5))
    leaves = [inputs, hidden, cell, ours.gates.weight, ours.gates.bias]

    def run(fast: bool) -> list[torch.Tensor]:
        step, state, total = ours.at(torch.float64, num_steps=3), (hidden, cell), torch.zeros((), dtype=torch.float64)
        for number in range(3):
            fed = inputs * (number + 1)
            if fast:
                state = step([fed], state)
            else:
                gates = type(ours.gates).__base__.forward(ours.gates, torch.cat([fed, state[0]], dim=1))
                state = plain(ours.gates, gates, state[1])
            total = total + (state[0] * (number - 1.5)).sum() + state[1].square().sum()
        return list(torch.autograd.grad(total, leaves))

    for fast, slow in zip(run(fast=True), run(fast=False), strict=True):
        torch.testing.assert_close(fast, slow)


def test_weights_that_are_frozen_get_no_gradient_but_inputs_do() -> None:
    layer = Conv(3, 4).requires_grad_(False)
    inputs = torch.randn(1, 3, 4, 4, requires_grad=True)
    (gradient,) = torch.autograd.grad(layer.at(torch.float32)(inputs).sum(), inputs)
    assert gradient.abs().sum() > 0
    assert layer.weight.grad is None


def test_a_step_to_which_nothing_comes_back_adds_nothing_to_the_weights() -> None:
    layer, inputs = Linear(3, 4).double(), torch.randn(3, 2, 3, dtype=torch.float64)
    step = layer.at(torch.float64, num_steps=3)
    _, wanted, _ = (step(each) for each in inputs)
    (gradient,) = torch.autograd.grad(wanted.sum(), layer.weight)
    torch.testing.assert_close(gradient, inputs[1].sum(0).expand(4, 3))


def test_large_matrices_are_multiplied_the_same_in_another_order() -> None:
    layer, inputs = Linear(1024, 1024), torch.randn(4, 1024, dtype=torch.bfloat16, requires_grad=True)
    ours = layer.at(torch.bfloat16)(inputs)
    plain = nn.functional.linear(inputs, layer.weight.bfloat16(), layer.bias.bfloat16())
    torch.testing.assert_close(ours, plain)
    (fast,), (slow,) = (torch.autograd.grad(each.float().square().sum(), inputs) for each in (ours, plain))
    torch.testing.assert_close(fast, slow, rtol=0.02, atol=0.02)


def test_depth_to_space_undoes_space_to_depth_and_patches_stay_together() -> None:
    maps = torch.arange(2 * 3 * 4 * 6.0).view(2, 3, 4, 6)
    folded = space_to_depth(maps)
    assert folded.shape == (2, 12, 2, 3)
    assert set(folded[0, :, 0, 0].tolist()) == set(maps[0, :, :2, :2].flatten().tolist())
    torch.testing.assert_close(depth_to_space(folded), maps)


@pytest.mark.parametrize(("right", "down"), [(0, 0), (3, 0), (0, 2), (4, 3)])
def test_a_keypoint_moves_with_what_it_points_at(right: int, down: int) -> None:
    heat = torch.zeros(2, 9, 11, 1, dtype=torch.float64)
    heat[0, 1:4, 2:5] = heat[1, 1 + down : 4 + down, 2 + right : 5 + right] = 50.0
    before, after = expected_positions(heat)
    torch.testing.assert_close(after - before, torch.tensor([2 / 10 * right, 2 / 8 * down], dtype=torch.float64))


def test_what_the_motors_see_ends_with_the_places_of_the_keypoints() -> None:
    lateral = Lateral(channels=6, units=5, size=(8, 8), grid=(4, 4), lateral=2, seen=3, keypoints=2).double()
    maps = torch.randn(2, 6, 8, 8, dtype=torch.float64)
    seen = lateral.to_motor(torch.float64)(maps)
    assert seen.shape == (2, 3 * 16 + 2 * 2)
    assert lateral.to_keypoints is not None
    heat = 10 * lateral.to_keypoints(maps.permute(0, 2, 3, 1))
    torch.testing.assert_close(seen[:, -4:], expected_positions(heat))
