"""Simulated plants that anybody could make up: what a learned one must be better than."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from flora_common.arrays import Array, FloatArray
from flora_common.errors import BadInput
from flora_lab.simulator.interface import Chance, Covariates, History, Simulator
from flora_lab.simulator.measured import STEP_S

LOOKS_BACK_S: Final = 3600.0
"""Over how long "as before" is averaged: over a shorter time it would be mostly the error of measurement."""


class NothingMoves(Simulator[FloatArray]):
    """The stem stays as it is. Its state is the stem, shape (batch, 10, 2)."""

    kind: ClassVar[str] = "nothing-moves"

    def __init__(self, step_s: float = STEP_S) -> None:
        self.step_s = step_s

    def start(
        self, points_cm: FloatArray, chance: Chance | None = None, before: FloatArray | None = None
    ) -> FloatArray:
        """See :meth:`Simulator.start`."""
        return points_cm.copy()

    def watch(self, history: History) -> FloatArray:
        """See :meth:`Simulator.watch`."""
        last: FloatArray = history.points_cm[-1]
        return last.copy()

    def step(
        self,
        state: FloatArray,
        light: FloatArray,
        dt_s: float,
        covariates: Covariates | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """See :meth:`Simulator.step`; any positive ``dt_s``."""
        check_dt(dt_s)
        return state, state.copy()

    def stems_cm(self, state: FloatArray) -> FloatArray:
        """See :meth:`Simulator.stems_cm`."""
        return state.copy()

    def is_beyond_data(self, state: FloatArray) -> Array:
        """Never: it was made from no data."""
        return np.zeros(len(state), dtype=np.bool_)


@dataclass(frozen=True, slots=True)
class Going:
    """State of :class:`GoesOn`.

    Attributes:
        points_cm: shape (batch, 10, 2).
        velocity_cm_s: of each point, shape (batch, 10, 2).
    """

    points_cm: FloatArray
    velocity_cm_s: FloatArray


class GoesOn(Simulator[Going]):
    """Every point of the stem goes on as before: straight ahead, as fast as on average over the last hour seen.

    A stem of which no past is known stays as it is, so that from a single stem this is :class:`NothingMoves`.
    """

    kind: ClassVar[str] = "goes-on"

    def __init__(self, step_s: float = STEP_S) -> None:
        self.step_s = step_s

    def start(self, points_cm: FloatArray, chance: Chance | None = None, before: FloatArray | None = None) -> Going:
        """See :meth:`Simulator.start`."""
        return Going(points_cm.copy(), np.zeros_like(points_cm))

    def watch(self, history: History) -> Going:
        """See :meth:`Simulator.watch`; the average is from the first stem measured within the last hour to the last."""
        points = history.points_cm
        last = len(points) - 1
        first = max(0, last - round(LOOKS_BACK_S / history.step_s))
        measured = np.isfinite(points[first:, :, -1, 0])
        row = first + np.argmax(measured, axis=0)  # the last row is measured, so there is one
        passed_s = (last - row)[:, None, None] * history.step_s
        moved_cm = points[-1] - points[row, np.arange(points.shape[1])]
        velocity = np.divide(moved_cm, passed_s, out=np.zeros_like(moved_cm), where=passed_s > 0.0)
        return Going(points[-1].copy(), velocity)

    def step(
        self,
        state: Going,
        light: FloatArray,
        dt_s: float,
        covariates: Covariates | None = None,
    ) -> tuple[Going, FloatArray]:
        """See :meth:`Simulator.step`; any positive ``dt_s``."""
        check_dt(dt_s)
        points = state.points_cm + state.velocity_cm_s * dt_s
        return Going(points, state.velocity_cm_s), points.copy()

    def stems_cm(self, state: Going) -> FloatArray:
        """See :meth:`Simulator.stems_cm`."""
        return state.points_cm.copy()

    def is_beyond_data(self, state: Going) -> Array:
        """Never: it was made from no data."""
        return np.zeros(len(state.points_cm), dtype=np.bool_)


def check_dt(dt_s: float) -> None:
    """Whether time can pass.

    Raises:
        BadInput: not a positive number of seconds.
    """
    if not (math.isfinite(dt_s) and dt_s > 0.0):
        raise BadInput(f"a step of {dt_s:g} s; it must be a positive number of seconds")
