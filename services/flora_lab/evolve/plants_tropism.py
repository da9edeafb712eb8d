"""Plants under the mechanistic law, for compiled loops."""

from __future__ import annotations

from typing import Any, NamedTuple

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
from flora_lab.simulator import tropism
from flora_lab.simulator.fast_scratch import row_of
from flora_lab.simulator.growing import GrowingSimulator
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.rod import LONGEST_STEP_H, length_of

_step = tropism.step_lane


@jit_methods
class TropismPlants(NamedTuple):
    """See :class:`flora_lab.evolve.plants.Plants`.

    Attributes:
        length, angle, segments, seen: stems and memory, see :class:`flora_lab.simulator.law.Stems`; one row per plant.
        constants: of the individual, see :mod:`flora_lab.simulator.tropism`.
        lamps_cm: distance to either side, height.
        course: what happens to it.
    """

    length: Array
    angle: Array
    segments: Array
    seen: Array
    constants: Array
    lamps_cm: Array
    course: DriveCourse

    def points(self, rows: int, out: Array) -> None:
        points_of_rows(self.length, self.angle, self.segments, rows, out)

    def advance(self, rows: int, is_right: Array, step: int) -> None:
        segments, constants, lamps_cm = self.segments, self.constants, self.lamps_cm
        for u in range(rows):
            length, n = row_of(self.length, u), segments[u]
            left, right = levels(is_right[u])
            bias, growth = driven(self.course, step, length_of(length, n))
            segments[u] = _step(
                length,
                row_of(self.angle, u),
                n,
                row_of(self.seen, u),
                constants,
                lamps_cm,
                left,
                right,
                bias,
                growth,
                LONGEST_STEP_H,
            )

    def copy_rows(self, sources: Array, targets: Array, count: int) -> None:
        copy_stems(self.length, self.angle, self.segments, sources, targets, count)
        for i in range(count):
            self.seen[targets[i]] = self.seen[sources[i]]


def plants_of(simulator: Simulator[Any], task: Task, seed: int | None, rows: int) -> TropismPlants | None:
    """See :func:`flora_lab.evolve.plants_kinds.plants_of`; None for a simulator of another law."""
    if not isinstance(simulator, GrowingSimulator) or type(simulator.law) is not tropism.TropismLaw:
        return None
    state = first_state(simulator, task, seed)
    course = drive_course(simulator, task, seed)
    return TropismPlants(*rooms(state.stems, rows), np.exp(state.traits)[0], simulator.law.lamps_cm, course)
