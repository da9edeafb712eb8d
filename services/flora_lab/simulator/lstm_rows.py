"""One step of a small LSTM and the layer behind it, for four plants at once.

A plant's network is small, and its weights take longer to fetch than to multiply: what is fetched here is used four
times. Each plant's sums go on in the order of :func:`flora_lab.simulator.fast_lstm.lstm_step`: it comes to the same
bits there and here, wherever it stands and whatever stands beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from flora_common.arrays import Array
from flora_lab.simulator.fast_product import ROWS, VECTOR, product_by_16, product_by_32
from flora_lab.simulator.fast_scratch import row_of
from flora_lab.simulator.fast_tanh import fast_tanh
from flora_lab.simulator.rod import jit

SAID: Final = VECTOR
"""Outputs that there is room for."""
GATES: Final = 4
_LINE_BYTES: Final = 64
_HALF: Final = np.float32(0.5)


class RowWeights(NamedTuple):
    """Networks of some members, float32.

    Attributes:
        gates: from inputs and hidden state to the gates i, f, g and o, shape (members, inputs + cells, 4, cells rounded
            up).
        b: shape (members, 4, cells rounded up).
        w_out, b_out: shapes (members, cells, :data:`SAID`) and (members, :data:`SAID`).
    """

    gates: Array
    b: Array
    w_out: Array
    b_out: Array


def lined_up(shape: tuple[int, ...]) -> Array:
    """Zeros, float32, that begin where a line of the cache does: loads that cross lines take twice as long.

    Rows that nobody writes or reads cost nothing: the system gives them out when they are first used.
    """
    size = int(np.prod(shape))
    room = np.zeros(size + _LINE_BYTES // 4, dtype=np.float32)
    first = -room.ctypes.data % _LINE_BYTES // 4
    return room[first : first + size].reshape(shape)


def row_weights(weights: Mapping[str, Array]) -> RowWeights:
    """From those of :class:`flora_lab.simulator.neural_law.NeuralLaw`."""
    members, inputs = weights["w_ih"].shape[:2]
    cells, outputs = weights["w_out"].shape[1:]
    room = -(-cells // VECTOR) * VECTOR
    made = RowWeights(
        lined_up((members, inputs + cells, GATES, room)),
        lined_up((members, GATES, room)),
        lined_up((members, cells, SAID)),
        lined_up((members, SAID)),
    )
    made.gates[:, :inputs, :, :cells] = weights["w_ih"].reshape(members, inputs, GATES, cells)
    made.gates[:, inputs:, :, :cells] = weights["w_hh"].reshape(members, cells, GATES, cells)
    made.b[:, :, :cells] = weights["b"].reshape(members, GATES, cells)
    made.w_out[:, :, :outputs], made.b_out[:, :outputs] = weights["w_out"], weights["b_out"]
    return made


@jit
def lstm_rows(
    first: int,
    end: int,
    m: int,
    weights: RowWeights,
    inputs: Array,
    hidden: Array,
    cell: Array,
    gates: Array,
    said: Array,
) -> None:
    """One step of member ``m`` for the plants in the rows from ``first`` to before ``end``, rounded up to four.

    Args:
        first, end, m: see there.
        weights: of all members.
        inputs: shape (rows, inputs).
        hidden, cell: changed, shape (rows, members, cells).
        gates: room for those of four plants, shape (ROWS, 4, cells rounded up).
        said: outputs, shape (rows from ``first`` on, SAID), written.
    """
    told, members, cells = inputs.shape[1], hidden.shape[1], hidden.shape[2]
    w_gates, b, w_out, b_out = weights.gates, weights.b, weights.w_out, weights.b_out
    width, stride = b.shape[1] * b.shape[2], members * cells
    for row in range(first, end, ROWS):
        at = (row * members + m) * cells
        product_by_32(
            inputs,
            row * told,
            told,
            told,
            hidden,
            at,
            stride,
            cells,
            w_gates,
            m * (told + cells) * width,
            b,
            m * width,
            width,
            gates,
            0,
            width,
        )
        for r in range(ROWS):
            of_four, h, memory = row_of(gates, r), row_of(row_of(hidden, row + r), m), row_of(row_of(cell, row + r), m)
            for j in range(cells):
                i_gate = _HALF + _HALF * fast_tanh(_HALF * of_four[0, j])
                f_gate = _HALF + _HALF * fast_tanh(_HALF * of_four[1, j])
                o_gate = _HALF + _HALF * fast_tanh(_HALF * of_four[3, j])
                c = f_gate * memory[j] + i_gate * fast_tanh(of_four[2, j])
                memory[j] = c
                h[j] = o_gate * fast_tanh(c)
        product_by_16(
            inputs,
            0,
            0,
            0,
            hidden,
            at,
            stride,
            cells,
            w_out,
            m * cells * SAID,
            b_out,
            m * SAID,
            SAID,
            said,
            (row - first) * SAID,
            SAID,
        )
