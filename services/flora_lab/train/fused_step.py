"""One epoch of the paper's training as one compiled loop: forward, backward and Adam, batch after batch.

:mod:`flora_lab.train.torch_reference` is the same in a readable form, and tests hold the two together. On networks as
small as this one nearly all of a library's time goes into calling it; here a batch costs less than such a call.

Each row is a sequence of one step from the zero state, so the products with the state before it are zero: the recurrent
weights and the forget gate have no effect and an exact zero for a gradient. They are no part of the parameters here,
and no work is done for them.

All parameters lie in one float32 vector ``theta``, as do their gradients and Adam's two moments. Each block of 50 is
filled up to 64, and 18 to 32, so that loops run over whole SIMD registers::

    w   (19, 3, 64)   from each input to the gates i, g, o of each cell
    b   (3, 64)
    v   (18, 64)      from each cell to each output
    d   (32,)

What fills up is zero and stays zero: its gradient is.

The compiler may neither reorder sums nor fuse a product with a sum (no ``fastmath``), so all is plain IEEE arithmetic
in the order in which it is written, whatever the width of the machine's registers. Fusing would be a tenth faster, but
what is fused depends on what is inlined, and so on whether the code was compiled just now or comes from numba's cache:
the same training then ended in two different networks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numba
import numpy as np

from flora_common.arrays import Float32Array, IntArray
from flora_lab.simulator.fast_tanh import fast_tanh
from flora_lab.simulator.lstm_cell import Dense, LstmCell
from flora_lab.simulator.paper import CELLS, COORDINATES, INPUTS, PaperNetwork

LEARNING_RATE: Final = 1e-3
BETA_1: Final = 0.9
BETA_2: Final = 0.999
EPSILON: Final = 1e-7
"""Adam's constants: the paper's rate, and else the defaults of Keras, which it used."""


_CELLS = 64
_GATES = 3 * _CELLS
_OUTPUTS = 32
_LANES = 6
"""Rows that go into a gradient at a time: as many products per sum that is fetched and put back."""
_END_W = INPUTS * _GATES
_END_B = _END_W + _GATES
_END_V = _END_B + COORDINATES * _CELLS
SIZE: Final = _END_V + _OUTPUTS
"""Length of ``theta``."""

# Python's own numbers would make everything float64.
_f = np.float32
_ZERO, _HALF, _ONE = _f(0.0), _f(0.5), _f(1.0)
_BETA_1, _BETA_1_REST, _BETA_2, _BETA_2_REST = _f(BETA_1), _f(1.0 - BETA_1), _f(BETA_2), _f(1.0 - BETA_2)
_EPSILON = _f(EPSILON)
_jit = numba.njit(cache=True, error_model="numpy")


@dataclass(frozen=True, slots=True)
class Training:
    """Parameters while they are trained; :func:`train_epoch` changes the arrays.

    Attributes:
        theta: the parameters, shape (SIZE,).
        first, second: Adam's moments, shape (SIZE,).
    """

    theta: Float32Array
    first: Float32Array
    second: Float32Array

    @classmethod
    def of(cls, network: PaperNetwork) -> Training:
        """From a network's weights, before the first batch."""
        return cls(pack(network), np.zeros(SIZE, dtype=np.float32), np.zeros(SIZE, dtype=np.float32))


def pack(network: PaperNetwork) -> Float32Array:
    """The weights that are trained, as ``theta``."""
    theta = np.zeros(SIZE, dtype=np.float32)
    w, b, v, d = _views(theta)
    kept = (0, 2, 3)  # i, g, o of i, f, g, o
    w[:, :, :CELLS] = network.cell.w_ih.reshape(4, CELLS, INPUTS)[kept, :].transpose(2, 0, 1)
    b[:, :CELLS] = network.cell.b.reshape(4, CELLS)[kept, :]
    v[:, :CELLS] = network.dense.w
    d[:COORDINATES] = network.dense.b
    return theta


def unpack(theta: Float32Array, start: PaperNetwork) -> PaperNetwork:
    """The network of ``theta``; what is not trained is taken from ``start``."""
    w, b, v, d = _views(theta)
    w_ih, bias = start.cell.w_ih.reshape(4, CELLS, INPUTS).copy(), start.cell.b.reshape(4, CELLS).copy()
    for place, gate in enumerate((0, 2, 3)):
        w_ih[gate] = w[:, place, :CELLS].T
        bias[gate] = b[place, :CELLS]
    cell = LstmCell(w_ih.reshape(4 * CELLS, INPUTS), start.cell.w_hh, bias.reshape(-1))
    return PaperNetwork(cell, Dense.of(v[:, :CELLS], d[:COORDINATES]))


