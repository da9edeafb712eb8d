"""The growing rod as a simulator: its constants learned from runs, individuals drawn or recognised."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from flora_common.errors import BadInput
from flora_common.runs import LampsSection
from flora_common.shapes import STEM_POINTS
from flora_lab.simulator.interface import Chance, Covariates, History, Simulator
from flora_lab.simulator.measured import STEP_S, MeasuredRun
from flora_lab.simulator.rod import advance
from flora_lab.simulator.rod_fit import Observed, Prior, covariance_of, fit
from flora_lab.simulator.rod_noise import Drives, RodNoise
from flora_lab.simulator.rod_parameters import NAMES
from flora_lab.simulator.rod_shape import points_of, rods_through
from flora_lab.simulator.store import Stored

Array = npt.NDArray[Any]

LONGEST_STEP_S: Final = 86_400.0
_INDIVIDUAL: Final = 10
"""Stream of random numbers that a plant's constants are drawn from; its drives have others."""


@dataclass(frozen=True, slots=True)
class RodState:
    """Plants at a time.

    Attributes:
        length, angle, count, seen: see :func:`flora_lab.simulator.rod.advance`.
        parameters: constants of each plant, shape (batch, 9).
        steps: made since the start.
        processes: state of the drives, shape (batch, 6), or None where nothing happens by chance.
        drives: None where nothing happens by chance.
    """

    length: Array
    angle: Array
    count: Array
    seen: Array
    parameters: Array
    steps: int = 0
    processes: Array | None = None
    drives: Drives | None = None


@dataclass(frozen=True, slots=True)
class DataRange:
    """What the runs that a rod was learned from had shown.

    Attributes:
        longest_cm: the longest stem.
        widest_cm: the tip that was farthest to a side.
    """

    longest_cm: float
    widest_cm: float


