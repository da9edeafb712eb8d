"""What is wrong with a record before anything is compared: gaps, and stems that were found wrongly.

A single tip that was taken for a leaf looks like the end of the world to a fit. Such rows are left out, and told.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_common.counted import counted
from flora_lab.simulator.measured import MeasuredRun

GAP_H: Final = 0.5
"""A shorter gap is told by nobody."""
_ABOUT_ROWS: Final = 7
_OF_STEP_S: Final = 300.0
"""The least that is far, below, is that of photographs so far apart in time: how far a turning tip is from the middle
of those about it grows with the square of that."""
_LEAST_JUMP_CM: Final = 0.6
_JUMP_MADS: Final = 12.0
_LEAST_KINK_CM: Final = 0.3
_KINK_MADS: Final = 8.0
_ROUGH_SHARE: Final = 0.22
"""Of how far a tip is from those about it: what a parabola leaves of a jump is 0.27 of it or more, of a swing less."""
_STUCK_H: Final = 2.0
_MAD_SD: Final = 1.4826


def cleaned(run: MeasuredRun) -> tuple[MeasuredRun, list[str]]:
    """The run without rows that no plant can have left, and sentences about what was found."""
    told: list[str] = []
    jumped, stuck_rows = _jumps(run) | _kinks(run), _stuck(run)
    wrong = jumped | stuck_rows
    if wrong.any():
        jumps, stuck = int(jumped.sum()), int(stuck_rows.sum())
        if jumps:
            told.append(f"{run.name}: {counted(jumps, 'stem')} lay far from those before and after; left out")
        if stuck:
            hours = stuck * run.step_s / 3600.0
            told.append(f"{run.name}: for {hours:.1f} h the very same stem was told again and again; left out")
    longest_h = _longest_gap(run.is_measured) * run.step_s / 3600.0
    if longest_h > GAP_H:
        missing = 100.0 * (1.0 - run.is_measured.mean())
        told.append(f"{run.name}: no stem for {longest_h:.1f} h at a time; {missing:.1f} % of all are missing")
    return (without(run, wrong) if wrong.any() else run), told


def without(run: MeasuredRun, rows: Array) -> MeasuredRun:
    """The run, as if no stem had been measured in some rows; its first and last stay."""
    points = run.points_cm.copy()
    hidden = np.array(rows, dtype=np.bool_)
    hidden[[0, -1]] = False
    points[hidden] = np.nan
    return replace(run, points_cm=points)


def _jumps(run: MeasuredRun) -> Array:
    """Rows whose tip is far from the median of those about it, shape (n,)."""
    tips = run.points_cm[:, -1]
    known = np.isfinite(tips[:, 0])
    out = np.zeros(len(tips), dtype=np.bool_)
    rows = np.flatnonzero(known)
    if len(rows) < 2 * _ABOUT_ROWS:
        return out
    own = tips[rows]
    half = _ABOUT_ROWS // 2
    around = _around(own)
    away = np.hypot(*(own - np.median(around, axis=-1)).T)
    is_far = away > max(_LEAST_JUMP_CM * _seldom(run), _JUMP_MADS * usual_sd(away))
    # A wide swing turns back within minutes, too, but smoothly: a parabola runs through it, and through no jump.
    parabolas = np.linalg.qr(np.vander(np.arange(_ABOUT_ROWS, dtype=np.float64) - half, 3))[0]
    rough = np.sqrt(np.mean((around - around @ parabolas @ parabolas.T) ** 2, axis=-1).sum(axis=-1))
    out[rows] = is_far & (rough > _ROUGH_SHARE * away)
    return out


def _kinks(run: MeasuredRun) -> Array:
    """Rows whose tip alone is far from where the stem below it goes, shape (n,).

    However fast a stem swings, its last piece goes on from the one below nearly as it did minutes before.
    """
    out = np.zeros(len(run), dtype=np.bool_)
    rows = np.flatnonzero(run.is_measured)
    if len(rows) < 2 * _ABOUT_ROWS:
        return out
    kink = np.diff(run.points_cm[rows, -3:, 0], n=2, axis=1)
    away = np.abs(kink - np.median(_around(kink), axis=-1))[:, 0]
    out[rows] = away > max(_LEAST_KINK_CM * _seldom(run), _KINK_MADS * usual_sd(away))
    return out


def _seldom(run: MeasuredRun) -> float:
    """By how much farther a swing leads from one photograph to the next than in five minutes, squared; 1 at least."""
    return max(1.0, run.step_s / _OF_STEP_S) ** 2


def usual_sd(away: Array) -> float:
    """Standard deviation of what is away from its middle, but for few that are far."""
    return _MAD_SD * float(np.median(away))


def _around(values: Array) -> Array:
    """Values (n, k) with those before and after, shape (n, k, 7)."""
    half = _ABOUT_ROWS // 2
    padded = np.pad(values, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
    return np.lib.stride_tricks.sliding_window_view(padded, _ABOUT_ROWS, axis=0)


def _stuck(run: MeasuredRun) -> Array:
    """Rows that repeat the stem before to the last digit, where that goes on for hours, shape (n,)."""
    same = np.zeros(len(run), dtype=np.bool_)
    points = run.points_cm
    same[1:] = np.isfinite(points[1:, -1, 0]) & (points[1:] == points[:-1]).all(axis=(1, 2))
    least = round(_STUCK_H * 3600.0 / run.step_s)
    out = np.zeros(len(run), dtype=np.bool_)
    start = 0
    for row in range(1, len(run) + 1):
        if row == len(run) or not same[row]:
            if row - start - 1 >= least:
                out[start + 1 : row] = True
            start = row
    return out


def _longest_gap(measured: Array) -> int:
    longest = run = 0
    for known in measured:
        run = 0 if known else run + 1
        longest = max(longest, run)
    return longest
