"""What noise and swings are expected to leave in the periodogram of a short, detrended, tapered record.

A short record of slow noise has a periodogram that is far from the noise's own spectrum: the trend that was taken out
and the leakage of the taper change it most where swings are looked for. Both are linear, so what they do to any
spectrum is computed here and not neglected (the debiased Whittle likelihood: Sykulski et al., Biometrika 106, 2019).

Frequencies in this module are cycles per sample.
"""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import Array

LEAST_CYCLES: Final = 2.5
"""That must fit into a record."""
LEAST_PER_CYCLE: Final = 8
"""Samples of one cycle."""
LEAST_SAMPLES: Final = 40
"""Below, fewer than two octaves of periods are left to search."""
COHERENCE_CYCLES: Final = (1.5, 5.0, 20.0, math.inf)
"""Cycles over which a swing keeps its phase, that are tried; the last one keeps it throughout."""
STRENGTHS: Final = tuple(np.geomspace(1.0, 1e5, 10).tolist())
"""Of a line, as multiples of the noise about it."""
POWERS: Final = (1.0, 2.0, 3.0, 4.0)
"""How steeply the noise falls; 2 is a first-order process, 4 one that is pushed smoothly."""
_PADDED: Final = 8
_ALONE: Final = 16
"""So many of the lowest frequencies stand alone; above, neighbours are averaged."""
_BIN_SHARE: Final = 0.06
_GRID_SHARE: Final = 0.05
_GRID_STEP: Final = 0.3
_STEADY_WIDTH: Final = 0.15
"""Of a line that keeps its phase, in cycles of the record: half the distance of the frequencies that are tried."""
_KNEES: Final = 6
_CROSSINGS: Final = 4
_SMOOTHED: Final = (0.02, 0.03, 0.045, 0.065, 0.1, 0.16)
"""Where a track ends that was smoothed before it came here: without these its shoulder would be taken for a swing."""


@dataclass(frozen=True, slots=True)
class Lattice:
    """All that is tried on a record of ``n`` samples.

    Attributes:
        n: samples.
        at: middle of each bin of the periodogram, shape (m,).
        counts: frequencies in each bin, shape (m,).
        fine: frequencies on which spectra are given, shape (q,).
        noises: spectra of noise, shape (k, q), any scale.
        noise: what is expected of them in the bins, shape (k, m).
        tried: frequencies of a swing, shape (f,).
        lines: what is expected of a swing in the bins, shape (f, w, m), 1 at the highest.
        line_spectra: its spectrum before, shape (f, w, q), on the same scale.
    """

    n: int
    at: Array
    counts: Array
    fine: Array
    noises: Array
    noise: Array
    tried: Array
    lines: Array
    line_spectra: Array

    def near(self, per_sample: float) -> int:
        """The bin that a frequency lies in."""
        return int(np.argmin(np.abs(self.at - per_sample)))


def detrended(values: Array) -> Array:
    """Without their straight line, shape (..., n)."""
    basis = _trend(values.shape[-1])
    return np.asarray(values - (values @ basis) @ basis.T)


def periodogram(values: Array) -> Array:
    """Power in the bins of :func:`lattice`, shape (..., m), for records of shape (..., n) without gaps."""
    n = values.shape[-1]
    taper = _taper(n)
    power = np.abs(np.fft.rfft(detrended(values) * taper, axis=-1)) ** 2 / float(np.sum(taper**2))
    edges = _edges(n)
    return np.asarray(np.add.reduceat(power[..., : edges[-1]], edges[:-1], axis=-1) / np.diff(edges))


def drawn(spectra: Array, n: int, rng: np.random.Generator) -> Array:
    """Records of Gaussian noise, shape (b, n), of spectra on ``Lattice.fine``, shape (b, q)."""
    whole = _PADDED * n
    parts = rng.standard_normal((*spectra.shape, 2)) @ np.array([1.0, 1.0j])
    # Both parts of the number have unit variance: without the half its power would be twice the spectrum's.
    series = np.fft.irfft(parts * np.sqrt(0.5 * whole * spectra), n=whole, axis=-1)
    return np.asarray(series[:, :n])


