"""One time step of one layer: an LSTM or ConvLSTM fed from below, from above, from the side and from itself.

Both cells take what flows in as already projected inputs and return the new hidden and cell state.

>>> import torch
>>> cell = LSTM(inputs=3, units=5)
>>> cell([torch.zeros(2, 3)], (torch.zeros(2, 5), torch.zeros(2, 5)))[0].shape
torch.Size([2, 5])
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

State = tuple[Tensor, Tensor]
"""Hidden state h and cell state c of one layer, each (B, units) or (B, channels, height, width)."""


def gate(gates: Tensor, cell: Tensor) -> State:
    """The LSTM equations after the linear part: gates hold input, forget, output and candidate, stacked along dimension 1."""
    admit, keep, show, candidate = gates.chunk(4, dim=1)
    cell = torch.sigmoid(keep) * cell + torch.sigmoid(admit) * torch.tanh(candidate)
    return torch.sigmoid(show) * torch.tanh(cell), cell


def remember_at_first(bias: Tensor) -> None:
    """Start the forget gate open (bias 1), the others at 0, so that the intention survives the first steps of untrained weights."""
    with torch.no_grad():
        bias.zero_()
        bias[len(bias) // 4 : len(bias) // 2] = 1.0


class LSTM(nn.Module):
    """A fully connected LSTM cell over the concatenation of its inputs and its own hidden state."""

    def __init__(self, inputs: int, units: int) -> None:
        super().__init__()
        self.gates = nn.Linear(inputs + units, 4 * units)
        remember_at_first(self.gates.bias)

    def forward(self, inputs: Sequence[Tensor], state: State) -> State:
        hidden, cell = state
        return gate(self.gates(torch.cat([*inputs, hidden], dim=1)), cell)


class ConvLSTM(nn.Module):
    """A convolutional LSTM cell (Shi et al. 2015): every linear map of the LSTM is a convolution over the feature map."""

    def __init__(self, inputs: int, channels: int, kernel: int = 3) -> None:
        super().__init__()
        self.gates = nn.Conv2d(inputs + channels, 4 * channels, kernel, padding=kernel // 2)
        assert self.gates.bias is not None
        remember_at_first(self.gates.bias)

    def forward(self, inputs: Sequence[Tensor], state: State) -> State:
        hidden, cell = state
        return gate(self.gates(torch.cat([*inputs, hidden], dim=1)), cell)
