"""The paper's network and its training in plain torch: the readable form of :mod:`flora_lab.train.fused_step`.

Nothing runs it but the tests, which hold the two to the same gradients and the same weights after an epoch.
"""

from __future__ import annotations

from typing import Self

import numpy as np
import torch
from torch import nn

from flora_common.arrays import Float32Array, IntArray
from flora_lab.simulator.lstm_cell import Dense, LstmCell
from flora_lab.simulator.paper import CELLS, COORDINATES, INPUTS, PaperNetwork
from flora_lab.train.fused_step import BETA_1, BETA_2, EPSILON, LEARNING_RATE


class ReferenceNetwork(nn.Module):
    """LSTM 19 to 50, dense 50 to 18, from the zero state at each row."""

    def __init__(self) -> None:
        super().__init__()
        self.lstm = nn.LSTM(INPUTS, CELLS, batch_first=True)
        self.dense = nn.Linear(CELLS, COORDINATES)
        # PyTorch has two bias vectors where the paper's Keras has one; trained both, it would move twice as fast.
        self.lstm.bias_hh_l0.requires_grad_(False)

    @classmethod
    def of(cls, network: PaperNetwork) -> Self:
        """With these weights."""
        made = cls()
        values = {
            "lstm.weight_ih_l0": network.cell.w_ih,
            "lstm.weight_hh_l0": network.cell.w_hh,
            "lstm.bias_ih_l0": network.cell.b,
            "lstm.bias_hh_l0": np.zeros_like(network.cell.b),
            "dense.weight": network.dense.w,
            "dense.bias": network.dense.b,
        }
        made.load_state_dict({name: torch.from_numpy(value.copy()) for name, value in values.items()})
        return made

    def network(self) -> PaperNetwork:
        """The weights as they are now."""
        values = {name: value.numpy().astype(np.float32) for name, value in self.state_dict().items()}
        bias = values["lstm.bias_ih_l0"] + values["lstm.bias_hh_l0"]
        cell = LstmCell(values["lstm.weight_ih_l0"], values["lstm.weight_hh_l0"], bias)
        return PaperNetwork(cell, Dense.of(values["dense.weight"], values["dense.bias"]))

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Shape (n, 19) to (n, 18): n sequences of length 1."""
        hidden, _ = self.lstm(inputs[:, None])
        outputs: torch.Tensor = self.dense(hidden[:, 0])
        return outputs


def adam(network: ReferenceNetwork) -> torch.optim.Optimizer:
    """The optimiser, at its start."""
    trained = [p for p in network.parameters() if p.requires_grad]
    return torch.optim.Adam(trained, lr=LEARNING_RATE, betas=(BETA_1, BETA_2), eps=EPSILON)


def train_epoch(
    network: ReferenceNetwork,
    optimiser: torch.optim.Optimizer,
    inputs: Float32Array,
    outputs: Float32Array,
    order: IntArray,
    batch: int,
) -> float:
    """As :func:`flora_lab.train.fused_step.train_epoch`; returns the mean absolute error."""
    kind = network.dense.weight.dtype
    x, t = torch.from_numpy(inputs[order]).to(kind), torch.from_numpy(outputs[order]).to(kind)
    total = 0.0
    for start in range(0, len(order), batch):
        optimiser.zero_grad()
        predicted = network(x[start : start + batch])
        loss = nn.functional.l1_loss(predicted, t[start : start + batch])
        torch.autograd.backward(loss)
        optimiser.step()
        total += float(loss.detach()) * len(predicted)
    return total / len(order)
