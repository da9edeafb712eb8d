"""Plants of a learned simulator with a mechanistic part beside it, for compiled loops.

See :mod:`flora_lab.simulator.corrected`; results differ from it by rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from flora_common.arrays import Array
from flora_common.shapes import STEM_POINTS
from flora_lab.evolve.plants import Plants, jit_methods
from flora_lab.evolve.task import Task
from flora_lab.simulator.corrected import EVEN_CM, CorrectedSimulator
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.rod import jit


@jit
def _told(stem: Array, even: Array) -> None:
    """Make a stem one as it is told: above the ground, its points at even heights.

    Args:
        stem: shape (10, 2), written.
        even: room for another one.
    """
    last = len(stem) - 1
    off_cm = 0.0
    for k in range(last + 1):
        stem[k, 1] = max(stem[k, 1], 0.0)
    for k in range(last + 1):
        off_cm = max(off_cm, abs(stem[k, 1] - stem[last, 1] * k / last))
    if not off_cm > EVEN_CM:  # nor where it is no number
        return
    for i in range(1, last):
        height = stem[0, 1] + (stem[last, 1] - stem[0, 1]) * i / last
        even[i, 0], even[i, 1] = _passage(stem, height), height
    for i in range(1, last):
        stem[i] = even[i]


@jit
def _passage(stem: Array, height: float) -> float:
    """Where a stem passes a height for the first time, or comes nearest to it, x."""
    nearest = 0
    for k in range(len(stem) - 1):
        below, above = stem[k, 1] - height, stem[k + 1, 1] - height
        if (below <= 0.0 < above) or (below >= 0.0 > above):
            return float(stem[k, 0] + below / (below - above) * (stem[k + 1, 0] - stem[k, 0]))
        if abs(above) < abs(stem[nearest, 1] - height):
            nearest = k + 1
    return float(stem[nearest, 0])


@jit_methods
class CorrectedPlants(NamedTuple):
    """See :class:`flora_lab.evolve.plants.Plants`.

    Attributes:
        learned: of the learned simulator.
        plain, extended: of the mechanistic one, without and with the effects.
        stems: room for those of the last two, shape (2, rows, 10, 2).
        even: room for one stem.
    """

    learned: Any
    plain: Any
    extended: Any
    stems: Array
    even: Array

    def points(self, rows: int, out: Array) -> None:
        without, having = self.stems[0], self.stems[1]
        self.learned.points(rows, out)
        self.plain.points(rows, without)
        self.extended.points(rows, having)
        for u in range(rows):
            for k in range(STEM_POINTS):
                for axis in range(2):
                    out[u, k, axis] += having[u, k, axis] - without[u, k, axis]
            _told(out[u], self.even)

    def advance(self, rows: int, is_right: Array, step: int) -> None:
        self.learned.advance(rows, is_right, step)
        self.plain.advance(rows, is_right, step)
        self.extended.advance(rows, is_right, step)

    def copy_rows(self, sources: Array, targets: Array, count: int) -> None:
        self.learned.copy_rows(sources, targets, count)
        self.plain.copy_rows(sources, targets, count)
        self.extended.copy_rows(sources, targets, count)


def plants_of(
    simulator: Simulator[Any],
    task: Task,
    seed: int | None,
    rows: int,
    part_of: Callable[[Simulator[Any], Task, int | None, int], Plants],
) -> CorrectedPlants | None:
    """See :func:`flora_lab.evolve.plants_kinds.plants_of`; None for another simulator.

    Args:
        simulator, task, seed, rows: as there.
        part_of: that function, for the parts.
    """
    if not isinstance(simulator, CorrectedSimulator):
        return None
    parts = simulator.learned, simulator.plain, simulator.mechanistic
    learned, plain, extended = (part_of(one, task, seed, rows) for one in parts)
    room = np.empty((2, rows, STEM_POINTS, 2)), np.empty((STEM_POINTS, 2))
    return CorrectedPlants(learned, plain, extended, *room)
