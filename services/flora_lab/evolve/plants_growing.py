"""What the compiled plants of growing simulators have in common: how they start, and what happens to them by chance."""

from __future__ import annotations

import functools
from typing import Final, NamedTuple

import numpy as np

from flora_common.arrays import Array
from flora_lab.evolve.plants import room
from flora_lab.evolve.task import Task
from flora_lab.simulator.drives import DriveNoise, Drives, nutation_size
from flora_lab.simulator.fast_scratch import row_of
from flora_lab.simulator.growing import GrowingSimulator, GrowingState
from flora_lab.simulator.interface import Chance
from flora_lab.simulator.law import Stems
from flora_lab.simulator.measured import STEP_S
from flora_lab.simulator.rod import jit, points_lane

_PLANTS_KEPT: Final = 256
_NOTHING: Final = np.zeros(0)
_NOTHING.flags.writeable = False


class DriveCourse(NamedTuple):
    """What happens to one plant by chance, whatever its stem does. Without steps nothing does.

    Attributes:
        wander: bias of bending, 1/(cm h), shape (steps,).
        turning: the circumnutation in the picture plane, of root mean square 1, shape (steps,).
        growth: factor on growth, shape (steps,).
        nutation_per_cm_h, nutation_exponent: size of the circumnutation, which grows with the stem.
    """

    wander: Array
    turning: Array
    growth: Array
    nutation_per_cm_h: float
    nutation_exponent: float


@jit
def driven(course: DriveCourse, step: int, length_cm: float) -> tuple[float, float]:
    """Bias of bending, 1/(cm h), and factor on growth, in one step of a plant that is so long."""
    if len(course.wander) == 0:
        return 0.0, 1.0
    size = nutation_size(length_cm, course.nutation_per_cm_h, course.nutation_exponent)
    return course.wander[step] + size * course.turning[step], course.growth[step]


@jit
def levels(is_right: bool) -> tuple[float, float]:
    """Of the left and right lamp, one of which is full on."""
    return (0.0, 1.0) if is_right else (1.0, 0.0)


@jit
def points_of_rows(length: Array, angle: Array, segments: Array, rows: int, out: Array) -> None:
    """See :meth:`flora_lab.evolve.plants.Plants.points`."""
    for u in range(rows):
        points_lane(row_of(length, u), row_of(angle, u), segments[u], row_of(out, u))


@jit
def copy_stems(length: Array, angle: Array, segments: Array, sources: Array, targets: Array, count: int) -> None:
    """See :meth:`flora_lab.evolve.plants.Plants.copy_rows`."""
    for i in range(count):
        source, target = sources[i], targets[i]
        n = segments[target] = segments[source]
        for j in range(n):
            length[target, j], angle[target, j] = length[source, j], angle[source, j]


def rooms(stems: Stems, rows: int) -> tuple[Array, Array, Array, Array]:
    """Length, angle, count and memory with room for so many plants; the single one of ``stems`` stands in the first."""
    return room(stems.length, rows), room(stems.angle, rows), room(stems.count, rows), room(stems.memory, rows)


def first_state(simulator: GrowingSimulator, task: Task, seed: int | None) -> GrowingState:
    """The plant of that seed at the start of a task; the typical one where None."""
    return simulator.start(task.start_stem_cm[None], None if seed is None else Chance(np.array([seed])))


def drive_course(simulator: GrowingSimulator, task: Task, seed: int | None) -> DriveCourse:
    """What happens to the plant of that seed; nothing where None."""
    if seed is None:
        return DriveCourse(_NOTHING, _NOTHING, _NOTHING, 0.0, 1.0)
    noise = simulator.noise
    wander, turning, growth = _course(noise, seed, task.most_steps)
    return DriveCourse(wander, turning, growth, noise.nutation_per_cm_h, noise.nutation_exponent)


@functools.lru_cache(maxsize=_PLANTS_KEPT)
def _course(noise: DriveNoise, seed: int, steps: int) -> tuple[Array, Array, Array]:
    """The same plants come back in every generation of an evolution."""
    drives = Drives(noise, np.array([seed]))
    processes, no_stem_cm = drives.start(), np.zeros(1)
    wander, turning, growth = np.empty(steps), np.empty(steps), np.empty(steps)
    for k in range(steps):
        processes, bias, factor = drives.step(processes, k, STEP_S / 3600.0, no_stem_cm)
        # A stem of no length does not turn, so that what is left of the bias is wander.
        wander[k], turning[k], growth[k] = bias[0], processes[0, 1], factor[0]
    for array in (wander, turning, growth):
        array.flags.writeable = False
    return wander, turning, growth