def train_epoch(
    training: Training, steps: int, inputs: Float32Array, outputs: Float32Array, order: IntArray, batch: int
) -> tuple[float, int]:
    """Go once through the rows, with a step of Adam after each batch; the last batch may be smaller.

    Args:
        training: changed in place.
        steps: of Adam up to now.
        inputs: shape (n, 19).
        outputs: shape (n, 18).
        order: rows to take, in this order.
        batch: rows per step.

    Returns:
        The mean absolute error over all rows and coordinates, each with the weights of its time; and the steps of Adam.
    """
    total, steps = _epoch(
        training.theta, training.first, training.second, steps, LEARNING_RATE, inputs, outputs, order, batch
    )
    return total / (len(order) * COORDINATES), steps


def gradient(theta: Float32Array, inputs: Float32Array, outputs: Float32Array) -> Float32Array:
    """Of the mean absolute error of these rows, as one batch, to ``theta``; shape (SIZE,)."""
    # From zero moments, the first moment after one step is a known share of the gradient; with rate 0 nothing moves.
    first, second = np.zeros(SIZE, dtype=np.float32), np.zeros(SIZE, dtype=np.float32)
    _epoch(theta.copy(), first, second, 0, 0.0, inputs, outputs, np.arange(len(inputs)), len(inputs))
    return np.asarray(first / _BETA_1_REST, dtype=np.float32)


def mean_absolute_error(theta: Float32Array, inputs: Float32Array, outputs: Float32Array, rows: IntArray) -> float:
    """Over these rows and all coordinates, the paper's loss (the equation after eq. 17), in units."""
    return float(_total_error(theta, inputs, outputs, rows)) / (len(rows) * COORDINATES)


def _views(theta: Float32Array) -> tuple[Float32Array, Float32Array, Float32Array, Float32Array]:
    return (
        theta[:_END_W].reshape(INPUTS, 3, _CELLS),
        theta[_END_W:_END_B].reshape(3, _CELLS),
        theta[_END_B:_END_V].reshape(COORDINATES, _CELLS),
        theta[_END_V:],
    )


@_jit
def _gather(inputs, outputs, order, start, count, x, t):  # type: ignore[no-untyped-def]
    """Rows of the batch, one after the other."""
    for r in range(count):
        row = order[start + r]
        for k in range(INPUTS):
            x[r, k] = inputs[row, k]
        for o in range(COORDINATES):
            t[r, o] = outputs[row, o]


@_jit
def _forward(theta, x, count, gates, squashed, h, y):  # type: ignore[no-untyped-def]
    """Gates (i, g, o of each cell), tanh of the cell, its output h, and the network's outputs y."""
    w, b = theta[:_END_W].reshape(INPUTS, _GATES), theta[_END_W:_END_B]
    v, d = theta[_END_B:_END_V].reshape(COORDINATES, _CELLS), theta[_END_V:]
    v_t = np.zeros((CELLS, _OUTPUTS), dtype=np.float32)
    for j in range(CELLS):
        for o in range(COORDINATES):
            v_t[j, o] = v[o, j]
    for r in range(count):
        for j in range(_GATES):
            total = b[j]
            for k in range(INPUTS):
                total += x[r, k] * w[k, j]
            gates[r, j] = total
        for j in range(_CELLS):
            i = _HALF + _HALF * fast_tanh(_HALF * gates[r, j])
            g = fast_tanh(gates[r, _CELLS + j])
            o_gate = _HALF + _HALF * fast_tanh(_HALF * gates[r, 2 * _CELLS + j])
            c = fast_tanh(i * g)
            gates[r, j], gates[r, _CELLS + j], gates[r, 2 * _CELLS + j] = i, g, o_gate
            squashed[r, j], h[r, j] = c, o_gate * c
        for o in range(_OUTPUTS):
            y[r, o] = d[o]
        for j in range(0, CELLS, 10):
            for o in range(_OUTPUTS):
                y[r, o] += (
                    h[r, j] * v_t[j, o]
                    + h[r, j + 1] * v_t[j + 1, o]
                    + h[r, j + 2] * v_t[j + 2, o]
                    + h[r, j + 3] * v_t[j + 3, o]
                    + h[r, j + 4] * v_t[j + 4, o]
                ) + (
                    h[r, j + 5] * v_t[j + 5, o]
                    + h[r, j + 6] * v_t[j + 6, o]
                    + h[r, j + 7] * v_t[j + 7, o]
                    + h[r, j + 8] * v_t[j + 8, o]
                    + h[r, j + 9] * v_t[j + 9, o]
                )


@_jit
def _errors(y, t, count):  # type: ignore[no-untyped-def]
    """Sum of the absolute errors; ``y`` becomes the gradient of their mean."""
    sums = np.zeros(_OUTPUTS, dtype=np.float32)
    share = _ONE / _f(count * COORDINATES)
    for r in range(count):
        for o in range(_OUTPUTS):
            error = y[r, o] - t[r, o]
            sums[o] += abs(error)
            y[r, o] = share if error > _ZERO else (-share if error < _ZERO else _ZERO)
    total = 0.0
    for o in range(COORDINATES):
        total += sums[o]
    return total


