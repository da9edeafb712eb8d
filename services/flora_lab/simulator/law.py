"""What makes a stem bend and grow: the part in which growing simulators differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flora_common.arrays import Array
from flora_common.shapes import STEM_POINTS
from flora_lab.simulator.rod import jit, length_of
from flora_lab.simulator.shape import points_of, rods_through


@dataclass(frozen=True, slots=True)
class Stems:
    """Stems of a batch of plants, and what the plants remember.

    Attributes:
        length: of the segments, cm, shape (batch, CAPACITY).
        angle: of the segments from the vertical, rad, positive to the right, shape (batch, CAPACITY).
        count: segments in use, shape (batch,).
        memory: what the law keeps from step to step, shape (batch, ...).
    """

    length: Array
    angle: Array
    count: Array
    memory: Array

    def copy(self) -> Stems:
        return Stems(self.length.copy(), self.angle.copy(), self.count.copy(), self.memory.copy())

    def repeated(self, lanes: int) -> Stems:
        """A single stem, ``lanes`` times."""
        parts = (self.length, self.angle, self.count, self.memory)
        return Stems(*(np.repeat(part, lanes, axis=0) for part in parts))

    def with_more_of_the_first(self, lanes: int) -> Stems:
        """These, and the first stem ``lanes`` times more."""
        parts = (self.length, self.angle, self.count, self.memory)
        return Stems(*(np.concatenate([part, np.repeat(part[:1], lanes, axis=0)]) for part in parts))

    @property
    def length_cm(self) -> Array:
        """Of the whole stems, shape (batch,)."""
        return np.asarray(_lengths_of(self.length, self.count))

    @property
    def points_cm(self) -> Array:
        """Shape (batch, 10, 2), as a track has them."""
        return points_of(self.length, self.angle, self.count)


@jit
def _lengths_of(length: Array, count: Array) -> Array:
    """Added up as compiled loops do it: numpy's sums go in another order."""
    total = np.empty(len(count))
    for b in range(len(count)):
        total[b] = length_of(length[b], count[b])
    return total


class Law(Protocol):
    """What makes a stem bend and grow.

    Attributes:
        traits: names of what plants differ in. Their values are in coordinates in which they are normal over plants.
        memory_shape: of one plant's memory; all zeros is a plant that stood in the dark.
    """

    @property
    def traits(self) -> tuple[str, ...]: ...

    @property
    def memory_shape(self) -> tuple[int, ...]: ...

    def advance(
        self,
        stems: Stems,
        traits: Array,
        light: Array,
        bias: Array,
        growth: Array,
        step_h: float,
        every: int,
        out: Array,
    ) -> None:
        """Many steps of many plants, in place.

        Args:
            stems: changed.
            traits: shape (batch, number of traits).
            light: levels of the left and right lamp, shape (steps, batch, 2), from 0.
            bias: a bias of the bending of soft tissue, 1/(cm h), shape (steps, batch).
            growth: factor on the rate of growth, shape (steps, batch).
            step_h: hours per step.
            every: stems are told after every so many steps.
            out: shape (steps // every, batch, 10, 2), written.
        """


def standing(law: Law, points_cm: Array) -> Stems:
    """Stems as they were measured, shape (batch, 10, 2), that stood in the dark before.

    Raises:
        BadInput: see :func:`flora_lab.simulator.shape.rods_through`.
    """
    length, angle, count = rods_through(points_cm)
    return Stems(length, angle, count, np.zeros((len(count), *law.memory_shape)))


def advanced(law: Law, stems: Stems, traits: Array, light: Array, bias: Array, growth: Array, step_h: float) -> Stems:
    """As :meth:`Law.advance`, on a copy, and without telling stems."""
    after = stems.copy()
    nothing = np.empty((0, len(stems.count), STEM_POINTS, 2))
    law.advance(after, traits, light, bias, growth, step_h, len(light) + 1, nothing)
    return after
