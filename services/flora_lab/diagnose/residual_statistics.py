"""What a run's residuals come to in a few dozen numbers, so that runs can be compared as wholes.

Rows of one run are not independent: all that is asked here is whether some runs have other numbers than others.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose import rhythm
from flora_lab.diagnose.replayed import MM, Plant, Replayed, length_cm

Group = Literal["sideways", "growth", "lean", "height", "size", "swing"]

SINCE_H: Final = (0.0, 1.0, 3.0, 6.0, math.inf)
SIDES: Final = ("left", "right")
CLOCK_H: Final = 3.0
DAYS: Final = 3
HEIGHTS_CM: Final = (0.0, 10.0, 15.0, math.inf)
GROUPS: Final[tuple[Group, ...]] = ("sideways", "growth", "lean", "height", "size", "swing")
_LEAST_H: Final = 1.0
"""Fewer hours than that tell no mean."""
_SMOOTH_H: Final = 1.0
_MOST_WAYS: Final = 3000
_STEADY_SHARE: Final = 0.15
"""Of the usual spread of the numbers of a group, added to each one's own: nine runs may be alike by chance."""
_SEED: Final = 4711


@dataclass(frozen=True, slots=True)
class Number:
    """One of the numbers.

    Attributes:
        group: those that belong together.
        label: which of them.
    """

    group: Group
    label: str


def since_label(place: int) -> str:
    """Hours since the last switch."""
    low, high = SINCE_H[place], SINCE_H[place + 1]
    return f"{low:g}+ h" if math.isinf(high) else f"{low:g}-{high:g} h"


def clock_label(place: int) -> str:
    """Hours since the start, modulo a day."""
    return f"{place * CLOCK_H:g}-{(place + 1) * CLOCK_H:g} h"


def height_label(place: int) -> str:
    """Height of the tip."""
    low, high = HEIGHTS_CM[place], HEIGHTS_CM[place + 1]
    return f"above {low:g} cm" if math.isinf(high) else f"{low:g}-{high:g} cm"


CLOCKS: Final = round(24.0 / CLOCK_H)
NUMBERS: Final[tuple[Number, ...]] = (
    *(Number("sideways", f"{side} {since_label(k)}") for side in SIDES for k in range(len(SINCE_H) - 1)),
    *(Number("growth", clock_label(k)) for k in range(CLOCKS)),
    *(Number("lean", f"day {day + 1}") for day in range(DAYS)),
    *(Number("height", f"day {day + 1}") for day in range(DAYS)),
    Number("size", "tip"),
    Number("swing", "tip"),
)
"""mm, but for growth: mm/h; size and swing are logarithms of mm."""
COUNT: Final = len(NUMBERS)


def of_group(group: Group) -> Array:
    """Places of a group among the numbers."""
    return np.array([place for place, number in enumerate(NUMBERS) if number.group == group])


