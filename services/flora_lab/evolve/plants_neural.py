"""Plants under the learned law, for compiled loops.

Each member's network is asked for many plants before the next one is, so that its weights stay at hand.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from flora_common.arrays import Array
from flora_lab.evolve.plants import jit_methods
from flora_lab.evolve.plants_growing import (
    DriveCourse,
    copy_stems,
    drive_course,
    driven,
    first_state,
    levels,
    points_of_rows,
    rooms,
)
from flora_lab.evolve.task import Task
from flora_lab.simulator.fast_functions import fast_exp
from flora_lab.simulator.fast_product import ROWS
from flora_lab.simulator.fast_scratch import row_of, scratch
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.lstm_rows import SAID, RowWeights, lined_up, lstm_rows, row_weights
from flora_lab.simulator.neural_law import GROWTH_OFFSET, INPUTS, OUTPUTS, TRAIT_SHARE, respond, sense, softplus
from flora_lab.simulator.rod import jit, length_of
from flora_lab.simulator.sequence import SequenceSimulator

_COUNT: Final = OUTPUTS - 1


AT_ONCE: Final = 64
"""Plants that one member is asked for, before the next one's weights are fetched; a multiple of :data:`ROWS`."""


@jit_methods
class NeuralPlants(NamedTuple):
    """See :class:`flora_lab.evolve.plants.Plants`.

    Attributes:
        length, angle, segments: stems, see :class:`flora_lab.simulator.law.Stems`; one row per plant.
        hidden, cell: what each member remembers, float32, shape (rows, members, cells).
        traits: of the individual.
        weights, zone_cm: of the law; of the member that the plant follows.
        course: what happens to it.
        inputs: room for what networks are told, shape (rows, INPUTS).
        gates: room, see :func:`flora_lab.simulator.lstm_rows.lstm_rows`.
        said: room for what a member says, shape (AT_ONCE, SAID).
        rates: room for the sums over members, shape (AT_ONCE, SAID); behind the nodes that of growth.
    """

    length: Array
    angle: Array
    segments: Array
    hidden: Array
    cell: Array
    traits: Array
    weights: RowWeights
    zone_cm: float
    course: DriveCourse
    inputs: Array
    gates: Array
    said: Array
    rates: Array

    def points(self, rows: int, out: Array) -> None:
        points_of_rows(self.length, self.angle, self.segments, rows, out)

    def advance(self, rows: int, is_right: Array, step: int) -> None:
        members = self.hidden.shape[1]
        _tell(self.length, self.angle, self.segments, self.traits, rows, is_right, self.inputs)
        for first in range(0, rows, AT_ONCE):
            end = min(first + AT_ONCE, rows)
            self.rates[:] = 0.0
            for m in range(members):
                lstm_rows(first, end, m, self.weights, self.inputs, self.hidden, self.cell, self.gates, self.said)
                _add(self.said, end - first, self.rates)
            _respond(self, first, end, step)

    def copy_rows(self, sources: Array, targets: Array, count: int) -> None:
        hidden, cell = self.hidden, self.cell
        copy_stems(self.length, self.angle, self.segments, sources, targets, count)
        for i in range(count):
            source, target = sources[i], targets[i]
            for m in range(hidden.shape[1]):
                for j in range(hidden.shape[2]):
                    hidden[target, m, j] = hidden[source, m, j]
                    cell[target, m, j] = cell[source, m, j]


@jit
def _tell(
    length: Array, angle: Array, segments: Array, traits: Array, rows: int, is_right: Array, inputs: Array
) -> None:
    """Write what networks are told of the first plants."""
    told = scratch(np.float64, INPUTS)
    lean = fast_exp(TRAIT_SHARE * traits[3])
    for u in range(rows):
        sense(row_of(length, u), row_of(angle, u), segments[u], told)
        for i in range(_COUNT):
            inputs[u, i] = told[i] / lean
        inputs[u, _COUNT] = told[_COUNT]
        inputs[u, _COUNT + 1], inputs[u, _COUNT + 2] = levels(is_right[u])


@jit
def _add(said: Array, rows: int, rates: Array) -> None:
    """Add what a member says of so many plants."""
    grown = scratch(np.float64, AT_ONCE)
    for r in range(rows):
        grown[r] = said[r, _COUNT] + GROWTH_OFFSET
    for r in range(rows):
        grown[r] = softplus(grown[r])
    for r in range(rows):
        for i in range(_COUNT):
            rates[r, i] += said[r, i]
        rates[r, _COUNT] += grown[r]


@jit
def _respond(plants: NeuralPlants, first: int, end: int, step: int) -> None:
    """Bend and grow the plants of some rows as :attr:`NeuralPlants.rates` say."""
    segments, members = plants.segments, plants.hidden.shape[1]
    for u in range(first, end):
        length, n, rates = row_of(plants.length, u), segments[u], row_of(plants.rates, u - first)
        grown, rates[_COUNT] = rates[_COUNT], 0.0
        bias, growth = driven(plants.course, step, length_of(length, n))
        angle = row_of(plants.angle, u)
        segments[u] = respond(length, angle, n, plants.traits, rates, grown, members, plants.zone_cm, bias, growth)


def plants_of(simulator: Simulator[Any], task: Task, seed: int | None, rows: int) -> NeuralPlants | None:
    """See :func:`flora_lab.evolve.plants_kinds.plants_of`; None for a simulator of another law."""
    if not isinstance(simulator, SequenceSimulator):
        return None
    state = first_state(simulator, task, seed)
    law, stems = simulator.neural, state.stems
    if state.member is not None:
        law, stems = simulator.following(stems, int(state.member[0]))
    members, _, cells = law.memory_shape
    room, weights = -(-rows // ROWS) * ROWS, row_weights(law.weights)
    hidden, cell = lined_up((room, members, cells)), lined_up((room, members, cells))
    hidden[0], cell[0] = stems.memory[0, :, 0], stems.memory[0, :, 1]
    length, angle, segments, _ = rooms(stems, rows)
    return NeuralPlants(
        length,
        angle,
        segments,
        hidden,
        cell,
        state.traits[0],
        weights,
        law.zone_cm,
        drive_course(simulator, task, seed),
        lined_up((room, INPUTS)),
        lined_up((ROWS, *weights.b.shape[1:])),
        lined_up((AT_ONCE, SAID)),
        np.zeros((AT_ONCE, SAID)),
    )
