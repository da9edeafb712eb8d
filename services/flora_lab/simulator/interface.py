"""What every simulated plant can do, whatever it was learned with.

All arrays hold a batch of plants that do not influence each other: a plant alone and the same plant in a batch give the
same numbers. Lengths in cm in the frame of :mod:`flora_common.geometry`, times in seconds.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Generic, TypeVar

import numpy as np

from flora_common.arrays import Array, FloatArray, IntArray

StateT = TypeVar("StateT")

Covariates = Mapping[str, FloatArray]
"""Name (such as ``temperature_c``) to one value per plant, shape (batch,)."""


@dataclass(frozen=True, slots=True)
class History:
    """What was seen of some plants up to now, in equal steps.

    Attributes:
        points_cm: shape (n, batch, 10, 2), n >= 1; NaN where nothing was measured, never in the first and last row.
        light: shape (n - 1, batch, 2): levels of the left and right lamp (0 dark, 1 full) from each row to the next.
        step_s: seconds from one row to the next.
        covariates: name to shape (n - 1, batch).
    """

    points_cm: FloatArray
    light: FloatArray
    step_s: float
    covariates: Mapping[str, FloatArray]


@dataclass(frozen=True, slots=True)
class Chance:
    """What makes one simulated plant differ from the next.

    Attributes:
        seeds: one per plant, shape (batch,), integers from 0. The seed alone decides which individual a plant is and
            what happens to it by chance, in whatever batch it is simulated.
    """

    seeds: IntArray


class Simulator(ABC, Generic[StateT]):
    """A simulated plant. Its settings and weights never change; what a plant is at a time is its state."""

    kind: ClassVar[str]
    """``kind`` in ``simulator.toml``."""

    step_s: float
    """The step that it was made for."""

    @property
    def has_individuals(self) -> bool:
        """Whether seeds make different plants of it."""
        return False

    @abstractmethod
    def start(self, points_cm: FloatArray, chance: Chance | None = None, before: FloatArray | None = None) -> StateT:
        """Plants of which one stem is known.

        Args:
            points_cm: shape (batch, 10, 2).
            chance: without it all are the typical plant and nothing happens by chance.
            before: levels of the lamps that shone up to now, shape (batch, 2); the dark where missing.
        """

    @abstractmethod
    def watch(self, history: History) -> StateT:
        """Plants after ``history``: the state that explains best what was seen. Nothing happens by chance after it."""

    @abstractmethod
    def step(
        self, state: StateT, light: FloatArray, dt_s: float, covariates: Covariates | None = None
    ) -> tuple[StateT, FloatArray]:
        """Let ``dt_s`` seconds pass under ``light``.

        Args:
            state: of :meth:`start`, :meth:`watch` or a step before; it is left as it is.
            light: shape (batch, 2): levels of the left and right lamp, 0 dark, 1 full.
            dt_s: a simulator that knows a single step only takes multiples of it.
            covariates: those that the simulator does not use are ignored.

        Returns:
            The state after the step, and the stems, shape (batch, 10, 2).

        Raises:
            BadInput: a step or a light that this simulator does not know.
        """

    @abstractmethod
    def stems_cm(self, state: StateT) -> FloatArray:
        """The stems of a state, shape (batch, 10, 2)."""

    def members(self) -> Sequence[Simulator[StateT]]:
        """Simulators that this one is the mean of, each learned from other plants; none where it is a single one.

        Where they part, the simulator does not know.
        """
        return ()

    def is_beyond_data(self, state: StateT) -> Array:
        """Which plants have come where the simulator was never shown any, shape (batch,), bool."""
        raise NotImplementedError


def run(
    simulator: Simulator[StateT], state: StateT, light: FloatArray, dt_s: float, covariates: Covariates | None = None
) -> FloatArray:
    """Let a simulator run free.

    Args:
        simulator, state: whom and from where.
        light: shape (n, batch, 2), one step each.
        dt_s: length of the steps.
        covariates: name to shape (n, batch).

    Returns:
        Stems after each step, shape (n, batch, 10, 2).
    """
    stems = []
    for k, levels in enumerate(light):
        now = {name: values[k] for name, values in (covariates or {}).items()}
        state, points = simulator.step(state, levels, dt_s, now)
        stems.append(points)
    return np.stack(stems) if stems else np.empty((0, *simulator.stems_cm(state).shape))
