"""What tracks and histories come to, in the paper's terms: pure functions of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from flora_common.arrays import BoolArray, FloatArray
from flora_common.runs import Light
from flora_common.tracks import Track

STEADY_SHARE: Final = 0.95
"""A lamp is on "at first" or "at last" for as long as it shone for this share of the time."""
MIDDLE_CM: Final = 1.0
"""A tip is in the middle when it is as near to the line over the anchor."""
CONVERGED_WITHIN: Final = 0.01
"""The median over runs has converged where it stays as near to its last value; fitness is at most 1."""
SECONDS_PER_HOUR: Final = 3600.0
HOURS_PER_DAY: Final = 24.0


def growth_cm_per_day(track: Track) -> float:
    """How fast the tip rises, over the whole track."""
    heights = track.points_cm[:, -1, 1]
    hours = (track.time_s[-1] - track.time_s[0]) / SECONDS_PER_HOUR
    return float((heights[-1] - heights[0]) / hours * HOURS_PER_DAY)


def hours_to_height(track: Track, height_cm: float) -> float | None:
    """When the tip is first as high; None where it never is."""
    rows = np.flatnonzero(track.points_cm[:, -1, 1] >= height_cm)
    return float(track.time_s[rows[0]] - track.time_s[0]) / SECONDS_PER_HOUR if len(rows) else None


def switching_h(track: Track) -> float | None:
    """Median time from one change of lamps to the next; None where there are not two changes."""
    changes = [
        float(track.time_s[row])
        for row, (one, other) in enumerate(pairwise(track.light))
        if one != other and one in ("left", "right")
    ]
    waits = [b - a for a, b in pairwise(changes)]
    return float(np.median(waits)) / SECONDS_PER_HOUR if waits else None


def converged_generation(best_so_far: FloatArray) -> int:
    """The generation from which on the median over runs stays within :data:`CONVERGED_WITHIN` of its last value.

    Args:
        best_so_far: shape (runs, generations).
    """
    median = np.median(best_so_far, axis=0)
    outside = np.flatnonzero(np.abs(median - median[-1]) > CONVERGED_WITHIN)
    return int(outside[-1]) + 1 if len(outside) else 0


@dataclass(frozen=True, slots=True)
class Steering:
    """How a run was steered, as the paper tells it of its first real plant.

    Attributes:
        right_h: for how long the right lamp shone at first; 0 where the left one did.
        tip_cm: the tip then, shape (2,).
        to_middle_h: from then until the tip was in the middle; None where it was not to the right, or never came there.
        left_h: for how long the left lamp shone at last.
    """

    right_h: float
    tip_cm: tuple[float, float]
    to_middle_h: float | None
    left_h: float


def steering(time_s: FloatArray, light: Sequence[Light], tips_cm: FloatArray) -> Steering:
    """How a run was steered.

    Args:
        time_s: shape (n,), two or more.
        light: the lamp that shone before each stem, n of them; the first is not counted.
        tips_cm: shape (n, 2).
    """
    took_s = np.diff(time_s)
    is_right = np.array([one == "right" for one in light[1:]])
    is_left = np.array([one == "left" for one in light[1:]])
    first = _steady(is_right, took_s)
    last = _steady(is_left[::-1], took_s[::-1])
    switch = tips_cm[first]
    to_middle_h = None
    if first and switch[0] > MIDDLE_CM:
        rows = first + np.flatnonzero(tips_cm[first:, 0] <= MIDDLE_CM)
        to_middle_h = float(time_s[rows[0]] - time_s[first]) / SECONDS_PER_HOUR if len(rows) else None
    return Steering(
        float(took_s[:first].sum()) / SECONDS_PER_HOUR,
        (float(switch[0]), float(switch[1])),
        to_middle_h,
        float(took_s[len(took_s) - last :].sum()) / SECONDS_PER_HOUR,
    )


def _steady(is_lit: BoolArray, took_s: FloatArray) -> int:
    """The longest beginning, in steps, with the lamp lit for :data:`STEADY_SHARE` of its time, which ends lit."""
    share = np.cumsum(is_lit * took_s) / np.cumsum(took_s)
    rows = np.flatnonzero((share >= STEADY_SHARE) & is_lit)
    return int(rows[-1]) + 1 if len(rows) else 0
