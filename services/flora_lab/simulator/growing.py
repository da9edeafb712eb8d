"""Simulators whose stems grow as chains of segments: under the mechanistic law, or under a learned one.

Individuals are drawn, or recognised from what was seen of them; what happens by chance acts through the law's drives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final

import numpy as np

from flora_common.arrays import Array
from flora_common.errors import BadInput
from flora_lab.simulator.drives import DriveNoise, Drives
from flora_lab.simulator.individual import Observed, Prior, covariance_of, fit
from flora_lab.simulator.interface import Chance, Covariates, History, Simulator
from flora_lab.simulator.law import Law, Stems, advanced, standing
from flora_lab.simulator.measured import STEP_S, MeasuredRun
from flora_lab.simulator.store import Stored
from flora_lab.threads import one_blas_thread

LONGEST_STEP_S: Final = 86_400.0
LIT_BEFORE_S: Final = 3600.0
"""How long the lamps that shone before a start are taken to have shone: plants answer within half an hour."""
_INDIVIDUAL: Final = 10
"""Stream of random numbers that a plant's traits are drawn from; its drives have others."""


@dataclass(frozen=True, slots=True)
class GrowingState:
    """Plants at a time.

    Attributes:
        stems: and what the plants remember.
        traits: of each plant, shape (batch, traits).
        steps: made since the start.
        processes: state of the drives, shape (batch, channels), or None where nothing happens by chance.
        drives: None where nothing happens by chance.
        member: which part of a law that has several each plant follows, shape (batch,), see
            :class:`flora_lab.simulator.sequence.SequenceSimulator`; None where all follow the law itself.
    """

    stems: Stems
    traits: Array
    steps: int = 0
    processes: Array | None = None
    drives: Drives | None = None
    member: Array | None = None


@dataclass(frozen=True, slots=True)
class DataRange:
    """What the runs that a simulator was learned from had shown.

    Attributes:
        longest_cm: the longest stem.
        widest_cm: the tip that was farthest to a side.
    """

    longest_cm: float
    widest_cm: float


