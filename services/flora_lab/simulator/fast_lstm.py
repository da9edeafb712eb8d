"""One step of a small LSTM and the layer behind it, compiled, for one plant.

Hochreiter and Schmidhuber 1997, with the forget gate of Gers et al. 2000. All is float32 but the memory, which is kept
in float64. Sums go over the inputs in their order, one by one, for several gates at once: the result does not depend on
the width of a processor's registers.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.simulator.fast_functions import inlined
from flora_lab.simulator.fast_scratch import scratch
from flora_lab.simulator.fast_tanh import fast_tanh

MOST_CELLS: Final = 128
_MOST_GATES: Final = 4 * MOST_CELLS


@inlined
def _add_product(sums: Array, x: Array, weights: Array) -> None:
    """Add ``x[0] * weights[0]``, then ``x[1] * weights[1]`` and so on: eight at a time, to fetch sums less often."""
    rows = x.shape[0]
    eights = rows & -8
    for i in range(0, eights, 8):
        x0, x1, x2, x3, x4, x5, x6, x7 = x[i], x[i + 1], x[i + 2], x[i + 3], x[i + 4], x[i + 5], x[i + 6], x[i + 7]
        for j in range(sums.shape[0]):
            total = sums[j] + x0 * weights[i, j]
            total += x1 * weights[i + 1, j]
            total += x2 * weights[i + 2, j]
            total += x3 * weights[i + 3, j]
            total += x4 * weights[i + 4, j]
            total += x5 * weights[i + 5, j]
            total += x6 * weights[i + 6, j]
            sums[j] = total + x7 * weights[i + 7, j]
    for i in range(eights, rows):
        for j in range(sums.shape[0]):
            sums[j] += x[i] * weights[i, j]


@inlined
def lstm_step(
    inputs: Array, memory: Array, w_ih: Array, w_hh: Array, b: Array, w_out: Array, b_out: Array, out: Array
) -> None:
    """One step of one member: h and c in ``memory``, outputs in ``out``; gates in the order i, f, g, o."""
    hidden = memory.shape[1]
    gates, h = scratch(np.float32, _MOST_GATES)[: 4 * hidden], scratch(np.float32, MOST_CELLS)[:hidden]
    for j in range(4 * hidden):
        gates[j] = b[j]
    for j in range(hidden):
        h[j] = memory[0, j]
    _add_product(gates, inputs, w_ih)
    _add_product(gates, h, w_hh)
    half = np.float32(0.5)
    for j in range(hidden):
        i_gate = half + half * fast_tanh(half * gates[j])
        f_gate = half + half * fast_tanh(half * gates[hidden + j])
        o_gate = half + half * fast_tanh(half * gates[3 * hidden + j])
        c = f_gate * np.float32(memory[1, j]) + i_gate * fast_tanh(gates[2 * hidden + j])
        h[j] = o_gate * fast_tanh(c)
        memory[0, j], memory[1, j] = h[j], c
    for j in range(out.shape[0]):
        out[j] = b_out[j]
    _add_product(out, h, w_out)
