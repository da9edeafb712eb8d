"""One step of an LSTM for many plants side by side: a tile of plants is the direction in which SIMD goes.

A tile's numbers stand row by row in a flat array, one row per coordinate, cell or gate, one lane per plant, of which
there are as many as a product has columns. Every loop
over lanes does the same operations in each of them and none between them, which is what compilers make vector
instructions of, of whatever width; and a lane comes to the same bits wherever it stands and whatever stands beside it.

They take rows of reshaped arrays: an index that is computed might be negative to a compiler, and slices cost time. And
tiles begin where a line of the cache does, for loads that cross lines take twice as long.

A sigmoid is (1 + tanh(x / 2)) / 2, its tanh a quotient of polynomials. Products of gates are divided once, by the
product of their denominators. The halves of x / 2 are in the weights.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.simulator.fast_product import LANES, ROWS, product_of_tile
from flora_lab.simulator.fast_tanh import tanh_parts
from flora_lab.simulator.lstm_rows import lined_up
from flora_lab.simulator.rod import jit

_HALF: Final = np.float32(0.5)


def tiles(count: int, rows: int) -> Array:
    """Room for so many tiles, shape (count, rows * LANES), float32 zeros."""
    return lined_up((count, rows * LANES))


@jit
def product(
    weights: Array, b: Array, first: int, rows: int, columns: int, tile: Array, tile_row: int, out: Array
) -> None:
    """Rows of a matrix times a tile, and a number for each row.

    Args:
        weights: row by row, flat.
        b: the numbers.
        first: row of the matrix to begin with.
        rows: how many; a multiple of 4.
        columns: of the matrix, which are so many rows of ``tile``.
        tile: flat.
        tile_row: the first of them.
        out: flat, of ``rows`` rows, written.
    """
    for r in range(0, rows, ROWS):
        row = first + r
        product_of_tile(weights, row * columns, columns, columns, b, row, tile, tile_row * LANES, out, r * LANES)


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