def numbers_of(run: Replayed, plant: Plant) -> Array:
    """The numbers of one run, shape (COUNT,); NaN where the run is too short to tell one.

    Args:
        run: measured and simulated stems.
        plant: which of the simulated ones.
    """
    error_mm = run.error_mm(plant)[:, -1]
    day = np.minimum((run.time_h - 1e-9) // 24.0, DAYS - 1)
    out: list[float] = []
    for side in (run.is_left, run.is_right):
        for low, high in itertools.pairwise(SINCE_H):
            out.append(_mean(error_mm[:, 0], side & (run.since_h > low) & (run.since_h <= high), run.step_h))
    rate = growth_error_mm_h(run, plant)
    place = ((run.time_h - 1e-9) % 24.0) // CLOCK_H
    out.extend(_mean(rate, place == k, run.step_h) for k in range(CLOCKS))
    for axis in range(2):
        out.extend(_mean(error_mm[:, axis], day == k, run.step_h) for k in range(DAYS))
    out.append(float(np.log(max(1e-3, rms(np.hypot(*error_mm.T))))))
    spectrum = rhythm.spectrum(error_mm[:, 0] / MM, run.step_h)
    power = float(spectrum.power.sum() / spectrum.hours)
    out.append(0.5 * math.log(power) if power > 0.0 else math.nan)
    return np.array(out)


def growth_error_mm_h(run: Replayed, plant: Plant) -> Array:
    """How much faster the stem grew than it was simulated to, over an hour about each row, mm/h, shape (n,)."""
    longer = MM * (length_cm(run.measured_cm) - length_cm(run.simulated_cm(plant)))
    width = max(1, round(_SMOOTH_H / run.step_h))
    smooth = smoothed(longer, width)
    rate = np.full(len(longer), np.nan)
    half = width // 2 + 1
    if len(longer) > 2 * half:
        rate[half:-half] = (smooth[2 * half :] - smooth[: -2 * half]) / (2 * half * run.step_h)
    return rate


def smoothed(values: Array, width: int) -> Array:
    """Moving mean over so many rows of what is known, shape (n,); NaN where nothing is."""
    known = np.isfinite(values)
    kernel = np.ones(max(1, min(width, len(values))))
    total = np.convolve(np.where(known, values, 0.0), kernel, mode="same")
    count = np.convolve(known.astype(np.float64), kernel, mode="same")
    return np.where(count > 0, total / np.maximum(count, 1.0), np.nan)


def rms(values: Array) -> float:
    """Root mean square of what is known; NaN of nothing."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else math.nan


def mean(values: Array) -> float:
    """Mean of what is known; NaN of nothing."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else math.nan


def mean_over_runs(values: Array) -> Array:
    """Of what is known of each number, over the first axis; NaN where no run tells it."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    return np.where(count > 0, np.where(known, values, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)


def _mean(values: Array, rows: Array, step_h: float) -> float:
    known = values[rows & np.isfinite(values)]
    return float(known.mean()) if len(known) * step_h >= _LEAST_H else math.nan


@dataclass(frozen=True, slots=True)
class Comparison:
    """Numbers of measured runs beside those of reference runs.

    Attributes:
        away: of the means of both, in standard errors, shape (k,); NaN where runs do not tell.
        p_value: share of the ways to choose as many of all the runs that show at least as much in some number.
        ways: how many ways were looked at.
        remarkable: in standard errors: what one way in twenty shows in some number.
    """

    away: Array
    p_value: float
    ways: int
    remarkable: float


def compared(measured: Array, reference: Array, groups: Sequence[Array]) -> Comparison:
    """Exchange whole runs: are the measured ones special among all?

    Args:
        measured: shape (runs, k).
        reference: shape (other runs, k).
        groups: places of the numbers whose spreads are alike.
    """
    every = np.concatenate([measured, reference])
    count, total = len(measured), len(every)
    ways = math.comb(total, count)
    if ways <= _MOST_WAYS:
        chosen = np.array(list(itertools.combinations(range(total), count)))
    else:
        rng = np.random.default_rng(_SEED)
        chosen = np.stack([rng.permutation(total)[:count] for _ in range(_MOST_WAYS)])
        chosen[0] = np.arange(count)
    mine = np.zeros((len(chosen), total), dtype=np.bool_)
    np.put_along_axis(mine, chosen, True, axis=1)
    known = np.isfinite(every)
    values = np.where(known, every, 0.0)
    # A number is told only where most of the runs on either side have it.
    here, there = mine.astype(np.float64) @ known, (~mine).astype(np.float64) @ known
    mean_here = mine.astype(np.float64) @ values / np.maximum(here, 1.0)
    mean_there = (~mine).astype(np.float64) @ values / np.maximum(there, 1.0)
    squares = known.T.astype(np.float64) @ np.ones(total)
    between = (values**2).sum(axis=0)[None] - here * mean_here**2 - there * mean_there**2
    freedom = np.maximum(squares[None] - (here > 0) - (there > 0), 1.0)
    spread = np.sqrt(np.maximum(between, 0.0) / freedom)
    for group in groups:
        spread[:, group] += _STEADY_SHARE * np.nanmedian(spread[:, group], axis=1)[:, None] + 1e-9
    width = spread * np.sqrt(1.0 / np.maximum(here, 1.0) + 1.0 / np.maximum(there, 1.0))
    enough = (here >= 0.5 * count) & (there >= 0.5 * (total - count)) & (here >= 1) & (there >= 2)
    away = np.where(enough, (mean_here - mean_there) / width, np.nan)
    most = np.max(np.where(enough, np.abs(away), 0.0), axis=1)
    own = 0  # combinations begin with the first runs, which are the measured ones
    return Comparison(
        away[own], float(np.mean(most >= most[own] - 1e-9)), len(chosen), float(np.percentile(most, 95.0))
    )
