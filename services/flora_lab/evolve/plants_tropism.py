"""Plants under the mechanistic law, for compiled loops."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from flora_lab.evolve.plants import jit_methods, room
from flora_lab.evolve.plants_growing import DriveCourse, drive_course, driven, first_state
from flora_lab.evolve.task import Task
from flora_lab.simulator import tropism
from flora_lab.simulator.growing import GrowingSimulator
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.rod import LONGEST_STEP_H, length_of, points_lane

Array = npt.NDArray[Any]

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
                self.seen[u],
                self.constants,
                self.lamps_cm,
                left,
                right,
                bias,
                growth,
                LONGEST_STEP_H,
            )

    def copy_row(self, source: int, target: int) -> None:
        self.length[target], self.angle[target] = self.length[source], self.angle[source]
        self.segments[target], self.seen[target] = self.segments[source], self.seen[source]


def plants_of(simulator: Simulator[Any], task: Task, seed: int | None, rows: int) -> TropismPlants | None:
    """See :func:`flora_lab.evolve.plants_kinds.plants_of`; None for a simulator of another law."""
    if not isinstance(simulator, GrowingSimulator) or type(simulator.law) is not tropism.TropismLaw:
        return None
    state, lamps = first_state(simulator, task, seed), simulator.law.lamps
    stems = state.stems
    return TropismPlants(
        room(stems.length, rows),
        room(stems.angle, rows),
        room(stems.count, rows),
        room(stems.memory, rows),
        np.exp(state.traits)[0],
        np.array([lamps.distance_cm, lamps.height_cm]),
        drive_course(simulator, task, seed),
    )
