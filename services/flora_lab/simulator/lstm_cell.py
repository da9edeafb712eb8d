"""An LSTM cell, so that a trained network runs where no learning library is installed.

Hochreiter and Schmidhuber 1997, with the forget gate of Gers et al. 2000; rows of the weights in PyTorch's order: input
gate i, forget gate f, candidate g, output gate o, of H rows each.

A row's result is the same to the last bit whatever other rows are computed with it. BLAS does not give that: the order
in which it sums depends on the number of rows, and on some processors on a row's place among them. So products are
summed here, in the order of the inputs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from flora_common.arrays import Float32Array


def rows_times(rows: Float32Array, weights: Float32Array) -> Float32Array:
    """Matrix product of which each row depends on its own row alone.

    Args:
        rows: shape (batch, n), float32.
        weights: shape (n, m), float32, C-contiguous.

    Returns:
        Shape (batch, m).
    """
    product = np.zeros((len(rows), weights.shape[1]), dtype=np.float32)
    for column, row in zip(rows.T, weights, strict=True):
        product += column[:, None] * row
    return product


@dataclass(frozen=True, slots=True)
class LstmState:
    """What a cell remembers of each row.

    Attributes:
        hidden, cell: h and c, shape (batch, H), float32.
    """

    hidden: Float32Array
    cell: Float32Array


class LstmCell:
    """One layer of H memory cells for I inputs.

    Args:
        w_ih: shape (4 H, I), acts on the inputs.
        w_hh: shape (4 H, H), acts on the hidden state of the step before.
        b: shape (4 H,); PyTorch's two bias vectors added up.

    Attributes:
        w_ih, w_hh, b: as given, float32.
        inputs, cells: I and H.

    Raises:
        ValueError: shapes that do not fit together.
    """

    def __init__(self, w_ih: npt.ArrayLike, w_hh: npt.ArrayLike, b: npt.ArrayLike) -> None:
        self.w_ih, self.w_hh, self.b = (np.ascontiguousarray(w, dtype=np.float32) for w in (w_ih, w_hh, b))
        self.cells, self.inputs = len(self.b) // 4, self.w_ih.shape[-1]
        rows = 4 * self.cells
        if (self.w_ih.shape, self.w_hh.shape, self.b.shape) != ((rows, self.inputs), (rows, self.cells), (rows,)):
            raise ValueError(f"shapes {self.w_ih.shape}, {self.w_hh.shape} and {self.b.shape} are of no LSTM cell")
        self._from_inputs = np.ascontiguousarray(self.w_ih.T)
        self._from_hidden = np.ascontiguousarray(self.w_hh.T)
        # sigmoid(x) = (1 + tanh(x / 2)) / 2: one tanh for all four gates, and no overflow
        self._inner = np.repeat(np.array([0.5, 0.5, 1.0, 0.5], dtype=np.float32), self.cells)

    def zero_state(self, batch: int) -> LstmState:
        """Nothing remembered."""
        zeros = np.zeros((batch, self.cells), dtype=np.float32)
        return LstmState(zeros, zeros)

    def step(self, inputs: Float32Array, state: LstmState | None = None) -> LstmState:
        """c' = f c + i g and h' = o tanh(c').

        Args:
            inputs: shape (batch, I), float32.
            state: before the step. None is the zero state, in which ``w_hh`` and the forget gate have no effect and
                cost nothing.

        Returns:
            The state after the step; its ``hidden`` is the layer's output.
        """
        gates = rows_times(inputs, self._from_inputs) + self.b
        if state is not None:
            gates += rows_times(state.hidden, self._from_hidden)
        gates = np.tanh(gates * self._inner)
        i, f, g, o = np.split(gates, 4, axis=1)
        half = np.float32(0.5)
        cell = (half + half * i) * g
        if state is not None:
            cell += (half + half * f) * state.cell
        return LstmState((half + half * o) * np.tanh(cell), cell)


@dataclass(frozen=True, slots=True)
class Dense:
    """A layer of M linear outputs.

    Attributes:
        w: shape (M, H), float32.
        b: shape (M,), float32.
    """

    w: Float32Array
    b: Float32Array

    @classmethod
    def of(cls, w: npt.ArrayLike, b: npt.ArrayLike) -> Self:
        """From arrays of any kind.

        Raises:
            ValueError: shapes that do not fit together.
        """
        layer = cls(np.ascontiguousarray(w, dtype=np.float32), np.ascontiguousarray(b, dtype=np.float32))
        if layer.w.ndim != 2 or layer.b.shape != layer.w.shape[:1]:
            raise ValueError(f"shapes {layer.w.shape} and {layer.b.shape} are of no linear layer")
        return layer

    def __call__(self, hidden: Float32Array) -> Float32Array:
        """Shape (batch, H) to (batch, M)."""
        return rows_times(hidden, np.ascontiguousarray(self.w.T)) + self.b
