"""One step of an LSTM for many plants side by side: a tile of plants is the direction in which SIMD goes.

A tile's numbers stand row by row in a flat array, one row per coordinate, cell or gate, one lane per plant. Every loop
over lanes does the same operations in each of them and none between them, which is what compilers make vector
instructions of, of whatever width; and a lane comes to the same bits wherever it stands and whatever stands beside it.

They take rows of reshaped arrays: an index that is computed might be negative to a compiler, and slices cost time. And
tiles begin where a line of the cache does, for loads that cross lines take twice as long.

A sigmoid is (1 + tanh(x / 2)) / 2, its tanh a quotient of polynomials. Products of gates are divided once, by the
product of their denominators. The halves of x / 2 are in the weights.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from flora_lab.simulator.fast_tanh import tanh_parts
from flora_lab.simulator.rod import jit

Array = npt.NDArray[Any]

LANES: Final = 32
"""Plants per tile."""
ROWS_AT_ONCE: Final = 4
COLUMNS_AT_ONCE: Final = 5
_LINE_BYTES: Final = 64
_HALF: Final = np.float32(0.5)


def tiles(count: int, rows: int) -> Array:
    """Room for so many tiles, shape (count, rows * LANES), float32, not filled."""
    size = count * rows * LANES
    room = np.empty(size + _LINE_BYTES // 4, dtype=np.float32)
    first = -room.ctypes.data % _LINE_BYTES // 4
    return room[first : first + size].reshape(count, rows * LANES)


@jit
def fill(rows: int, values: Array, out: Array) -> None:
    """Write ``values[row]`` into all lanes of each of the first rows."""
    lanes = out.reshape(-1, LANES)
    for r in range(rows):
        lanes[r] = values[r]


@jit
def fill_lit(first: int, rows: int, values: Array, by_light: Array, light: Array, out: Array) -> None:
    """Write ``values[row] + by_light[row] * light[lane]``, row by row from ``first`` on, into the first rows."""
    lanes = out.reshape(-1, LANES)
    for r in range(rows):
        row, value, factor = lanes[r], values[first + r], by_light[first + r]
        # Of a constant number of lanes so short a loop would be unrolled, before it is made one of SIMD.
        for lane in range(len(light)):
            row[lane] = value + factor * light[lane]


@jit
def add_product(weights: Array, first: int, rows: int, columns: int, tile: Array, out: Array) -> None:
    """Add a matrix times a tile to another tile.

    Four rows and five columns at a time, so that what is loaded is used several times.

    Args:
        weights: row by row, flat.
        first: row of the matrix to begin with.
        rows: how many; a multiple of 4.
        columns: of the matrix, which are the rows of ``tile``; a multiple of 5.
        tile: flat.
        out: flat, of ``rows`` rows, changed.
    """
    to, by = out.reshape(-1, ROWS_AT_ONCE * LANES), tile.reshape(-1, COLUMNS_AT_ONCE * LANES)
    for r in range(rows // ROWS_AT_ONCE):
        y = to[r]
        for i in range(columns // COLUMNS_AT_ONCE):
            x = by[i]
            j = (first + r * ROWS_AT_ONCE) * columns + i * COLUMNS_AT_ONCE
            k, m, n = j + columns, j + 2 * columns, j + 3 * columns
            a0, a1, a2, a3, a4 = weights[j], weights[j + 1], weights[j + 2], weights[j + 3], weights[j + 4]
            b0, b1, b2, b3, b4 = weights[k], weights[k + 1], weights[k + 2], weights[k + 3], weights[k + 4]
            c0, c1, c2, c3, c4 = weights[m], weights[m + 1], weights[m + 2], weights[m + 3], weights[m + 4]
            d0, d1, d2, d3, d4 = weights[n], weights[n + 1], weights[n + 2], weights[n + 3], weights[n + 4]
            for lane in range(LANES):
                a, b, c, d = y[lane], y[LANES + lane], y[2 * LANES + lane], y[3 * LANES + lane]
                v = x[lane]
                a, b, c, d = a + a0 * v, b + b0 * v, c + c0 * v, d + d0 * v
                v = x[LANES + lane]
                a, b, c, d = a + a1 * v, b + b1 * v, c + c1 * v, d + d1 * v
                v = x[2 * LANES + lane]
                a, b, c, d = a + a2 * v, b + b2 * v, c + c2 * v, d + d2 * v
                v = x[3 * LANES + lane]
                a, b, c, d = a + a3 * v, b + b3 * v, c + c3 * v, d + d3 * v
                v = x[4 * LANES + lane]
                a, b, c, d = a + a4 * v, b + b4 * v, c + c4 * v, d + d4 * v
                y[lane], y[LANES + lane], y[2 * LANES + lane], y[3 * LANES + lane] = a, b, c, d


@jit
def hidden_from_zero(cells: int, gates: Array, hidden: Array) -> None:
    """h of cells that were in the zero state: o tanh(i g).

    Args:
        cells: how many.
        gates: flat, rows i, g and o of each cell, before their activation, those of i and o halved.
        hidden: flat, written.
    """
    told, to = gates.reshape(-1, LANES), hidden.reshape(-1, LANES)
    for j in range(cells):
        input_gate, candidate, output_gate, h = told[3 * j], told[3 * j + 1], told[3 * j + 2], to[j]
        for lane in range(LANES):
            i, under_i = tanh_parts(input_gate[lane])
            g, under_g = tanh_parts(candidate[lane])
            o, under_o = tanh_parts(output_gate[lane])
            c, under_c = tanh_parts(_HALF * ((under_i + i) * g) / (under_i * under_g))
            h[lane] = _HALF * ((under_o + o) * c) / (under_o * under_c)


@jit
def hidden_and_cell(cells: int, gates: Array, cell: Array, hidden: Array, first: int) -> None:
    """c' = f c + i g and h' = o tanh(c').

    Args:
        cells: how many.
        gates: flat, rows i, f, g and o of each cell, before their activation, those of i, f and o halved.
        cell: flat, changed from row ``first`` on.
        hidden: flat, written from row ``first`` on.
        first: see there.
    """
    told, kept, to = gates.reshape(-1, LANES), cell.reshape(-1, LANES), hidden.reshape(-1, LANES)
    for j in range(cells):
        input_gate, forget_gate, candidate, output_gate = told[4 * j], told[4 * j + 1], told[4 * j + 2], told[4 * j + 3]
        memory, h = kept[first + j], to[first + j]
        for lane in range(LANES):
            i, under_i = tanh_parts(input_gate[lane])
            f, under_f = tanh_parts(forget_gate[lane])
            g, under_g = tanh_parts(candidate[lane])
            o, under_o = tanh_parts(output_gate[lane])
            under_ig = under_i * under_g
            after = (under_f + f) * memory[lane] * under_ig + (under_i + i) * g * under_f
            after = _HALF * after / (under_f * under_ig)
            memory[lane] = after
            c, under_c = tanh_parts(after)
            h[lane] = _HALF * ((under_o + o) * c) / (under_o * under_c)
