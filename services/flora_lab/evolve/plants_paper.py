"""Plants of the paper's simulator, for compiled loops: an LSTM of 50 cells, with its state or from the zero state.

From the zero state neither the recurrent weights nor the forget gate have any effect; they are left out.

With state, each step's stem is a linear function of the hidden state before it, but for the first, which is given. So
the output layer is folded into the recurrent weights: W_hh + W_ih W_out, once, in place of two products in each step.
That is exact but for rounding. The stem is still computed, for it decides what the lamps do.

Against :meth:`flora_lab.simulator.paper.PaperSimulator.step` results differ by rounding, some 1e-7 of a stem per step.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from flora_common.arrays import Array
from flora_lab.evolve.lstm_tiles import (
    hidden_and_cell,
    hidden_from_zero,
    product,
    tiles,
)
from flora_lab.evolve.plants import jit_methods
from flora_lab.evolve.task import Task
from flora_lab.simulator.fast_product import LANES, ROWS
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.measured import STEP_S
from flora_lab.simulator.paper import CELLS, COORDINATES, PaperSimulator
from flora_lab.simulator.rod import jit

INPUT_ROWS: Final = 20
"""Of a tile: 18 coordinates, the light, and one to round up, whose weights are zero; no product leaves anything in the
last two."""
_I, _F, _G, _O = range(4)
_CELLS_AT_ONCE: Final = 10


@jit
def _stem_points(stem: Array, row: int, unit_cm: float, out: Array) -> None:
    """The stem of one plant in its tile, in cm; the anchor is no part of a tile."""
    tile, lane = row // LANES, row % LANES
    out[0, 0] = out[0, 1] = 0.0
    for j in range(COORDINATES):
        out[1 + j // 2, j % 2] = np.float64(stem[tile, j * LANES + lane]) * unit_cm


@jit
def _copy_lane(tiles_of: Array, rows: int, source: int, target: int) -> None:
    """Make the first rows of one plant's lane those of another's."""
    old, lane_old, new, lane_new = source // LANES, source % LANES, target // LANES, target % LANES
    for j in range(rows):
        tiles_of[new, j * LANES + lane_new] = tiles_of[old, j * LANES + lane_old]


@jit
def _shine(tile_of: Array, row: int, is_right: Array, tile: int, rows: int) -> None:
    """Write the right lamp's light into a row of a tile, for those of its plants that are in use."""
    for lane in range(min(LANES, rows - tile * LANES)):
        tile_of[row * LANES + lane] = np.float32(1.0 if is_right[tile * LANES + lane] else 0.0)


