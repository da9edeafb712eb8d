"""Whether a record swings, beside red noise of its own making: the best line, and how often noise alone has one.

The null is fitted to the same record, for a tip track comes without reference runs. Noise and line are fitted
together at each period that is tried, so that the line is left out of the noise and the noise out of the line. The
price of having looked at all periods is not guessed: noise as it was fitted is drawn many times and goes through the
same search, gaps included.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.rhythm.lattice import COHERENCE_CYCLES, STRENGTHS, Lattice, drawn, lattice, periodogram

DRAWN: Final = 399
"""Records of noise; no chance below 1 in 400 can be told."""
LEVEL: Final = 0.05
"""A swing is claimed where noise alone does as well more rarely."""
INTERVAL: Final = 0.90
_INDEPENDENT: Final = 0.8
"""Weight of the likelihood, less than 1 because neighbours under a taper are correlated. With this one, intervals of
90 % held 95 to 100 % of the periods of drawn swings."""


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
        noise_alone, both: what is expected there of noise alone, and of noise and line, shape (m,).
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
    nulls = _likelihood(grid, power[None], grid.noise)[0]
    rng = np.random.default_rng(seed)
    # One best noise would pretend that a short record tells which noise it has: each is drawn as often as it may be so.
    chance = np.exp(_INDEPENDENT * (nulls - nulls.max()))
    which = rng.choice(len(nulls), size=count, p=chance / chance.sum())
    powers = periodogram(bridged(drawn(grid.noises[which], grid.n, rng), known))
    scores, place, first = _search(grid, np.concatenate([power[None], powers]))
    gain = float(scores[0] - nulls.max())
    gains = scores[1:] - _likelihood(grid, powers, grid.noise).max(axis=1)
    null = grid.noise[int(np.argmax(nulls))]
    k, f, w, h = (int(i) for i in np.unravel_index(place, _shape(grid)))
    ratio = STRENGTHS[h] * grid.noise[k, grid.near(grid.tried[f])]
    level = _scale(grid, power, grid.noise[k] + ratio * grid.lines[f, w])
    low, middle, high = _frequency(grid, first)
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
        noise_alone=_scale(grid, power, null) * null,
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
    counts = grid.counts.astype(np.float32)
    shapes = shapes.astype(np.float32)
    scale = powers.astype(np.float32) @ (counts / shapes).T
    return np.asarray(-(np.log(shapes) @ counts)[None, :] - total * np.log(scale / total))


def _with_line(grid: Lattice, f: int) -> Array:
    """All shapes with a line at one frequency, (k * w * h, m), in the order of :func:`_shape`."""
    height = grid.noise[:, grid.near(grid.tried[f])]
    strength = (height[:, None] * np.array(STRENGTHS)[None, :]).astype(np.float32)
    line = grid.lines[f].astype(np.float32)
    noise = grid.noise.astype(np.float32)
    both = noise[:, None, None, :] + strength[:, None, :, None] * line[None, :, None, :]
    return np.asarray(both.reshape(-1, both.shape[-1]))


def _search(grid: Lattice, powers: Array) -> tuple[Array, int, Array]:
    """The likelihood of the best line in each record, shape (b,).

    With it, of the first record alone: the place of the best in :func:`_shape`, and the likelihood of all lines, shape
    (f, k * w * h).
    """
    score = np.full(len(powers), -np.inf)
    first = []
    for f in range(len(grid.tried)):
        found = _likelihood(grid, powers, _with_line(grid, f))
        score = np.maximum(score, found.max(axis=1))
        first.append(found[0])
    likelihood = np.array(first, dtype=np.float64)
    f, rest = divmod(int(np.argmax(likelihood)), likelihood.shape[1])
    k, _, w, h = _shape(grid)
    kk, ww, hh = (int(i) for i in np.unravel_index(rest, (k, w, h)))
    return score, int(np.ravel_multi_index((kk, f, ww, hh), _shape(grid))), likelihood


def _frequency(grid: Lattice, likelihood: Array) -> tuple[float, float, float]:
    """5 %, middle and 95 % of the frequency, over all noises, widths and strengths."""
    weights = np.exp(_INDEPENDENT * (likelihood - likelihood.max())).sum(axis=1)
    # The grid is uneven, and no period is more likely than another beforehand: equal weight per octave.
    weights *= np.gradient(np.log(grid.tried))
    share = (np.cumsum(weights) - 0.5 * weights) / weights.sum()
    tail = 0.5 * (1.0 - INTERVAL)
    low, middle, high = np.interp([tail, 0.5, 1.0 - tail], share, grid.tried)
    return float(low), float(middle), float(high)
