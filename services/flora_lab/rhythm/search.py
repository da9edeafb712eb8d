"""Whether a record swings, beside red noise of its own making: the best line, and how often noise alone has one.

The null is fitted to the same record, for a tip track comes without reference runs. Noise and line are fitted
together at each period that is tried, so that the line is left out of the noise and the noise out of the line. The
price of having looked at all periods is not guessed: noise as it was fitted is drawn many times and goes through the
same search, gaps included.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from flora_lab.rhythm.lattice import COHERENCE_CYCLES, STRENGTHS, Lattice, drawn, lattice, periodogram

Array = npt.NDArray[Any]

DRAWN: Final = 399
"""Records of noise; no chance below 1 in 400 can be told."""
LEVEL: Final = 0.05
"""A swing is claimed where noise alone does as well more rarely."""
INTERVAL: Final = 0.90
_INDEPENDENT: Final = 0.5
"""Share of the frequencies of a tapered record that are independent: neighbours under a Hann taper are correlated."""


@dataclass(frozen=True, slots=True)
class Found:
    """The best swing of a record.

    Attributes:
        p: how often noise alone has a swing as clear, 1 / (DRAWN + 1) at the least.
        gain_nats: of the line's likelihood over that of noise alone.
        per_sample: its frequency, cycles per sample; with ends of its interval of 90 %.
        low_per_sample, high_per_sample: of it.
        coherence_cycles: over which it keeps its phase.
        noise, line: spectra on ``Lattice.fine``, two-sided, in the record's unit squared.
        power: periodogram of the record, shape (m,).
        noise_alone, noise_with_line, both: what is expected there of noise alone, of the noise beside the line, and
            of noise and line, shape (m,).
        threshold: power that noise alone reaches anywhere in 5 % of records, about, shape (m,).
    """

    p: float
    gain_nats: float
    per_sample: float
    low_per_sample: float
    high_per_sample: float
    coherence_cycles: float
    noise: Array
    line: Array
    power: Array
    noise_alone: Array
    noise_with_line: Array
    both: Array


def find(values: Array, *, known: Array, seed: int = 1, count: int = DRAWN) -> Found:
    """The best swing of a record, and how often noise alone has one as clear.

    Args:
        values: shape (n,), in equal steps, gaps already bridged.
        known: where they were measured, shape (n,).
        seed: of the noise that is drawn.
        count: how many records of noise are drawn.
    """
    grid = lattice(len(values))
    power = periodogram(values)
    alone, which = _alone(grid, power[None])
    scores, places = _best(grid, power[None])
    gain = float(scores[0] - alone[0])
    null = grid.noise[which[0]]
    scale = _scale(grid, power, null)
    rng = np.random.default_rng(seed)
    noise = bridged(drawn(grid.noises[which[0]], grid.n, count, rng), known)
    powers = periodogram(noise)
    gains = _best(grid, powers)[0] - _alone(grid, powers)[0]
    k, f, w, h = (int(i) for i in np.unravel_index(places[0], _shape(grid)))
    ratio = STRENGTHS[h] * grid.noise[k, grid.near(grid.tried[f])]
    level = _scale(grid, power, grid.noise[k] + ratio * grid.lines[f, w])
    low, middle, high = _period(grid, power)
    return Found(
        p=(1.0 + float(np.count_nonzero(gains >= gain))) / (count + 1.0),
        gain_nats=gain,
        per_sample=middle,
        low_per_sample=low,
        high_per_sample=high,
        coherence_cycles=COHERENCE_CYCLES[w],
        noise=level * grid.noises[k],
        line=level * ratio * grid.line_spectra[f, w],
        power=power,
        noise_alone=scale * null,
        noise_with_line=level * grid.noise[k],
        both=level * (grid.noise[k] + ratio * grid.lines[f, w]),
    )


def bridged(values: Array, known: Array) -> Array:
    """Records with straight lines over what was not measured, shape (..., n)."""
    if known.all():
        return values
    at = np.arange(len(known))
    return np.asarray(np.apply_along_axis(lambda row: np.interp(at, at[known], row[known]), -1, values))


def _shape(grid: Lattice) -> tuple[int, int, int, int]:
    return len(grid.noise), len(grid.tried), len(COHERENCE_CYCLES), len(STRENGTHS)


def _scale(grid: Lattice, power: Array, shape: Array) -> float:
    return float((grid.counts * power / shape).sum() / grid.counts.sum())


def _likelihood(grid: Lattice, powers: Array, shapes: Array) -> Array:
    """Whittle's, of records with power (b, m), for shapes (s, m) of the best scale: shape (b, s)."""
    total = float(grid.counts.sum())
    scale = powers.astype(np.float32) @ (grid.counts / shapes).astype(np.float32).T
    return np.asarray(-(np.log(shapes) @ grid.counts)[None, :] - total * np.log(scale / total))


def _alone(grid: Lattice, powers: Array) -> tuple[Array, Array]:
    """The likelihood of noise alone, and which, each of shape (b,)."""
    found = _likelihood(grid, powers, grid.noise)
    return found.max(axis=1), found.argmax(axis=1)


def _with_line(grid: Lattice, f: int) -> Array:
    """All shapes with a line at one frequency, (k, w, h, m)."""
    height = grid.noise[:, grid.near(grid.tried[f])]
    strength = height[:, None] * np.array(STRENGTHS)[None, :]
    return np.asarray(grid.noise[:, None, None, :] + strength[:, None, :, None] * grid.lines[f][None, :, None, :])


def _best(grid: Lattice, powers: Array) -> tuple[Array, Array]:
    """The likelihood with the best line, and its place in :func:`_shape`, each of shape (b,)."""
    score = np.full(len(powers), -np.inf)
    place = np.zeros(len(powers), dtype=np.int64)
    k, _, w, h = _shape(grid)
    for f in range(len(grid.tried)):
        found = _likelihood(grid, powers, _with_line(grid, f).reshape(k * w * h, -1))
        top = found.argmax(axis=1)
        own = found[np.arange(len(powers)), top]
        better = own > score
        score[better] = own[better]
        kk, ww, hh = np.unravel_index(top[better], (k, w, h))
        place[better] = np.ravel_multi_index((kk, np.full(len(kk), f), ww, hh), _shape(grid))
    return score, place


def _period(grid: Lattice, power: Array) -> tuple[float, float, float]:
    """5 %, middle and 95 % of the frequency, over all noises, widths and strengths."""
    found = np.array(
        [_likelihood(grid, power[None], _with_line(grid, f).reshape(-1, len(power)))[0] for f in range(len(grid.tried))]
    )
    weights = np.exp(_INDEPENDENT * (found - found.max())).sum(axis=1)
    # The grid is uneven, and no period is more likely than another beforehand: equal weight per octave.
    weights *= np.gradient(np.log(grid.tried))
    share = (np.cumsum(weights) - 0.5 * weights) / weights.sum()
    tail = 0.5 * (1.0 - INTERVAL)
    low, middle, high = np.interp([tail, 0.5, 1.0 - tail], share, grid.tried)
    return float(low), float(middle), float(high)
