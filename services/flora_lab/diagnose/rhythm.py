"""A swing of the tip that no lamp causes: found in the spectrum of what is left of a run, beside that of others.

Hourly means do not show swings of an hour and a half. Here the residual of the tip is looked at in steps of minutes.
Its spectrum is compared with that of reference runs by Whittle's likelihood: for each frequency, the periodogram over
its expectation is exponential. A swing adds a line of its own, as wide as its phase drifts. All periods of a fine grid
are tried, and the price of having looked at so many is paid.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import Array

PERIODS_H: Final = (1.1, 2.8)
PLAUSIBLE_H: Final = (1.15, 2.65)
LEAST_CM: Final = 0.12
_ABOUT: Final = 0.2
_AMPLITUDE_SHARE: Final = 0.08
PER_HOUR: Final = 1.0 / 140.0
"""Distance of the frequencies that are tried, 1/h: two runs of three days tell them apart."""
COHERENCE_H: Final = (6.0, 30.0, 150.0)
"""Times over which a swing keeps its phase, that are tried."""
_OVERTONES: Final = (0.0, 0.1)
"""Shares of a swing's power that its overtone has, that are tried: a lamp that follows the tip switches with it."""
_MORE: Final = (1.0, 4.0, 16.0, 64.0)
"""So many times what is usual a run may have everywhere in the band, swing or none: what is wrong in it otherwise."""
_REACH_SHARE: Final = 0.15
"""A line ends about so far from its middle, as a share of the frequency: with the tails of one that keeps its phase for
some hours, any period would explain any other."""
BAND_H: Final = (0.7, 4.0)
_AMPLITUDES_CM: Final = np.geomspace(0.05, 4.0, 56)
_LEAST_VARIANCE_CM2: Final = 2.5e-9
LINES: Final = 3
"""Neighbouring lines of a spectrum over which a swing that does not keep its phase is spread."""
_SMOOTH_SHARE: Final = 0.12
_FLOOR_SHARE: Final = 0.02
LOOKED: Final = float(np.log(65.0 * len(_OVERTONES)))
"""The price of having looked at all periods, with and without an overtone, in nats."""
ALONE: Final = 7.0
"""Nats that a swing takes more which one of several runs shows alone: any plant may waver more than the others do."""


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Of what is left of a run's tip.

    Attributes:
        per_hour: frequencies within the band, shape (n,).
        power: periodogram there, cm^2 h, shape (n,).
        hours: length of what it is from.
    """

    per_hour: Array
    power: Array
    hours: float

    @property
    def spacing_per_hour(self) -> float:
        """Between two frequencies."""
        return float(self.per_hour[1] - self.per_hour[0])


def amplitude_of(variance: Array | float) -> Array:
    """Amplitude of a swing whose power at positive frequencies, summed over these, is ``variance``.

    A spectrum is two-sided: half of a swing's variance, of half its amplitude squared, lies there.
    """
    return np.asarray(2.0 * np.sqrt(variance))


@dataclass(frozen=True, slots=True)
class Swing:
    """The best swing.

    Attributes:
        period_h, amplitude_cm: of the tip, in the picture plane.
        coherence_h: over which it keeps its phase.
        evidence: in nats, for it and against none, after what looking cost.
        period_interval_h, amplitude_interval_cm: of 90 %.
    """

    period_h: float
    amplitude_cm: float
    coherence_h: float
    evidence: float
    period_interval_h: tuple[float, float]
    amplitude_interval_cm: tuple[float, float]


def spectrum(residual_cm: Array, step_h: float) -> Spectrum:
    """The periodogram of a tip's residual, shape (n,); NaN where nothing was measured."""
    at = np.arange(len(residual_cm))
    known = np.isfinite(residual_cm)
    filled = np.interp(at, at[known], residual_cm[known])
    taper = np.hanning(len(filled) + 2)[1:-1]
    # Slow errors leak far: what a moving mean of four hours tells is taken out before.
    width = max(3, round(BAND_H[1] / step_h) | 1)
    padded = np.pad(filled, width // 2, mode="reflect", reflect_type="odd") if len(filled) > width else filled
    kernel = np.hanning(width + 2)[1:-1]
    slow = np.convolve(padded, kernel / kernel.sum(), mode="same")
    slow = slow[width // 2 : width // 2 + len(filled)] if len(filled) > width else np.full(len(filled), filled.mean())
    rest = (filled - slow) * taper
    power = np.abs(np.fft.rfft(rest)) ** 2 * step_h / np.sum(taper**2)
    per_hour = np.fft.rfftfreq(len(rest), step_h)
    band = (per_hour >= 1.0 / BAND_H[1]) & (per_hour <= 1.0 / BAND_H[0])
    return Spectrum(per_hour[band], power[band], len(filled) * step_h)


@dataclass(frozen=True, slots=True)
class Swings:
    """What reference runs have in the band.

    Attributes:
        per_hour, power: of the swings that are there anyway, smooth in frequency.
        follows: share of the simulated tip's own power that is left over, because no law is right in everything:
            where lamps make the tip swing, what is left swings too.
    """

    per_hour: Array
    power: Array
    follows: float

    def expected(self, simulated: Spectrum) -> Array:
        """The power that is expected of what is left of a run in which the simulated tip does this, shape (n,)."""
        return np.asarray(self.expectations(simulated)[0])

    def expectations(self, simulated: Spectrum) -> Array:
        """The same for a run that is as usual, and for such as have more of it everywhere, shape (4, n)."""
        own = np.exp(np.interp(np.log(simulated.per_hour), np.log(self.per_hour), np.log(self.power)))
        return np.asarray(np.array(_MORE)[:, None] * own + self.follows * simulated.power)


_FOLLOWS: Final = (0.0, *np.geomspace(1e-4, 0.3, 22).tolist())


def usual(left: Sequence[Spectrum], simulated: Sequence[Spectrum]) -> Swings:
    """What is usual, from what is left of reference runs and what their simulated tips do."""
    power = np.concatenate([s.power for s in left])
    moved = np.concatenate([s.power for s in simulated])
    at = np.concatenate([s.per_hour for s in left])
    grid = np.linspace(1.0 / BAND_H[1], 1.0 / BAND_H[0], 60)
    away = np.log(at[:, None] / grid[None, :]) / _SMOOTH_SHARE
    weight = np.exp(-0.5 * away**2)
    weight /= weight.sum(axis=0)
    best: Swings | None = None
    most = -np.inf
    for share in _FOLLOWS:
        rest = np.maximum(power - share * moved, _FLOOR_SHARE * power)
        smooth = np.maximum(rest @ weight, _FLOOR_SHARE * float(np.median(power)) + 1e-12)
        tried = Swings(grid, smooth, float(share))
        total = 0.0
        for own, sim in zip(left, simulated, strict=True):
            expected = tried.expected(sim)
            total -= improbability(own, expected)
        if total > most:
            best, most = tried, total
    assert best is not None
    return best


def improbability(own: Spectrum, expected: Array) -> float:
    """Whittle's: minus the logarithm of how probable a spectrum is, up to a constant.

    Args:
        own: the spectrum.
        expected: shape (n,), or (k, n), of which that counts under which it is most probable.
    """
    return -float(_probability(own, expected).max())


def _probability(own: Spectrum, expected: Array) -> Array:
    """The logarithm of how probable a spectrum is under expectations (..., n), up to a constant, shape (...)."""
    return np.asarray(-(np.log(expected) + own.power / expected).sum(axis=-1))


def best_swing(
    spectra: Sequence[Spectrum], expectations: Sequence[Array], sideways: Sequence[float] | None = None
) -> Swing:
    """The swing, of one period and amplitude in all runs, that explains their spectra best.

    Args:
        spectra: of the runs.
        expectations: without it, of each run, see :meth:`Swings.expectations`.
        sideways: how much of a swing's power is sideways in each run, the rest being up and down; all where None.
    """
    ends = 1.0 / PERIODS_H[1], 1.0 / PERIODS_H[0]
    tried = np.arange(ends[0], ends[1], PER_HOUR)
    kinds = list(itertools.product(COHERENCE_H, _OVERTONES))
    by_run = np.zeros((len(spectra), len(kinds), len(tried), len(_AMPLITUDES_CM)))
    for likelihood, own, expected in zip(by_run, spectra, expectations, strict=True):
        without = -improbability(own, expected)
        for c, (coherence_h, overtone) in enumerate(kinds):
            line = _line(own, tried, coherence_h) + overtone * _line(own, 2.0 * tried, coherence_h)
            for a, amplitude in enumerate(_AMPLITUDES_CM):
                swinging = [_probability(own, usual + amplitude**2 * line) for usual in expected]
                likelihood[c, :, a] = np.max(swinging, axis=0) - without
    together = by_run.sum(axis=0)
    best, at, size = np.unravel_index(np.argmax(together), together.shape)
    top, each = together[best], by_run[:, best, at, size]
    is_alone = len(each) > 1 and each.sum() <= each.max()
    weights = np.exp(top - top.max())
    by_period = weights.sum(axis=1)
    period = _middle(1.0 / tried[::-1], by_period[::-1])
    shares = [1.0] * len(spectra) if sideways is None else sideways
    amplitude_cm, interval_cm = _amplitude(spectra, [own[0] for own in expectations], shares, 1.0 / period[1])
    return Swing(
        period_h=period[1],
        amplitude_cm=amplitude_cm,
        coherence_h=kinds[best][0],
        evidence=float(top.max()) - LOOKED - 1.0 - (ALONE if is_alone else 0.0),
        period_interval_h=(period[0], period[2]),
        amplitude_interval_cm=interval_cm,
    )


def power_of(swing: Swing, own: Spectrum) -> Array:
    """Power that is expected of a swing at the frequencies of a spectrum, cm^2 h, shape (n,)."""
    return np.asarray(swing.amplitude_cm**2 * _line(own, np.array([1.0 / swing.period_h]), swing.coherence_h)[0])


def _line(own: Spectrum, at: Array, coherence_h: float) -> Array:
    """Power of a swing of amplitude 1 at each of some frequencies, 1/h, as a run shows it, shape (frequencies, n)."""
    half = 1.0 / (2.0 * np.pi * coherence_h) + 0.6 / own.hours
    away = own.per_hour[None, :] - at[:, None]
    # Two-sided: half of the variance A^2 / 2 lies at positive frequencies.
    line = 0.25 / (np.pi * half) / (1.0 + (away / half) ** 2)
    return np.asarray(line * np.exp(-0.5 * (away / (_REACH_SHARE * at[:, None])) ** 2))


def _amplitude(
    spectra: Sequence[Spectrum], usual_power: Sequence[Array], sideways: Sequence[float], per_hour: float
) -> tuple[float, tuple[float, float]]:
    """Amplitude of a swing, cm, with its interval of 90 %: from all the power about its frequency that is not usual.

    Its line is as wide as its phase drifts and its size grows, which no shape of a line would know beforehand.
    """
    variances = []
    for own, expected, share in zip(spectra, usual_power, sideways, strict=True):
        near = np.abs(np.log(own.per_hour / per_hour)) < _ABOUT
        variances.append(own.spacing_per_hour * float((own.power[near] - expected[near]).sum()) / share)
    amplitude = float(amplitude_of(max(float(np.mean(variances)), _LEAST_VARIANCE_CM2)))
    own_cm = amplitude_of(np.maximum(np.array(variances), _LEAST_VARIANCE_CM2))
    sd = float(np.hypot(np.std(own_cm) / np.sqrt(max(len(own_cm) - 1, 1)), _AMPLITUDE_SHARE * amplitude))
    return amplitude, (max(0.0, amplitude - 1.645 * sd), amplitude + 1.645 * sd)


def is_plausible(swing: Swing) -> bool:
    """Whether it can be one: its period not at the edge of what was looked at, its size not that of an error."""
    return PLAUSIBLE_H[0] <= swing.period_h <= PLAUSIBLE_H[1] and swing.amplitude_cm >= LEAST_CM


def _middle(values: Array, weights: Array) -> tuple[float, float, float]:
    """5 %, mean and 95 % of a distribution on a grid."""
    # Half of what lies on a place of the grid lies before it: all of it may be there.
    share = (np.cumsum(weights) - 0.5 * weights) / weights.sum()
    low, high = np.interp([0.05, 0.95], share, values)
    return float(low), float(values @ weights / weights.sum()), float(high)
