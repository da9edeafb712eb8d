"""Cycle by cycle: where the tip turns, how long each cycle is, how far it swings, and whether ever farther."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.rhythm.lattice import detrended, drawn, lattice
from flora_lab.rhythm.search import INTERVAL, Found, bridged

BAND: Final = 0.3
"""Width of the pass band about the swing's frequency, as a natural logarithm: one standard deviation."""
CLEAR: Final = 1.5
"""A cycle counts where the swing is so many times what noise does in the band."""
_EDGE_CYCLES: Final = 0.5
"""Nearer to an end a peak shifts: what comes after is guessed."""
_DRAWN: Final = 200
_FEWEST: Final = 2


@dataclass(frozen=True, slots=True)
class Cycles:
    """What the band of the swing holds.

    Attributes:
        band: the record in it, shape (n,).
        envelope: half the swing, middle to side, shape (n,).
        peaks: where it is farthest to the right, in samples, increasing.
        periods: between neighbouring peaks, in samples; NaN where a cycle between them is not clear.
        amplitude: root mean square over the record, as that of a steady swing, less noise.
        amplitude_interval: of 90 %.
        growth_per_cycle: factor by which it swings farther from one cycle to the next, over the whole record.
        growth_interval: of 90 %, from swings that do not grow.
    """

    band: Array
    envelope: Array
    peaks: Array
    periods: Array
    amplitude: float
    amplitude_interval: tuple[float, float]
    growth_per_cycle: float
    growth_interval: tuple[float, float]

    @property
    def clear_periods(self) -> Array:
        """Of the cycles that are clear, in samples."""
        return np.asarray(self.periods[np.isfinite(self.periods)])

    @property
    def scatter(self) -> float:
        """Standard deviation of the clear cycles' periods, in samples; NaN for fewer than two."""
        clear = self.clear_periods
        return float(np.std(clear, ddof=1)) if len(clear) >= _FEWEST else float("nan")


def cycles(values: Array, known: Array, found: Found, *, seed: int = 1) -> Cycles:
    """The cycles of a record.

    Args:
        values: shape (n,), in equal steps, gaps bridged.
        known: where they were measured, shape (n,).
        found: its best swing.
        seed: of the swings that are drawn for the intervals.
    """
    n, frequency = len(values), found.per_sample
    grid = lattice(n)
    signal = analytic(values, frequency)
    envelope = np.abs(signal)
    noise = float(np.sum(found.noise * _two_sided(grid.fine) * _passed(grid.fine, frequency) ** 2))
    peaks, is_clear = _peaks(signal, frequency, CLEAR * np.sqrt(2.0 * noise))
    both = is_clear[:-1] & is_clear[1:]
    periods = np.where(both, np.diff(peaks), np.nan)
    rng = np.random.default_rng(seed)
    swings = drawn(np.broadcast_to(found.line, (_DRAWN, len(found.line))), n, rng)
    others = drawn(np.broadcast_to(found.noise, (_DRAWN, len(found.noise))), n, rng)
    # Each as large as the one of the record: how well it is measured, not how it might have been.
    seen = _amplitude(envelope, noise)
    swings *= seen / np.sqrt(2.0 * np.mean(swings**2, axis=1, keepdims=True))
    tried = analytic(bridged(swings + others, known), frequency)
    spread = np.array([_amplitude(np.abs(one), noise) for one in tried]) / seen
    growths = np.array([_growth(np.abs(one), frequency) for one in tried])
    growth = _growth(envelope, frequency)
    tail = 50.0 * (1.0 - INTERVAL)
    low, middle, high = np.percentile(spread, [tail, 50.0, 100.0 - tail]).tolist()
    fewer, more = np.percentile(growths, [tail, 100.0 - tail]).tolist()
    return Cycles(
        band=signal.real,
        envelope=envelope,
        peaks=peaks[is_clear],
        periods=_between_clear(periods, is_clear),
        # What a swing whose phase drifts loses at the edges of the band is given back.
        amplitude=seen / middle,
        amplitude_interval=(seen / high, seen / max(low, 1e-3)),
        growth_per_cycle=float(np.exp(growth)),
        growth_interval=(float(np.exp(growth - more)), float(np.exp(growth - fewer))),
    )


def analytic(values: Array, per_sample: float) -> Array:
    """Records in the band about a frequency, complex: real part the band itself, magnitude half the swing.

    Args:
        values: shape (..., n).
        per_sample: the middle of the band, cycles per sample.
    """
    n = values.shape[-1]
    edge = [(0, 0)] * (values.ndim - 1) + [(n - 1, n - 1)]
    padded = np.pad(detrended(values), edge, mode="reflect", reflect_type="odd")
    frequencies = np.fft.fftfreq(padded.shape[-1])
    keep = np.where(frequencies > 0.0, 2.0 * _passed(np.maximum(frequencies, 1e-12), per_sample), 0.0)
    return np.asarray(np.fft.ifft(np.fft.fft(padded, axis=-1) * keep, axis=-1)[..., n - 1 : 2 * n - 1])


def _passed(frequencies: Array, per_sample: float) -> Array:
    return np.asarray(np.exp(-0.5 * (np.log(np.maximum(frequencies, 1e-12) / per_sample) / BAND) ** 2))


def _two_sided(fine: Array) -> Array:
    """Weight of each fine frequency in the variance of a record."""
    weights = np.full(len(fine), 2.0)
    weights[[0, -1]] = 1.0
    return np.asarray(weights / weights.sum())


def _peaks(signal: Array, per_sample: float, least: float) -> tuple[Array, Array]:
    """Places of all peaks, and whether each is clear."""
    n = len(signal)
    phase = np.unwrap(np.angle(signal))
    turns = np.floor(phase / (2.0 * np.pi))
    before = np.flatnonzero(np.diff(turns) == 1.0)
    beyond = phase[before + 1] - turns[before + 1] * 2.0 * np.pi
    peaks = before + 1.0 - beyond / (phase[before + 1] - phase[before])
    edge = _EDGE_CYCLES / per_sample
    strength = np.interp(peaks, np.arange(n), np.abs(signal))
    return peaks, (strength >= least) & (peaks >= edge) & (peaks <= n - 1 - edge)


def _between_clear(periods: Array, is_clear: Array) -> Array:
    """One period after each clear peak but the last; NaN where the next clear peak is not the next peak."""
    clear = np.flatnonzero(is_clear)
    return np.array([periods[i] if is_clear[i + 1] else np.nan for i in clear[:-1]])


def _amplitude(envelope: Array, noise: float) -> float:
    power = float(np.mean(envelope**2))
    return float(np.sqrt(max(power - 2.0 * noise, 0.05 * power)))


def _growth(envelope: Array, per_sample: float) -> float:
    """Slope of the logarithm of the envelope, per cycle; the ends, where the band is guessed, are left out."""
    edge = round(0.25 * _EDGE_CYCLES / per_sample)
    inner = np.log(np.maximum(envelope[edge : len(envelope) - edge], 1e-12))
    at = np.arange(len(inner)) * per_sample
    return float(np.polynomial.polynomial.polyfit(at, inner, 1)[1])
