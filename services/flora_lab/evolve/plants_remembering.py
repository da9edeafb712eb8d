"""Plants of the paper's simulator with its clock set right and a memory beside it, for compiled loops.

See :mod:`flora_lab.simulator.remembering`; results differ from it by rounding.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np

from flora_common.arrays import Array
from flora_lab.evolve.plants import jit_methods, room
from flora_lab.evolve.task import Task
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.measured import STEP_S
from flora_lab.simulator.paper import CELLS, COORDINATES
from flora_lab.simulator.remembering import TRACES_H, RememberingSimulator, taken_in
from flora_lab.simulator.rod import jit

_TRACES: Final = len(TRACES_H)
_GATES: Final = np.concatenate([np.arange(gate * CELLS, (gate + 1) * CELLS) for gate in (0, 2, 3)])
"""Rows of the gates i, g and o, which are all that acts from the zero state."""


@jit
def _step(
    stem: Array,
    traces: Array,
    side: float,
    w: Array,
    b: Array,
    w_out: Array,
    b_out: Array,
    memory: Array,
    taken: Array,
    unit_cm: float,
    factor: float,
    hidden: Array,
    moved: Array,
) -> None:
    """One step of one plant: ``stem`` (18) in cm and ``traces`` (5) are those after it."""
    for k in range(_TRACES):
        traces[k] += taken[k] * (side - traces[k])
    for c in range(CELLS):
        i, g, o = b[c], b[CELLS + c], b[2 * CELLS + c]
        for j in range(COORDINATES):
            x = stem[j] / unit_cm
            i += w[c, j] * x
            g += w[CELLS + c, j] * x
            o += w[2 * CELLS + c, j] * x
        lit = 1.0 if side > 0.0 else 0.0
        i += w[c, COORDINATES] * lit
        g += w[CELLS + c, COORDINATES] * lit
        o += w[2 * CELLS + c, COORDINATES] * lit
        cell = math.tanh(g) * (0.5 + 0.5 * math.tanh(0.5 * i))
        hidden[c] = (0.5 + 0.5 * math.tanh(0.5 * o)) * math.tanh(cell)
    height = stem[COORDINATES - 1]
    for j in range(COORDINATES):
        after = b_out[j]
        for c in range(CELLS):
            after += w_out[j, c] * hidden[c]
        rest = memory[j, 0]
        for m in range(COORDINATES):
            rest += memory[j, 1 + m] * stem[m]
        for k in range(_TRACES):
            rest += (memory[j, 1 + COORDINATES + k] + memory[j, 1 + COORDINATES + _TRACES + k] * height) * traces[k]
        moved[j] = (after * unit_cm - stem[j]) / factor + rest
    for j in range(COORDINATES):
        stem[j] += moved[j]


@jit_methods
class RememberingPlants(NamedTuple):
    """See :class:`flora_lab.evolve.plants.Plants`.

    Attributes:
        stem: points 2 to 10 in cm, shape (rows, 18).
        traces: of the lamps, shape (rows, 5).
        w, b: of the gates i, g and o, shapes (150, 19) and (150,).
        w_out, b_out: of the output layer, shapes (18, 50) and (18,).
        memory: shape (18, 29), cm per step.
        taken: share of a lamp that each trace takes in, shape (5,).
        unit_cm, factor: of the simulator.
        parts: steps of the simulator in five minutes.
        hidden, moved: room for one plant's cells and step.
    """

    stem: Array
    traces: Array
    w: Array
    b: Array
    w_out: Array
    b_out: Array
    memory: Array
    taken: Array
    unit_cm: float
    factor: float
    parts: int
    hidden: Array
    moved: Array

    def points(self, rows: int, out: Array) -> None:
        for row in range(rows):
            out[row, 0, 0] = out[row, 0, 1] = 0.0
            for j in range(COORDINATES):
                out[row, 1 + j // 2, j % 2] = self.stem[row, j]

    def advance(self, rows: int, is_right: Array, step: int) -> None:
        for row in range(rows):
            side = 1.0 if is_right[row] else -1.0
            for _ in range(self.parts):
                _step(
                    self.stem[row],
                    self.traces[row],
                    side,
                    self.w,
                    self.b,
                    self.w_out,
                    self.b_out,
                    self.memory,
                    self.taken,
                    self.unit_cm,
                    self.factor,
                    self.hidden,
                    self.moved,
                )

    def copy_rows(self, sources: Array, targets: Array, count: int) -> None:
        for i in range(count):
            self.stem[targets[i]] = self.stem[sources[i]]
            self.traces[targets[i]] = self.traces[sources[i]]


def plants_of(simulator: Simulator[Any], task: Task, seed: int | None, rows: int) -> RememberingPlants | None:
    """See :func:`flora_lab.evolve.plants_kinds.plants_of`; None for another simulator.

    Raises:
        BadInput: five minutes are no multiple of the simulator's step.
    """
    if not isinstance(simulator, RememberingSimulator):
        return None
    learned = simulator.learned
    cell, dense = learned.network.cell, learned.network.dense
    start = simulator.start(task.start_stem_cm[None])
    w, b, w_out, b_out = (
        np.ascontiguousarray(part, dtype=np.float64) for part in (cell.w_ih[_GATES], cell.b[_GATES], dense.w, dense.b)
    )
    return RememberingPlants(
        room(start.stems, rows),
        room(start.traces, rows),
        w,
        b,
        w_out,
        b_out,
        np.ascontiguousarray(simulator.memory),
        taken_in(learned.step_s),
        learned.unit_cm,
        simulator.factor,
        learned.steps_in(STEP_S),
        np.empty(CELLS),
        np.empty(COORDINATES),
    )
