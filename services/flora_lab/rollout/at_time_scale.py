"""A simulated plant that is too fast or too slow, with its clock set right.

In ``factor`` steps of real time it makes one of its own, under the lamp that shines then; in between the stem is
interpolated linearly. So the light that it sees fits its own time: to play a recording of it slower would not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, Generic

import numpy as np

from flora_common.arrays import Array, FloatArray
from flora_lab.rollout.predictors import check_dt
from flora_lab.simulator.interface import Chance, Covariates, History, Simulator, StateT

ROUNDING: Final = 1e-9
"""Parts of a step that are rounding, not time."""


@dataclass(frozen=True, slots=True)
class Between(Generic[StateT]):
    """State of :class:`AtTimeScale`: on the way through one of the simulator's own steps.

    Attributes:
        inner: the simulator's state at the end of that step.
        before_cm, after_cm: stems at its beginning and end, shape (batch, 10, 2).
        share: how much of it has passed, 0 to 1.
    """

    inner: StateT
    before_cm: FloatArray
    after_cm: FloatArray
    share: float

    def stems_cm(self) -> FloatArray:
        """Where the stems are now, shape (batch, 10, 2)."""
        if self.share == 1.0:
            return self.after_cm.copy()
        return self.before_cm + self.share * (self.after_cm - self.before_cm)


class AtTimeScale(Simulator[Between[StateT]]):
    """Another simulator, ``factor`` times slower. Any positive ``dt_s`` will do."""

    kind: ClassVar[str] = "at-time-scale"

    def __init__(self, simulator: Simulator[StateT], factor: float) -> None:
        """Wrap a simulator.

        Args:
            simulator: whom.
            factor: above 0; 2 for a plant that does in one hour what a real one needs two for.
        """
        self.simulator = simulator
        self.factor = factor
        self.step_s = simulator.step_s

    def start(
        self, points_cm: FloatArray, chance: Chance | None = None, before: FloatArray | None = None
    ) -> Between[StateT]:
        """See :meth:`Simulator.start`."""
        return self._arrived(self.simulator.start(points_cm, chance, before))

    def watch(self, history: History) -> Between[StateT]:
        """See :meth:`Simulator.watch`; the simulator sees the history in steps of its own time."""
        return self._arrived(self.simulator.watch(resampled(history, self.factor)))

    def step(
        self, state: Between[StateT], light: FloatArray, dt_s: float, covariates: Covariates | None = None
    ) -> tuple[Between[StateT], FloatArray]:
        """See :meth:`Simulator.step`; each of the simulator's steps is under the light at its beginning."""
        check_dt(dt_s)
        left = dt_s / (self.factor * self.step_s)
        while left > ROUNDING:
            if state.share == 1.0:
                inner, after = self.simulator.step(state.inner, light, self.step_s, covariates)
                state = Between(inner, state.after_cm, after, 0.0)
            share = state.share + min(left, 1.0 - state.share)
            left -= share - state.share
            state = Between(state.inner, state.before_cm, state.after_cm, 1.0 if share > 1.0 - ROUNDING else share)
        return state, state.stems_cm()

    def stems_cm(self, state: Between[StateT]) -> FloatArray:
        """See :meth:`Simulator.stems_cm`."""
        return state.stems_cm()

    def is_beyond_data(self, state: Between[StateT]) -> Array:
        """See :meth:`Simulator.is_beyond_data`."""
        return self.simulator.is_beyond_data(state.inner)

    def _arrived(self, inner: StateT) -> Between[StateT]:
        points = self.simulator.stems_cm(inner)
        return Between(inner, points, points, 1.0)


def resampled(history: History, factor: float) -> History:
    """A history in steps ``factor`` times as long, that look to a simulator like its own; it ends with the same stem.

    Stems are interpolated over time; where the nearest row holds none, there is none. Of lamps and covariates, each
    step has those at its middle.
    """
    last = len(history.points_cm) - 1
    at = last - factor * np.arange(int(last / factor + ROUNDING), -1, -1.0)
    at = np.clip(at, 0.0, last)
    rows = np.arange(last + 1)
    measured = np.isfinite(history.points_cm[..., -1, 0])
    points = np.empty((len(at), *history.points_cm.shape[1:]))
    nearest = np.rint(at).astype(np.int64)
    for plant in range(points.shape[1]):
        own = measured[:, plant]
        flat = history.points_cm[own, plant].reshape(int(own.sum()), -1)
        columns = [np.interp(at, rows[own], column) for column in flat.T]
        points[:, plant] = np.stack(columns, axis=-1).reshape(points[:, plant].shape)
        missing = ~own[nearest]
        missing[[0, -1]] = False
        points[missing, plant] = np.nan
    middle = np.minimum(((at[:-1] + at[1:]) / 2.0).astype(np.int64), max(last - 1, 0))
    covariates = {name: values[middle] for name, values in history.covariates.items()}
    return History(points, history.light[middle], history.step_s, covariates)
