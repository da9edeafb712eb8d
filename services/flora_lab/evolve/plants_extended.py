"""Plants under the mechanistic law with terms that were found later, for compiled loops."""

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
from flora_lab.simulator import terms
from flora_lab.simulator.growing import GrowingSimulator
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.rod import LONGEST_STEP_H, length_of

_step = terms.extended_step_lane
_NO_GRADIENT: Final = 0.0
_WHOLE_GAIN: Final = 1.0
_AS_WARM: Final = 0.0
"""An episode is as warm as the runs that the simulator was learned from."""


@jit_methods
class ExtendedPlants(NamedTuple):
    """See :class:`flora_lab.evolve.plants.Plants`.

    Attributes:
        length, angle, segments, memory: stems and memory, see :class:`flora_lab.simulator.law.Stems`; one row per
            plant.
        constants: of the individual, see :mod:`flora_lab.simulator.tropism`.
        terms: see :mod:`flora_lab.simulator.terms`.
        lamps_cm: distance to either side, height.
        course: what happens to it.
    """

    length: Array
    angle: Array
    segments: Array
    memory: Array
    constants: Array
    terms: Array
    lamps_cm: Array
    course: DriveCourse

    def points(self, rows: int, out: Array) -> None:
        points_of_rows(self.length, self.angle, self.segments, rows, out)

    def advance(self, rows: int, is_right: Array, step: int) -> None:
        for u in range(rows):
            length, n = self.length[u], self.segments[u]
            left, right = levels(is_right[u])
            bias, growth = driven(self.course, step, length_of(length, n))
            self.segments[u] = _step(
                length,
                self.angle[u],
                n,
                self.memory[u],
                self.constants,
                self.terms,
                self.lamps_cm,
                left,
                right,
                bias,
                _NO_GRADIENT,
                growth,
                _WHOLE_GAIN,
                _AS_WARM,
                LONGEST_STEP_H,
            )

    def copy_rows(self, sources: Array, targets: Array, count: int) -> None:
        copy_stems(self.length, self.angle, self.segments, sources, targets, count)
        for i in range(count):
            self.memory[targets[i]] = self.memory[sources[i]]


def plants_of(simulator: Simulator[Any], task: Task, seed: int | None, rows: int) -> ExtendedPlants | None:
    """See :func:`flora_lab.evolve.plants_kinds.plants_of`; None for a simulator of another law."""
    if not isinstance(simulator, GrowingSimulator) or not isinstance(simulator.law, terms.ExtendedLaw):
        return None
    state, law = first_state(simulator, task, seed), simulator.law
    course = drive_course(simulator, task, seed)
    return ExtendedPlants(*rooms(state.stems, rows), np.exp(state.traits)[0], law.terms, law.lamps_cm, course)