@jit_methods
class StatelessPlants(NamedTuple):
    """See :class:`flora_lab.evolve.plants.Plants`.

    Attributes:
        stem: tiles of :data:`INPUT_ROWS` rows, units, float32, shape (tiles, rows * lanes).
        w_gates, b_gates: gates i, g and o of each cell, from a tile's rows; flat.
        w_out, b_out: coordinates from the cells; flat.
        unit_cm: the simulator's unit.
        parts: steps of the simulator in five minutes.
        gates, hidden: room for one tile.
    """

    stem: Array
    w_gates: Array
    b_gates: Array
    w_out: Array
    b_out: Array
    unit_cm: float
    parts: int
    gates: Array
    hidden: Array

    def points(self, rows: int, out: Array) -> None:
        for row in range(rows):
            _stem_points(self.stem, row, self.unit_cm, out[row])

    def advance(self, rows: int, is_right: Array, step: int) -> None:
        for tile in range((rows + LANES - 1) // LANES):
            stem = self.stem[tile]
            for _ in range(self.parts):
                _shine(stem, COORDINATES, is_right, tile, rows)
                product(self.w_gates, self.b_gates, 0, len(self.b_gates), INPUT_ROWS, stem, 0, self.gates)
                hidden_from_zero(CELLS, self.gates, self.hidden)
                product(self.w_out, self.b_out, 0, INPUT_ROWS, CELLS, self.hidden, 0, stem)

    def copy_rows(self, sources: Array, targets: Array, count: int) -> None:
        for i in range(count):
            _copy_lane(self.stem, INPUT_ROWS, sources[i], targets[i])


@jit_methods
class StatefulPlants(NamedTuple):
    """See :class:`flora_lab.evolve.plants.Plants`.

    Attributes:
        stem: tiles of coordinates, units, float32, rounded up to :data:`INPUT_ROWS` rows.
        hidden: tiles of the right lamp's light, and of the hidden state.
        cell: tiles of the cells' state.
        w_gates: gates i, f, g and o of each cell, from the light and the hidden state, output layer and all; flat.
        b_first, b_later: of the gates, in the step from the given stem and in those after it.
        w_out, b_out, unit_cm, parts: see :class:`StatelessPlants`.
        gates, after: room for some cells' gates and for one tile's hidden state.
    """

    stem: Array
    hidden: Array
    cell: Array
    w_gates: Array
    b_first: Array
    b_later: Array
    w_out: Array
    b_out: Array
    unit_cm: float
    parts: int
    gates: Array
    after: Array

    def points(self, rows: int, out: Array) -> None:
        for row in range(rows):
            _stem_points(self.stem, row, self.unit_cm, out[row])

    def advance(self, rows: int, is_right: Array, step: int) -> None:
        chunk = 4 * _CELLS_AT_ONCE
        for tile in range((rows + LANES - 1) // LANES):
            stem, hidden, cell = self.stem[tile], self.hidden[tile], self.cell[tile]
            _shine(hidden, 0, is_right, tile, rows)
            for part in range(self.parts):
                bias = self.b_first if step == 0 and part == 0 else self.b_later
                for first in range(0, CELLS, _CELLS_AT_ONCE):
                    product(self.w_gates, bias, 4 * first, chunk, 1 + CELLS, hidden, 0, self.gates)
                    hidden_and_cell(_CELLS_AT_ONCE, self.gates, cell, self.after, first)
                for j in range(len(self.after)):  # many times faster than an assignment of the whole
                    hidden[LANES + j] = self.after[j]
                product(self.w_out, self.b_out, 0, INPUT_ROWS, CELLS, hidden, 1, stem)

    def copy_rows(self, sources: Array, targets: Array, count: int) -> None:
        for i in range(count):
            _copy_lane(self.stem, COORDINATES, sources[i], targets[i])
            _copy_lane(self.hidden, 1 + CELLS, sources[i], targets[i])
            _copy_lane(self.cell, CELLS, sources[i], targets[i])


def plants_of(
    simulator: Simulator[Any], task: Task, seed: int | None, rows: int
) -> StatelessPlants | StatefulPlants | None:
    """See :func:`flora_lab.evolve.plants_kinds.plants_of`; None for another simulator.

    Raises:
        BadInput: five minutes are no multiple of the simulator's step.
    """
    if not isinstance(simulator, PaperSimulator):
        return None
    parts = simulator.steps_in(STEP_S)
    start = simulator.start(task.start_stem_cm[None]).points[0]
    count = -(-rows // LANES)
    stem = tiles(count, INPUT_ROWS)
    stem[0] = 0.0
    stem[0, : COORDINATES * LANES : LANES] = start
    cell, dense = simulator.network.cell, simulator.network.dense
    w_out = np.zeros((INPUT_ROWS, CELLS), dtype=np.float32)
    w_out[:COORDINATES] = dense.w
    b_out = np.zeros(INPUT_ROWS, dtype=np.float32)
    b_out[:COORDINATES] = dense.b
    w_ih, w_hh, b = (_halved(part) for part in (cell.w_ih, cell.w_hh, cell.b[:, None]))
    if not simulator.stateful:
        w_gates = np.zeros((3 * CELLS, INPUT_ROWS))
        w_gates[:, : w_ih.shape[1]] = _by_cell(w_ih, (_I, _G, _O))
        b_gates = _flat(_by_cell(b, (_I, _G, _O)))
        return StatelessPlants(
            stem,
            _flat(w_gates),
            b_gates,
            w_out.ravel(),
            b_out,
            simulator.unit_cm,
            parts,
            tiles(1, len(b_gates))[0],
            tiles(1, CELLS)[0],
        )
    w_stem = w_ih[:, :COORDINATES]
    folded = w_hh + w_stem @ dense.w.astype(np.float64)
    every_gate = (_I, _F, _G, _O)
    hidden, memory = tiles(count, 1 + CELLS), tiles(count, CELLS)
    hidden[0] = memory[0] = 0.0
    return StatefulPlants(
        stem,
        hidden,
        memory,
        _flat(_by_cell(np.concatenate([w_ih[:, COORDINATES:], folded], axis=1), every_gate)),
        _flat(_by_cell(b + w_stem @ start[:, None].astype(np.float64), every_gate)),
        _flat(_by_cell(b + w_stem @ dense.b[:, None].astype(np.float64), every_gate)),
        w_out.ravel(),
        b_out,
        simulator.unit_cm,
        parts,
        tiles(1, 4 * _CELLS_AT_ONCE)[0],
        tiles(1, CELLS)[0],
    )


def _halved(rows: Array) -> Array:
    """Rows of PyTorch's gates, those of the sigmoids halved; in float64."""
    return np.asarray(rows.astype(np.float64) * np.repeat([0.5, 0.5, 1.0, 0.5], CELLS)[:, None])


def _by_cell(rows: Array, gates: tuple[int, ...]) -> Array:
    """PyTorch's rows, gate by gate, as rows cell by cell, of these gates alone."""
    parts = [rows[gate * CELLS : (gate + 1) * CELLS] for gate in gates]
    return np.asarray(np.stack(parts, axis=1).reshape(-1, rows.shape[1]))


def _flat(rows: Array) -> Array:
    """As float32, with zero rows up to a multiple of what is done at once."""
    missing = -len(rows) % ROWS
    filled = np.concatenate([rows, np.zeros((missing, rows.shape[1]))])
    return np.asarray(filled.astype(np.float32).ravel())
