"""Plants under the learned law, for compiled loops."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy.typing as npt

from flora_lab.evolve.plants import jit_methods
from flora_lab.evolve.plants_growing import DriveCourse, drive_course, driven, first_state, rooms
from flora_lab.evolve.task import Task
from flora_lab.simulator import neural_law
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.rod import length_of, points_lane
from flora_lab.simulator.sequence import SequenceSimulator

Array = npt.NDArray[Any]

_step = neural_law.step_lane


@jit_methods
class NeuralPlants(NamedTuple):
    """See :class:`flora_lab.evolve.plants.Plants`.

    Attributes:
        length, angle, segments, hidden: stems and memory, see :class:`flora_lab.simulator.law.Stems`; one row per
            plant.
        traits: of the individual.
        w_ih, w_hh, b, w_out, b_out, zone_cm: of the law, see :mod:`flora_lab.simulator.neural_law`; of the member that
            the plant follows.
        course: what happens to it.
    """

    length: Array
    angle: Array
    segments: Array
    hidden: Array
    traits: Array
    w_ih: Array
    w_hh: Array
    b: Array
    w_out: Array
    b_out: Array
    zone_cm: float
    course: DriveCourse

    def points(self, row: int, out: Array) -> None:
        points_lane(self.length[row], self.angle[row], self.segments[row], out)

    def advance(self, rows: int, is_right: Array, step: int) -> None:
        for u in range(rows):
            length, n = self.length[u], self.segments[u]
            left, right = (0.0, 1.0) if is_right[u] else (1.0, 0.0)
            bias, growth = driven(self.course, step, length_of(length, n))
            self.segments[u] = _step(
                length,
                self.angle[u],
                n,
                self.hidden[u],
                self.traits,
                self.w_ih,
                self.w_hh,
                self.b,
                self.w_out,
                self.b_out,
                self.zone_cm,
                left,
                right,
                bias,
                growth,
            )

    def copy_row(self, source: int, target: int) -> None:
        self.length[target], self.angle[target] = self.length[source], self.angle[source]
        self.segments[target], self.hidden[target] = self.segments[source], self.hidden[source]


def plants_of(simulator: Simulator[Any], task: Task, seed: int | None, rows: int) -> NeuralPlants | None:
    """See :func:`flora_lab.evolve.plants_kinds.plants_of`; None for a simulator of another law."""
    if not isinstance(simulator, SequenceSimulator):
        return None
    state = first_state(simulator, task, seed)
    law, stems = simulator.neural, state.stems
    if state.member is not None:
        law, stems = simulator.following(stems, int(state.member[0]))
    weights = law.weights
    return NeuralPlants(
        *rooms(stems, rows),
        state.traits[0],
        weights["w_ih"],
        weights["w_hh"],
        weights["b"],
        weights["w_out"],
        weights["b_out"],
        law.zone_cm,
        drive_course(simulator, task, seed),
    )
