"""What happens to a plant by chance: slow wander and circumnutation of its bending, noise of its growth.

The parts are Gaussian processes of a law's two drives (bias of bending, factor on growth). Their effect on a track is
linear to good approximation, so that the covariance of what is measured follows from the law's own response to a push
at each time: no simulation by chance is needed to fit it, and errors of a free run, which grow and swing slowly, are
never taken for independent ones.
"""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Final

import numpy as np

from flora_common.arrays import Array
from flora_common.errors import BadInput
from flora_lab.simulator.rod import jit

BLOCK: Final = 512
CHANNELS: Final = 6
"""Normal numbers per step: wander, two quadratures of circumnutation, growth, two quadratures of the day's rhythm."""
DAY_H: Final = 24.0
REFERENCE_CM: Final = 20.0
"""Stem length at which ``nutation_per_cm_h`` holds."""


@dataclass(frozen=True, slots=True)
class DriveNoise:
    """Sizes and times of what happens by chance; all positive.

    Attributes:
        measure_cm: standard deviation of a measured coordinate about the stem, with what the linear approximation of
            the noise's effect leaves.
        wander_per_cm_h, wander_h: standard deviation and correlation time of a slow bias of bending.
        nutation_per_cm_h: root mean square of the circumnutation's bias in the picture plane at a length of 20 cm.
        nutation_exponent: power of the stem's length with which it grows.
        nutation_period_min: its period, over plants.
        nutation_coherence_h: how long the phase stays predictable, given the period of no plant is known beforehand.
        growth_share, growth_h: standard deviation and correlation time of the relative rate of growth.
        rhythm_share: root mean square of a rhythm of growth of 24 h, of a phase that no plant is known by beforehand.
    """

    measure_cm: float = 0.05
    wander_per_cm_h: float = 0.02
    wander_h: float = 4.0
    nutation_per_cm_h: float = 0.08
    nutation_exponent: float = 2.0
    nutation_period_min: float = 98.6
    nutation_coherence_h: float = 5.0
    growth_share: float = 0.10
    growth_h: float = 5.0
    rhythm_share: float = 0.05

    def bias_covariance(self, time_h: Array, length_cm: Array) -> Array:
        """Of the bias at times (n,) when the stem is that long; shape (n, n)."""
        lag_h = np.abs(time_h[:, None] - time_h[None, :])
        size = (length_cm / REFERENCE_CM) ** self.nutation_exponent
        turning = np.cos(2 * np.pi * 60.0 * lag_h / self.nutation_period_min) * np.exp(
            -lag_h / self.nutation_coherence_h
        )
        nutation = self.nutation_per_cm_h**2 * size[:, None] * size[None, :] * turning
        return np.asarray(self.wander_per_cm_h**2 * np.exp(-lag_h / self.wander_h) + nutation)

    def growth_covariance(self, time_h: Array) -> Array:
        """Of the relative rate of growth at times (n,); shape (n, n)."""
        lag_h = np.abs(time_h[:, None] - time_h[None, :])
        rhythm = self.rhythm_share**2 * np.cos(2 * np.pi * lag_h / DAY_H)
        return np.asarray(self.growth_share**2 * np.exp(-lag_h / self.growth_h) + rhythm)

    def as_array(self) -> Array:
        """Logarithms in the order of :data:`NOISE_NAMES`."""
        return np.log([getattr(self, name) for name in NOISE_NAMES])

    def with_array(self, values: Array) -> DriveNoise:
        """Undo :meth:`as_array`."""
        return replace(self, **dict(zip(NOISE_NAMES, np.exp(values).tolist(), strict=True)))

    def as_dict(self) -> dict[str, float]:
        return asdict(self)

    @staticmethod
    def from_table(table: Any, *, where: str) -> DriveNoise:
        """Undo :meth:`as_dict`.

        Raises:
            BadInput: a number is missing, unknown, or not positive.
        """
        if not isinstance(table, dict) or set(table) != set(NOISE_NAMES):
            raise BadInput(f"{where}: scales.noise must name {', '.join(NOISE_NAMES)}")
        for name, value in table.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < 1e6:
                raise BadInput(f"{where}: scales.noise.{name} is {str(value)[:40]}, not a positive number")
        return DriveNoise(**{name: float(value) for name, value in table.items()})


