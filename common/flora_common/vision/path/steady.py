"""Which way the last centimetres point: what was measured, held against how slowly a stem's shape changes.

Among the young leaves round an apex the last centimetre and a half of a stem can hardly be measured: arcs that differ
by a millimetre or two at their end explain a picture equally well, and which is best changes from picture to picture.
The shape of a stem's end, as the angle between its last section and the one before, changes over hours. So that angle
has a scalar Kalman filter (Kalman 1960), and the last section is bent to what is believed. A stem that turns
as a whole is not held back: both sections turn with it.
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np

from flora_common.geometry import FloatArray
from flora_common.vision.path.curve import arc_length

SECTION_CM: Final = 1.8
DRIFT_RAD_PER_ROOT_H: Final = 0.1
ERROR_CM: Final = 0.06
"""Standard deviation of the tip across the stem; how much of its end was carried on, unmeasured, says nothing of it."""
SURPRISE: Final = 5.0
"""In standard deviations: what is farther off is another shape, and taken as it is."""


class TurnState(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What is believed of the angle between the last two sections of a stem.

    Attributes:
        time_s: of the picture.
        turn_rad: mean.
        var: variance, square radians.
    """

    time_s: float
    turn_rad: float
    var: float


def turn_of(line: FloatArray, section_px: float) -> float | None:
    """Angle between the last two sections of a line, radians; None where it is shorter than both.

    Args:
        line: shape (n, 2), px, tip last.
        section_px: length of a section along the line.
    """
    s = arc_length(line)
    if s[-1] < 2.0 * section_px:
        return None
    at = s[-1] - np.array([2.0, 1.0, 0.0]) * section_px
    p = np.column_stack([np.interp(at, s, line[:, k]) for k in range(2)])
    first, second = p[1] - p[0], p[2] - p[1]
    return float(np.arctan2(first[0] * second[1] - first[1] * second[0], first @ second))


def believed(before: TurnState | None, time_s: float, turn_rad: float) -> TurnState:
    """The belief after a picture.

    Args:
        before: the belief so far; None for the first picture.
        time_s: of the picture.
        turn_rad: as measured.
    """
    var = (ERROR_CM / SECTION_CM) ** 2
    if before is None:
        return TurnState(time_s, turn_rad, var)
    hours = max(0.0, time_s - before.time_s) / 3600.0
    prior = before.var + DRIFT_RAD_PER_ROOT_H**2 * hours
    off = turn_rad - before.turn_rad
    if abs(off) > SURPRISE * (prior + var) ** 0.5:
        return TurnState(time_s, turn_rad, var)
    gain = prior / (prior + var)
    return TurnState(time_s, before.turn_rad + gain * off, (1.0 - gain) * prior)


def bent(line: FloatArray, by_rad: float, section_px: float) -> FloatArray:
    """A line whose last section is bent, so that its end turns by an angle about the section's beginning."""
    s = arc_length(line)
    share = np.clip((s - (s[-1] - section_px)) / section_px, 0.0, 1.0)
    start = np.array([np.interp(s[-1] - section_px, s, line[:, k]) for k in range(2)])
    arm = line - start
    angle = by_rad * share
    turned = np.column_stack(
        [arm[:, 0] * np.cos(angle) - arm[:, 1] * np.sin(angle), arm[:, 0] * np.sin(angle) + arm[:, 1] * np.cos(angle)]
    )
    return np.asarray(np.where(share[:, None] > 0.0, start + turned, line), dtype=np.float64)
