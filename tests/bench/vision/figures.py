"""How far found stems are from true ones: figures of one run, pooled over runs, with intervals. Pure functions.

Lengths come in cm (x right, y up) and go out in mm. A stem counts as found where a method gives one, whatever it says
of it; what it says (the outcome) is counted apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from flora_common.arrays import FloatArray
from flora_common.geometry import distance_to_polyline_cm

SAMPLES: Final = 50
CONFIDENT_TIP_MM: Final = 10.0
MOST_ERRORS: Final = 3.0
"""A tip farther off than so many of its own standard deviations is beyond them."""
GROWTH_WINDOW_S: Final = 900.0
FEW_RUNS: Final = 5
RESAMPLES: Final = 300

FIGURES: Final = {
    "distance_mean_mm": "mean distance, mm",
    "distance_p95_mm": "distance 95 %, mm",
    "tip_mean_mm": "tip mean, mm",
    "tip_p95_mm": "tip 95 %, mm",
    "missing_percent": "missing %",
    "flagged_percent": "flagged %",
    "confident_percent": "confident failure %",
    "ok_rms_mm": "tip of ok (RMS), mm",
    "said_rms_mm": "as stated (RMS), mm",
    "beyond_percent": "beyond 3 sd %",
    "jitter_mm": "jitter, mm",
    "same_percent": "same steps %",
    "growth_error_percent": "growth error %",
}
"""Names in the JSON file and heads in the table, in its order. All but what is stated: less is better."""


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a method made of one frame.

    Attributes:
        outcome: its own word for it; ``ok`` where it trusts the stem.
        line_cm: the stem, shape (n, 2), n >= 2, anchor first, tip last; None where it gives none.
        tip_error_mm: standard deviation of its end, as the method states it; None where it states none.
    """

    outcome: str
    line_cm: FloatArray | None
    tip_error_mm: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RunScores:
    """What one method did on one run.

    Attributes:
        frames: how many were judged.
        distance_mm: shape (found frames, 100): see :func:`line_distances_mm`.
        tip_mm: shape (found frames,), from the found tip to the true one.
        missing: frames without a stem.
        flagged: frames with a stem whose outcome is not ``ok``.
        confident: frames with outcome ``ok`` and a tip more than 10 mm off.
        ok_mm: shape (n, 2): how far off the tips of frames with outcome ``ok`` are of which a standard deviation is
            stated, and that.
        step_mm: shape (steps, 2): found minus true step of the tip, from each judged frame to the next of the run.
        same: steps in which the found tip stayed exactly where it was.
        growth_percent: found growth over true growth, less 100; NaN where an end of the run has no stem, or nothing
            grew.
    """

    frames: int
    distance_mm: FloatArray
    tip_mm: FloatArray
    missing: int
    flagged: int
    confident: int
    ok_mm: FloatArray
    step_mm: FloatArray
    same: int
    growth_percent: float


def length_cm(line_cm: FloatArray) -> float:
    """Along a line of shape (n, 2)."""
    return float(np.hypot(*np.diff(line_cm, axis=0).T).sum())