NOISE_NAMES: Final = tuple(field.name for field in fields(DriveNoise))


class Drives:
    """The drives of some plants, step by step: Gauss-Markov processes with the covariances of :class:`DriveNoise`.

    Args:
        noise: sizes and times.
        seeds: one per plant; what happens to a plant follows from its seed and the number of the step alone.
    """

    def __init__(self, noise: DriveNoise, seeds: Array) -> None:
        self._noise = noise
        self.seeds = np.asarray(seeds, dtype=np.int64)

    def start(self) -> Array:
        """The processes before the first step, in their stationary state; shape (batch, 6)."""
        return np.stack([np.random.default_rng([int(s), 11]).standard_normal(CHANNELS) for s in self.seeds])

    def normals(self, step: int) -> Array:
        """Fresh normal numbers for one step, shape (batch, 6)."""
        block, at = divmod(step, BLOCK)
        return np.asarray(_drawn(self.seeds.tobytes(), block)[at])

    def step(self, processes: Array, step: int, dt_h: float, length_cm: Array) -> tuple[Array, Array, Array]:
        """One step.

        Args:
            processes: shape (batch, 6), of :meth:`start` or the step before.
            step: its number, from 0.
            dt_h: its length in hours.
            length_cm: of the stems, shape (batch,).

        Returns:
            The processes after it, the bias (batch,) in 1/(cm h), and the factor on growth (batch,).
        """
        noise, fresh = self._noise, self.normals(step)
        after = np.empty_like(processes)
        for channel, memory_h in ((0, noise.wander_h), (3, noise.growth_h)):
            after[:, channel] = _decayed(processes[:, channel], fresh[:, channel], dt_h / memory_h)
        for first, period_h, share in (
            (1, noise.nutation_period_min / 60.0, dt_h / noise.nutation_coherence_h),
            (4, DAY_H, 0.0),
        ):
            turn = 2 * np.pi * dt_h / period_h
            re, im = processes[:, first], processes[:, first + 1]
            after[:, first] = _decayed(re * np.cos(turn) - im * np.sin(turn), fresh[:, first], share)
            after[:, first + 1] = _decayed(re * np.sin(turn) + im * np.cos(turn), fresh[:, first + 1], share)
        size = _nutation_sizes(length_cm, noise.nutation_per_cm_h, noise.nutation_exponent)
        bias = noise.wander_per_cm_h * after[:, 0] + size * after[:, 1]
        growth = 1.0 + noise.growth_share * after[:, 3] + noise.rhythm_share * after[:, 4]
        return after, bias, np.maximum(growth, 0.0)


@jit
def nutation_size(length_cm: float, per_cm_h: float, exponent: float) -> float:
    """Root mean square of the circumnutation's bias for a stem of this length, 1/(cm h).

    Compiled, because numpy's power differs in the last bit from that of other compiled loops.
    """
    return float(per_cm_h * (length_cm / REFERENCE_CM) ** exponent)


@jit
def _nutation_sizes(length_cm: Array, per_cm_h: float, exponent: float) -> Array:
    sizes = np.empty(len(length_cm))
    for b in range(len(length_cm)):
        sizes[b] = nutation_size(length_cm[b], per_cm_h, exponent)
    return sizes


@functools.lru_cache(maxsize=8)
def _drawn(seeds: bytes, block: int) -> Array:
    """Normal numbers of a block of steps, shape (BLOCK, batch, 6): a function of seeds and number alone."""
    draws = [
        np.random.default_rng([int(seed), 12, block]).standard_normal((BLOCK, CHANNELS))
        for seed in np.frombuffer(seeds, dtype=np.int64)
    ]
    return np.stack(draws, axis=1)


def _decayed(value: Array, fresh: Array, share: float) -> Array:
    return np.asarray(value * np.exp(-share) + np.sqrt(-np.expm1(-2.0 * share)) * fresh)
