"""A camera or a pot that was knocked: from one photograph to the next the whole stem is turned about its foot.

No plant does that, and no term of a law: a stem that is pushed, or breaks, bends. What comes after is turned back, so
that everything else is compared as if nobody had been there; and the knock is told.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.ndimage import maximum_filter1d

from flora_common.arrays import Array
from flora_common.geometry import turned_right
from flora_lab.diagnose.record import usual_sd
from flora_lab.simulator.measured import MeasuredRun

KNOCKED: Final = "camera or pot was knocked; what comes after is turned back"
_ROWS: Final = 6
"""Stems before a moment, and after it, of which the straight line of time tells where the stem was at that moment."""
_LONGEST_H: Final = 1.0
"""They lie no farther apart, in all, than they would without gaps by more than this."""
_LEAST_DEG: Final = 3.0
_MADS: Final = 12.0
_NOT_RIGID: Final = 0.15
"""Most that a turn may leave of how far points went, root mean squares. Of 1,263 runs that nobody knocked 153 turn as
fast as that, and none of them leaves less than 0.20: what turns so fast is a stem that bends."""
_MOST: Final = 5
"""Knocks that are looked for in one run."""


@dataclass(frozen=True, slots=True)
class Knock:
    """One.

    Attributes:
        time_s: of the first row after it, as in the track.
        hour_h: the same, since the start of the run.
        angle_deg: by which the stem was turned, positive to the right.
    """

    time_s: float
    hour_h: float
    angle_deg: float

    @property
    def words(self) -> str:
        """When, how far and to which side."""
        side = "right" if self.angle_deg > 0.0 else "left"
        return f"{self.hour_h:.1f} h after its start by {abs(self.angle_deg):.1f} degrees to the {side}"


def knocks_of(run: MeasuredRun) -> tuple[Knock, ...]:
    """All that are plain in a run, in order of time."""
    found: list[Knock] = []
    while len(found) < _MOST and (knock := _plainest(run)) is not None:
        found.append(knock)
        run = replace(run, points_cm=turned_back(run.points_cm, run.time_s, [knock]))
    return tuple(sorted(found, key=lambda one: one.time_s))


def turned_back(points_cm: Array, time_s: Array, knocks: Sequence[Knock]) -> Array:
    """Stems as they would have been seen had nothing been knocked, shape (n, 10, 2).

    Args:
        points_cm: shape (n, 10, 2).
        time_s: of the rows, shape (n,).
        knocks: of the run.
    """
    turn_rad = np.zeros(len(time_s))
    for knock in knocks:
        turn_rad[time_s >= knock.time_s] -= math.radians(knock.angle_deg)
    return turned_right(points_cm, turn_rad)


def _plainest(run: MeasuredRun) -> Knock | None:
    """The one whose turn is widest, if any is plain."""
    rows = np.flatnonzero(run.is_measured)
    if len(rows) < 4 * _ROWS:
        return None
    stems, time_h = run.points_cm[rows], rows * (run.step_s / 3600.0)
    before, after, is_dense = _on_both_sides(stems, time_h, run.step_s / 3600.0)
    cross = before[..., 1] * after[..., 0] - before[..., 0] * after[..., 1]
    turn_rad = np.arctan2(cross.sum(axis=1), (before * after).sum(axis=(1, 2)))
    left = ((after - turned_right(before, turn_rad)) ** 2).sum(axis=(1, 2))
    went = np.maximum(1e-12, ((after - before) ** 2).sum(axis=(1, 2)))
    is_far = np.abs(turn_rad) > max(math.radians(_LEAST_DEG), _MADS * usual_sd(np.abs(turn_rad)))
    is_plain = is_dense & is_far
    is_plain &= left < _NOT_RIGID**2 * went
    # Beside a moment at which a stem bends at once, lines that lead across it may turn the stem there as a whole.
    is_plain &= np.abs(turn_rad) == maximum_filter1d(np.abs(turn_rad), 2 * _ROWS + 1)
    if not is_plain.any():
        return None
    at = int(np.argmax(np.where(is_plain, np.abs(turn_rad), 0.0)))
    row = int(rows[at + _ROWS])
    time_s = float(run.time_s[row])
    return Knock(time_s, (time_s - float(run.time_s[0])) / 3600.0, math.degrees(float(turn_rad[at])))


def _on_both_sides(stems: Array, time_h: Array, step_h: float) -> tuple[Array, Array, Array]:
    """Where stems were in the middle between each two rows, by the rows before and by those after.

    Args:
        stems: shape (n, 10, 2).
        time_h: shape (n,).
        step_h: between rows without gaps.

    Returns:
        Two of shape (n - 2 * _ROWS + 1, 10, 2), about their feet; and where gaps are short enough for that.
    """
    own = (stems - stems[:, :1]).reshape(len(stems), -1)
    count = len(stems) - 2 * _ROWS + 1
    first = np.arange(count)[:, None]
    middle_h = 0.5 * (time_h[_ROWS - 1 : _ROWS - 1 + count] + time_h[_ROWS : _ROWS + count])
    told = []
    for rows in (first + np.arange(_ROWS), first + _ROWS + np.arange(_ROWS)):
        there_h = time_h[rows] - middle_h[:, None]
        mean_h = there_h.mean(axis=1, keepdims=True)
        off_h = there_h - mean_h
        weight = 1.0 / _ROWS - mean_h * off_h / (off_h**2).sum(axis=1, keepdims=True)
        told.append(np.einsum("ij,ijk->ik", weight, own[rows]).reshape(count, *stems.shape[1:]))
    lasts_h = time_h[2 * _ROWS - 1 :] - time_h[:count]
    return told[0], told[1], lasts_h < (2 * _ROWS - 1) * step_h + _LONGEST_H