def sampled(line_cm: FloatArray, count: int = SAMPLES) -> FloatArray:
    """Points evenly spaced along a line (n, 2), both ends included; shape (count, 2)."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line_cm, axis=0).T))])
    at = np.linspace(0.0, along[-1], count)
    return np.column_stack([np.interp(at, along, line_cm[:, 0]), np.interp(at, along, line_cm[:, 1])])


def line_distances_mm(found_cm: FloatArray, true_cm: FloatArray) -> FloatArray:
    """From 50 points of the found line to the true one, then from 50 of the true to the found one; shape (100,).

    The second half is what punishes a stem that is cut short: all that it has may lie on the true one.
    """
    there = distance_to_polyline_cm(sampled(found_cm), true_cm)
    back = distance_to_polyline_cm(sampled(true_cm), found_cm)
    return 10.0 * np.concatenate([there, back])


def run_scores(
    times_s: npt.ArrayLike, true_cm: Sequence[FloatArray], found: Sequence[Found], judged: Sequence[int]
) -> RunScores:
    """The figures of one run.

    Args:
        times_s: of all frames, rising.
        true_cm: the true stem of each frame, shape (n, 2).
        found: of each frame; those that are not judged are not looked at.
        judged: which frames count, rising.
    """
    lines = {i: line for i in judged if (line := found[i].line_cm) is not None}
    tip = {i: 10.0 * (line[-1] - true_cm[i][-1]) for i, line in lines.items()}
    off = {i: float(np.hypot(*d)) for i, d in tip.items()}
    ok = {i for i in lines if found[i].outcome == "ok"}
    steps = [i for i in lines if i + 1 in lines]
    return RunScores(
        frames=len(judged),
        distance_mm=np.array([line_distances_mm(lines[i], true_cm[i]) for i in lines]).reshape(-1, 2 * SAMPLES),
        tip_mm=np.array([off[i] for i in lines]),
        missing=len(judged) - len(lines),
        flagged=len(lines) - len(ok),
        confident=sum(off[i] > CONFIDENT_TIP_MM for i in ok),
        ok_mm=np.array([(off[i], said) for i in lines if i in ok and (said := found[i].tip_error_mm)]).reshape(-1, 2),
        step_mm=np.array([tip[i + 1] - tip[i] for i in steps]).reshape(-1, 2),
        same=sum(bool((lines[i + 1][-1] == lines[i][-1]).all()) for i in steps),
        growth_percent=_growth_percent(np.asarray(times_s, dtype=np.float64), true_cm, lines, judged),
    )


def _growth_percent(
    times_s: FloatArray, true_cm: Sequence[FloatArray], lines: dict[int, FloatArray], judged: Sequence[int]
) -> float:
    """Growth is mean length in the last quarter-hour less that in the first."""
    first = [i for i in judged if times_s[i] <= times_s[0] + GROWTH_WINDOW_S and i in lines]
    last = [i for i in judged if times_s[i] >= times_s[-1] - GROWTH_WINDOW_S and i in lines]
    if not first or not last:
        return math.nan
    found = np.mean([length_cm(lines[i]) for i in last]) - np.mean([length_cm(lines[i]) for i in first])
    true = np.mean([length_cm(true_cm[i]) for i in last]) - np.mean([length_cm(true_cm[i]) for i in first])
    return float(100.0 * (found / true - 1.0)) if true > 0.0 else math.nan


def pooled(runs: Sequence[RunScores]) -> dict[str, float]:
    """The figures over all frames of several runs together, by the names in :data:`FIGURES`; NaN where none can be."""
    frames = sum(run.frames for run in runs)
    distance = np.concatenate([run.distance_mm.ravel() for run in runs])
    tip = np.concatenate([run.tip_mm for run in runs])
    step = np.concatenate([run.step_mm for run in runs])
    off, said = np.concatenate([run.ok_mm for run in runs]).T
    growth = np.array([run.growth_percent for run in runs])
    growth = np.abs(growth[np.isfinite(growth)])

    def percent(part: int, whole: int) -> float:
        return 100.0 * part / whole if whole else math.nan

    return {
        "distance_mean_mm": _mean(distance),
        "distance_p95_mm": float(np.percentile(distance, 95)) if distance.size else math.nan,
        "tip_mean_mm": _mean(tip),
        "tip_p95_mm": float(np.percentile(tip, 95)) if tip.size else math.nan,
        "missing_percent": percent(sum(run.missing for run in runs), frames),
        "flagged_percent": percent(sum(run.flagged for run in runs), frames),
        "confident_percent": percent(sum(run.confident for run in runs), frames),
        "ok_rms_mm": math.sqrt(_mean(off**2)) if off.size else math.nan,
        "said_rms_mm": math.sqrt(_mean(said**2)) if said.size else math.nan,
        "beyond_percent": percent(int(np.count_nonzero(off > MOST_ERRORS * said)), len(off)),
        "jitter_mm": math.sqrt(_mean((step**2).sum(axis=1))) if step.size else math.nan,
        "same_percent": percent(sum(run.same for run in runs), len(step)),
        "growth_error_percent": _mean(growth),
    }


def _mean(values: FloatArray) -> float:
    return float(values.mean()) if values.size else math.nan


def intervals(runs: Sequence[RunScores], *, seed: int = 0) -> dict[str, tuple[float, float]]:
    """(low, high) of each figure over the individuals.

    With fewer than five runs: the least and the greatest of the runs' own figures. Else the 95 % interval of the pooled
    figure when runs are drawn again with replacement (the frames of one plant are no independent witnesses).
    """
    if len(runs) < FEW_RUNS:
        draws = [pooled([run]) for run in runs]
        limits = (0.0, 100.0)
    else:
        rng = np.random.default_rng(seed)
        draws = [pooled([runs[i] for i in rng.integers(len(runs), size=len(runs))]) for _ in range(RESAMPLES)]
        limits = (2.5, 97.5)
    out = {}
    for name in FIGURES:
        values = np.array([draw[name] for draw in draws])
        values = values[np.isfinite(values)]
        low, high = np.percentile(values, limits) if values.size else (math.nan, math.nan)
        out[name] = (float(low), float(high))
    return out