class GrowingSimulator(Simulator[GrowingState]):
    """A law, what is known of plants under it, and what happens by chance.

    Args:
        law: what makes stems bend and grow.
        prior: of the traits of a plant that was never seen.
        noise: what happens by chance.
        shown: beyond it the simulator extrapolates.
        step_s: the step of the runs that it was learned from.

    Raises:
        ValueError: a prior of other traits than the law's.
    """

    law_error_cm: ClassVar[float] = 0.0
    """How far from a plant the law itself is to be taken for when a plant is recognised: what is seen within it tells
    nothing of the individual."""

    def __init__(self, law: Law, prior: Prior, noise: DriveNoise, shown: DataRange, step_s: float = STEP_S) -> None:
        if prior.mean.shape != (len(law.traits),):
            raise ValueError(f"a prior of {prior.mean.shape} traits; the law has {', '.join(law.traits)}")
        self.law = law
        self.prior = prior
        self.noise = noise
        self.shown = shown
        self.step_s = step_s
        self._root = np.linalg.cholesky(prior.covariance)

    @property
    def has_individuals(self) -> bool:
        return True

    def start(self, points_cm: Array, chance: Chance | None = None, before: Array | None = None) -> GrowingState:
        stems = standing(self.law, points_cm)
        traits = np.repeat(self.prior.mean[None], len(stems.count), axis=0)
        if before is not None:
            light = np.repeat(np.asarray(before, dtype=np.float64)[None], round(LIT_BEFORE_S / STEP_S), axis=0)
            stems = replace(stems, memory=self._at_start(self._memory_after(stems, traits, light, STEP_S)))
        if chance is None:
            return GrowingState(stems, traits)
        drives = Drives(self.noise, chance.seeds)
        count = len(self.prior.mean)
        away = [np.random.default_rng([int(s), _INDIVIDUAL]).standard_normal(count) for s in chance.seeds]
        traits = traits + np.stack([self._root @ a for a in away])
        member = self._drawn_members(chance)
        return GrowingState(stems, traits, processes=drives.start(), drives=drives, member=member)

    def watch(self, history: History) -> GrowingState:
        return self.known(history, self.recognised(history))

    def recognised(self, history: History) -> Array:
        """Which individuals the plants of ``history`` are: their traits, shape (batch, traits)."""
        batch = history.points_cm.shape[1]
        traits = np.repeat(self.prior.mean[None], batch, axis=0)
        if len(history.points_cm) > 1:
            with one_blas_thread():
                for b in range(batch):
                    traits[b] = self._recognised(history, b)
        return traits

    def known(self, history: History, traits: Array) -> GrowingState:
        """Plants after ``history``, as :meth:`watch`; which individuals they are is known, traits (batch, traits)."""
        stems = standing(self.law, history.points_cm[-1])
        if len(history.points_cm) == 1:
            return GrowingState(stems, traits)
        first = standing(self.law, history.points_cm[0])
        memory = self._memory_after(first, traits, history.light, history.step_s)
        return GrowingState(replace(stems, memory=memory), traits)

    def _law_during(self, covariates: Mapping[str, Array]) -> Law:
        """The law, as it is under these covariates from its first step on: name to shape (steps, batch)."""
        return self.law

    def _drawn_members(self, chance: Chance) -> Array | None:
        """See :attr:`GrowingState.member`."""
        return None

    def _advanced(
        self, law: Law, state: GrowingState, light: Array, bias: Array, growth: Array, step_h: float
    ) -> Stems:
        """See :func:`flora_lab.simulator.law.advanced`."""
        return advanced(law, state.stems, state.traits, light, bias, growth, step_h)

    def _at_start(self, memory: Array) -> Array:
        """What plants remember of the time before a run, shape (batch, ...), when it starts."""
        return memory

    def _memory_after(self, first: Stems, traits: Array, light: Array, step_s: float) -> Array:
        """Plants remember what simulated plants of their kind remember after the same light."""
        still, whole = np.zeros(light.shape[:2]), np.ones(light.shape[:2])
        lit = np.ascontiguousarray(light, dtype=np.float64)
        return advanced(self.law, first, traits, lit, still, whole, step_s / 3600.0).memory

    def _recognised(self, history: History, b: int) -> Array:
        time_s = np.arange(len(history.points_cm), dtype=np.float64) * history.step_s
        points, light = history.points_cm[:, b], history.light[:, b]
        law = self._law_during({name: values[:, [b]] for name, values in history.covariates.items()})
        seen = Observed(MeasuredRun("", "", "", points, light, time_s, history.step_s, {}), law)
        seen_as = replace(self.noise, measure_cm=float(np.hypot(self.noise.measure_cm, self.law_error_cm)))
        return fit(seen, self.prior, covariance_of(seen.responses(self.prior.mean), seen_as)).traits

    def step(
        self, state: GrowingState, light: Array, dt_s: float, covariates: Covariates | None = None
    ) -> tuple[GrowingState, Array]:
        if not 0.0 < dt_s <= LONGEST_STEP_S:
            raise BadInput(f"a step of {dt_s:g} s: it must lie in (0, {LONGEST_STEP_S:g}]")
        batch = len(state.traits)
        levels = np.asarray(light, dtype=np.float64)
        if levels.shape != (batch, 2) or not np.isfinite(levels).all() or levels.min(initial=0.0) < 0.0:
            raise BadInput(f"light of shape {levels.shape}: expected levels from 0, shape ({batch}, 2)")
        bias, growth, processes = np.zeros(batch), np.ones(batch), state.processes
        if state.drives is not None and state.processes is not None:
            length_cm = state.stems.length_cm
            processes, bias, growth = state.drives.step(state.processes, state.steps, dt_s / 3600.0, length_cm)
        law = self._law_during({name: values[None] for name, values in (covariates or {}).items()})
        stems = self._advanced(law, state, levels[None], bias[None], growth[None], dt_s / 3600.0)
        after = replace(state, stems=stems, steps=state.steps + 1, processes=processes)
        return after, stems.points_cm

    def stems_cm(self, state: GrowingState) -> Array:
        return state.stems.points_cm

    def is_beyond_data(self, state: GrowingState) -> Array:
        tip_x_cm = state.stems.points_cm[:, -1, 0]
        too_long = state.stems.length_cm > self.shown.longest_cm
        return np.asarray(too_long | (np.abs(tip_x_cm) > self.shown.widest_cm))

    def weights(self) -> dict[str, Array]:
        """For :func:`flora_lab.simulator.store.write_simulator`."""
        return {"trait_mean": self.prior.mean, "trait_covariance": self.prior.covariance}

    def scales(self) -> dict[str, Any]:
        """For ``[scales]``: everything else, as a person can read it."""
        return {
            "longest_cm": self.shown.longest_cm,
            "widest_cm": self.shown.widest_cm,
            "noise": self.noise.as_dict(),
        }


def read_prior(stored: Stored, count: int) -> Prior:
    """The prior of a stored simulator with so many traits.

    Raises:
        BadInput: it is missing, or its covariance is none.
    """
    mean = stored.weight("trait_mean", (count,)).astype(np.float64)
    covariance = stored.weight("trait_covariance", (count, count)).astype(np.float64)
    told = f"{stored.path}: `trait_covariance` is no covariance: not symmetric, or not positive"
    if not np.allclose(covariance, covariance.T):
        raise BadInput(told)
    try:
        np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError as problem:
        raise BadInput(told) from problem
    return Prior(mean, covariance)


def read_range(stored: Stored) -> DataRange:
    """What the stored simulator was shown."""
    return DataRange(stored.scale("longest_cm"), stored.scale("widest_cm"))


def read_noise(stored: Stored) -> DriveNoise:
    """What happens by chance in the stored simulator."""
    return DriveNoise.from_table(stored.info.scales.get("noise"), where=str(stored.path))