@_jit
def _backward(theta, x, y, count, gates, squashed, h, dh, grad):  # type: ignore[no-untyped-def]
    """From the gradient of the outputs, ``y``, to that of the parameters; ``gates`` becomes that of their sums."""
    v = theta[_END_B:_END_V].reshape(COORDINATES, _CELLS)
    for r in range(count):
        for j in range(_CELLS):
            total = _ZERO
            for o in range(COORDINATES):
                total += y[r, o] * v[o, j]
            dh[r, j] = total
        for j in range(_CELLS):
            i, g, o_gate, c = gates[r, j], gates[r, _CELLS + j], gates[r, 2 * _CELLS + j], squashed[r, j]
            dc = dh[r, j] * o_gate * (_ONE - c * c)
            gates[r, j] = dc * g * i * (_ONE - i)
            gates[r, _CELLS + j] = dc * i * (_ONE - g * g)
            gates[r, 2 * _CELLS + j] = dh[r, j] * c * o_gate * (_ONE - o_gate)
    used = (count + _LANES - 1) // _LANES * _LANES
    for r in range(count, used):
        y[r, :] = _ZERO
        gates[r, :] = _ZERO
    grad[:] = _ZERO
    gw, gb = grad[:_END_W].reshape(INPUTS, _GATES), grad[_END_W:_END_B]
    gv, gd = grad[_END_B:_END_V].reshape(COORDINATES, _CELLS), grad[_END_V:]
    for r in range(0, used, _LANES):
        for k in range(INPUTS):
            _add_products(x, r, k, gates, gw)
        for o in range(COORDINATES):
            _add_products(y, r, o, h, gv)
        for q in range(_LANES):
            for j in range(_GATES):
                gb[j] += gates[r + q, j]
            for o in range(_OUTPUTS):
                gd[o] += y[r + q, o]


@_jit
def _add_products(a, r, k, z, into):  # type: ignore[no-untyped-def]
    """into[k] += sum over six rows of a[row, k] z[row]."""
    for j in range(into.shape[1]):
        into[k, j] += (
            a[r, k] * z[r, j]
            + a[r + 1, k] * z[r + 1, j]
            + a[r + 2, k] * z[r + 2, j]
            + a[r + 3, k] * z[r + 3, j]
            + a[r + 4, k] * z[r + 4, j]
            + a[r + 5, k] * z[r + 5, j]
        )


@_jit
def _adam(theta, first, second, grad, steps, rate):  # type: ignore[no-untyped-def]
    """Step number ``steps`` of Adam (Kingma and Ba 2015, algorithm 1)."""
    step = _f(rate / (1.0 - BETA_1**steps))
    scale = _f(1.0 / math.sqrt(1.0 - BETA_2**steps))
    for p in range(SIZE):
        first[p] = _BETA_1 * first[p] + _BETA_1_REST * grad[p]
        second[p] = _BETA_2 * second[p] + _BETA_2_REST * grad[p] * grad[p]
        theta[p] -= step * first[p] / (np.sqrt(second[p]) * scale + _EPSILON)


@_jit
def _epoch(theta, first, second, steps, rate, inputs, outputs, order, batch):  # type: ignore[no-untyped-def]
    """All batches; returns the sum of the absolute errors and the steps of Adam."""
    rows = (batch + _LANES - 1) // _LANES * _LANES
    x, t = np.zeros((rows, _OUTPUTS), dtype=np.float32), np.zeros((rows, _OUTPUTS), dtype=np.float32)
    y, gates = np.zeros((rows, _OUTPUTS), dtype=np.float32), np.zeros((rows, _GATES), dtype=np.float32)
    squashed, h = np.zeros((rows, _CELLS), dtype=np.float32), np.zeros((rows, _CELLS), dtype=np.float32)
    dh, grad = np.zeros((rows, _CELLS), dtype=np.float32), np.zeros(SIZE, dtype=np.float32)
    total = 0.0
    for start in range(0, len(order), batch):
        count = min(batch, len(order) - start)
        _gather(inputs, outputs, order, start, count, x, t)
        _forward(theta, x, count, gates, squashed, h, y)
        total += _errors(y, t, count)
        _backward(theta, x, y, count, gates, squashed, h, dh, grad)
        steps += 1
        _adam(theta, first, second, grad, steps, rate)
    return total, steps


@_jit
def _total_error(theta, inputs, outputs, order):  # type: ignore[no-untyped-def]
    """Sum of the absolute errors of these rows."""
    block = 30
    x, t = np.zeros((block, _OUTPUTS), dtype=np.float32), np.zeros((block, _OUTPUTS), dtype=np.float32)
    y, gates = np.zeros((block, _OUTPUTS), dtype=np.float32), np.zeros((block, _GATES), dtype=np.float32)
    squashed, h = np.zeros((block, _CELLS), dtype=np.float32), np.zeros((block, _CELLS), dtype=np.float32)
    total = 0.0
    for start in range(0, len(order), block):
        count = min(block, len(order) - start)
        _gather(inputs, outputs, order, start, count, x, t)
        _forward(theta, x, count, gates, squashed, h, y)
        total += _errors(y, t, count)
    return total