@functools.lru_cache(maxsize=4)
def lattice(n: int) -> Lattice:
    """What is tried on records of ``n`` samples; ``n`` at least :data:`LEAST_SAMPLES`."""
    edges = _edges(n)
    response = _response(n, edges)
    fine = np.fft.rfftfreq(_PADDED * n)
    noises = _noises(n, fine)
    low, high = LEAST_CYCLES / n, 1.0 / LEAST_PER_CYCLE
    tried = [low]
    while tried[-1] < high:
        tried.append(tried[-1] + max(_GRID_STEP / n, _GRID_SHARE * tried[-1]))
    frequencies = np.minimum(np.array(tried), high)
    spectra = np.array([[_line(n, fine, f, c) for c in COHERENCE_CYCLES] for f in frequencies])
    lines = spectra @ response.T
    highest = lines.max(axis=-1, keepdims=True)
    return Lattice(
        n=n,
        at=np.array([0.5 * (a + b - 1) / n for a, b in itertools.pairwise(edges)]),
        counts=np.diff(edges).astype(np.float64),
        fine=fine,
        noises=noises,
        noise=noises @ response.T,
        tried=frequencies,
        lines=lines / highest,
        line_spectra=spectra / highest,
    )


def _trend(n: int) -> Array:
    ramp = np.linspace(-1.0, 1.0, n)
    return np.column_stack([np.full(n, n**-0.5), ramp / np.linalg.norm(ramp)])


def _taper(n: int) -> Array:
    return np.asarray(np.hanning(n + 2)[1:-1])


def _edges(n: int) -> Array:
    """First frequency of each bin, in cycles of the record, and the end of the last: up to four samples a cycle."""
    last = n // 4
    edges = list(range(1, min(_ALONE, last) + 1))
    while edges[-1] <= last:
        edges.append(edges[-1] + max(1, round(_BIN_SHARE * edges[-1])))
    return np.array([*edges[:-1], last + 1])


def _response(n: int, edges: Array) -> Array:
    """Share that each fine frequency has in each bin, shape (m, q)."""
    whole = _PADDED * n
    basis, taper = _trend(n), _taper(n)
    rows = []
    for first, end in itertools.pairwise(edges):
        waves = taper * np.exp(-2.0j * np.pi * np.outer(np.arange(first, end), np.arange(n)) / n)
        waves -= (waves @ basis) @ basis.T
        power = (np.abs(np.fft.fft(waves, n=whole, axis=-1)) ** 2).mean(axis=0) / (whole * np.sum(taper**2))
        folded = power[: whole // 2 + 1].copy()
        folded[1 : whole // 2] += power[: whole // 2 : -1]
        rows.append(folded)
    return np.array(rows)


def _noises(n: int, fine: Array) -> Array:
    """Noise that falls by several powers beyond a knee, smoothed or not, with white noise of measuring or without."""
    height = 2.0 * np.sin(np.pi * fine)
    knees = np.geomspace(0.3 / n, 0.1, _KNEES)
    slow = [
        (knee, knee, (height**2 + (2.0 * np.sin(np.pi * knee)) ** 2) ** (-0.5 * p)) for p in POWERS for knee in knees
    ]
    for knee in knees[::2]:
        first_order = 1.0 / (height**2 + (2.0 * np.sin(np.pi * knee)) ** 2)
        slow += [(knee, end, first_order * np.exp(-((fine / end) ** 2))) for end in _SMOOTHED if end > 2.0 / n]
    found = [np.ones(len(fine))]
    for knee, end, spectrum in slow:
        one = spectrum / float(spectrum[1:].mean())
        # A smoothed track without any noise of measuring would fall without end.
        crossings = np.geomspace(4.0 / n, 0.2, _CROSSINGS) if end == knee else np.array([1.0, 1.5, 2.1, 3.0]) * end
        if end == knee:
            found.append(one)
        found += [one + float(np.interp(crossing, fine, one)) for crossing in crossings if crossing > knee]
    return np.array(found)


def _line(n: int, fine: Array, per_sample: float, coherence_cycles: float) -> Array:
    if math.isinf(coherence_cycles):
        # The tails of a drifting line would hide that there is nothing beside a steady one.
        return np.asarray(np.exp(-0.5 * ((fine - per_sample) * n / _STEADY_WIDTH) ** 2))
    half = per_sample / (2.0 * np.pi * coherence_cycles)
    # Narrower than the fine grid it would fall between two of its places.
    half = max(half, 1.5 * float(fine[1]))
    return np.asarray(1.0 / (1.0 + ((fine - per_sample) / half) ** 2))