class RodSimulator(Simulator[RodState]):
    """The mechanistic model.

    Args:
        prior: of the log-constants of a plant that was never seen.
        noise: what happens by chance.
        lamps: where they hang.
        shown: beyond what lies outside it, a rod extrapolates.
        step_s: the step of the runs that it was learned from; any other can be taken.
    """

    kind: ClassVar[str] = "mechanistic"

    def __init__(
        self, prior: Prior, noise: RodNoise, lamps: LampsSection, shown: DataRange, step_s: float = STEP_S
    ) -> None:
        self.prior = prior
        self.noise = noise
        self.lamps = lamps
        self.shown = shown
        self.step_s = step_s
        self._lamps_cm = np.array([lamps.distance_cm, lamps.height_cm])
        self._root = np.linalg.cholesky(prior.covariance)

    def start(self, points_cm: Array, chance: Chance | None = None) -> RodState:
        length, angle, count = rods_through(points_cm)
        batch = len(count)
        log_parameters = np.repeat(self.prior.mean[None], batch, axis=0)
        state = RodState(length, angle, count, np.zeros((batch, 2, 2)), np.exp(log_parameters))
        if chance is None:
            return state
        drives = Drives(self.noise, chance.seeds)
        away = [np.random.default_rng([int(s), _INDIVIDUAL]).standard_normal(len(NAMES)) for s in chance.seeds]
        parameters = np.exp(log_parameters + np.stack([self._root @ a for a in away]))
        return replace(state, parameters=parameters, drives=drives, processes=drives.start())

    def watch(self, history: History) -> RodState:
        batch = history.points_cm.shape[1]
        parameters = np.repeat(np.exp(self.prior.mean)[None], batch, axis=0)
        if len(history.points_cm) > 1:
            for b in range(batch):
                parameters[b] = self._recognised(history, b)
        length, angle, count = rods_through(history.points_cm[-1])
        seen = self._seen_after(history, parameters)
        return RodState(length, angle, count, seen, parameters)

    def _recognised(self, history: History, b: int) -> Array:
        time_s = np.arange(len(history.points_cm), dtype=np.float64) * history.step_s
        points, light = history.points_cm[:, b], history.light[:, b]
        run = MeasuredRun("", "", "", points, light, time_s, history.step_s, {}, self.lamps)
        seen = Observed(run, self.lamps)
        answer = seen.responses(np.exp(self.prior.mean))
        return np.exp(fit(seen, self.prior, covariance_of(answer, self.noise)).log_parameters)

    def _seen_after(self, history: History, parameters: Array) -> Array:
        """What the plants see of the lamps at the end of a history, shape (batch, 2, 2)."""
        length, angle, count = rods_through(history.points_cm[0])
        state = RodState(length, angle, count, np.zeros((len(count), 2, 2)), parameters)
        if not len(history.light):
            return state.seen
        light = np.ascontiguousarray(history.light)
        return self._advanced(state, light, np.zeros(light.shape[:2]), np.ones(light.shape[:2]), history.step_s).seen

    def step(
        self, state: RodState, light: Array, dt_s: float, covariates: Covariates | None = None
    ) -> tuple[RodState, Array]:
        if not 0.0 < dt_s <= LONGEST_STEP_S:
            raise BadInput(f"a step of {dt_s:g} s: it must lie in (0, {LONGEST_STEP_S:g}]")
        batch = len(state.count)
        levels = np.asarray(light, dtype=np.float64)
        if levels.shape != (batch, 2) or not np.isfinite(levels).all() or levels.min(initial=0.0) < 0.0:
            raise BadInput(f"light of shape {levels.shape}: expected levels from 0, shape ({batch}, 2)")
        bias, growth, processes = np.zeros(batch), np.ones(batch), state.processes
        if state.drives is not None and state.processes is not None:
            total = state.length.sum(axis=1)
            processes, bias, growth = state.drives.step(state.processes, state.steps, dt_s / 3600.0, total)
        after = self._advanced(state, levels[None], bias[None], growth[None], dt_s)
        after = replace(after, steps=state.steps + 1, processes=processes)
        return after, self.stems_cm(after)

    def _advanced(self, state: RodState, light: Array, bias: Array, growth: Array, dt_s: float) -> RodState:
        length, angle, count, seen = (a.copy() for a in (state.length, state.angle, state.count, state.seen))
        lamps = np.repeat(self._lamps_cm[None], len(count), axis=0)
        none = np.empty((0, len(count), STEM_POINTS, 2))
        parameters = np.ascontiguousarray(state.parameters)
        steps = len(light)
        advance(length, angle, count, seen, parameters, lamps, light, bias, growth, dt_s / 3600.0, steps + 1, none)
        return replace(state, length=length, angle=angle, count=count, seen=seen)

    def stems_cm(self, state: RodState) -> Array:
        return points_of(state.length, state.angle, state.count)

    def is_beyond_data(self, state: RodState) -> Array:
        tip_x = self.stems_cm(state)[:, -1, 0]
        return np.asarray((state.length.sum(axis=1) > self.shown.longest_cm) | (np.abs(tip_x) > self.shown.widest_cm))

    def weights(self) -> dict[str, Array]:
        """For :func:`flora_lab.simulator.store.write_simulator`."""
        return {"log_mean": self.prior.mean, "log_covariance": self.prior.covariance}

    def scales(self) -> dict[str, Any]:
        """For ``[scales]``: everything else, as a person can read it."""
        return {
            "lamp_distance_cm": self.lamps.distance_cm,
            "lamp_height_cm": self.lamps.height_cm,
            "longest_cm": self.shown.longest_cm,
            "widest_cm": self.shown.widest_cm,
            "typical": dict(zip(NAMES, np.exp(self.prior.mean).tolist(), strict=True)),
            "noise": self.noise.as_dict(),
        }

    @staticmethod
    def from_stored(stored: Stored) -> RodSimulator:
        """Undo :meth:`weights` and :meth:`scales`.

        Raises:
            BadInput: something is missing, or cannot be a plant's.
        """
        count = len(NAMES)
        covariance = stored.weight("log_covariance", (count, count)).astype(np.float64)
        if not np.allclose(covariance, covariance.T) or np.linalg.eigvalsh(covariance).min() <= 0.0:
            raise BadInput(f"{stored.path}: `log_covariance` is no covariance: not symmetric, or not positive")
        return RodSimulator(
            Prior(stored.weight("log_mean", (count,)).astype(np.float64), covariance),
            RodNoise.from_table(stored.info.scales.get("noise"), where=str(stored.path)),
            LampsSection(stored.scale("lamp_distance_cm"), stored.scale("lamp_height_cm")),
            DataRange(stored.scale("longest_cm"), stored.scale("widest_cm")),
            stored.info.step_s,
        )
