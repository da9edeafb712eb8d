"""How long the stem is: what was measured, held against what a stem can do between two pictures.

A Kalman filter (Kalman 1960) with length and its rate of change as state. A stem seen to its end is measured to a
fraction of a millimetre; one whose tip a leaf hides is at least as long as what is seen of it, and as long as it was
likely to become otherwise.
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np

USUAL_RATE_CM_PER_H: Final = 0.15
RATE_SPREAD_CM_PER_H: Final = 0.15
SWAY_CM_PER_ROOT_H: Final = 0.10
"""A stem that leans towards the camera or away from it seems shorter or longer: bean tips circle by a centimetre."""
SURPRISE: Final = 3.0
"""In standard deviations: from here on a measurement counts less."""
LONGER_BELIEVED, SHORTER_BELIEVED = 3.0, 8.0
"""After so many surprises of one kind the belief was wrong: a stem whose top was missed is read short, again and again,
and a leaf that is taken for its top makes it long."""
SURPRISES_FADE: Final = 0.5
"""Of their count, with each picture that is none."""
RATE_DRIFT_CM_PER_H_ROOT_H: Final = 0.04


class LengthState(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What is believed of a stem's length after a picture.

    Attributes:
        time_s: of that picture.
        length_cm, rate_cm_per_h: means.
        length_var, rate_var, covariance: of the two.
        surprises: how many measurements of late were far longer (positive) or shorter (negative) than believed.
    """

    time_s: float
    length_cm: float
    rate_cm_per_h: float = USUAL_RATE_CM_PER_H
    length_var: float = 0.01
    rate_var: float = RATE_SPREAD_CM_PER_H**2
    covariance: float = 0.0
    surprises: float = 0.0


def predicted(state: LengthState, time_s: float) -> LengthState:
    """The belief carried to a later time."""
    hours = max(0.0, (time_s - state.time_s) / 3600.0)
    return LengthState(
        max(time_s, state.time_s),
        state.length_cm + state.rate_cm_per_h * hours,
        state.rate_cm_per_h,
        state.length_var + 2.0 * hours * state.covariance + hours**2 * state.rate_var + SWAY_CM_PER_ROOT_H**2 * hours,
        state.rate_var + RATE_DRIFT_CM_PER_H_ROOT_H**2 * hours,
        state.covariance + hours * state.rate_var,
        state.surprises,
    )


def measured(
    before: LengthState | None, time_s: float, length_cm: float, error_cm: float, *, hidden: bool
) -> LengthState:
    """The belief after a picture.

    Args:
        before: the belief so far; None for the first picture.
        time_s: of the picture.
        length_cm: along the stem as far as it was seen.
        error_cm: standard deviation of that.
        hidden: the stem may go on behind a leaf: longer is then no contradiction.
    """
    if before is None:
        return LengthState(time_s, length_cm, length_var=error_cm**2)
    state = predicted(before, time_s)
    if hidden and state.length_cm > length_cm:
        return state
    total = state.length_var + error_cm**2
    off = length_cm - state.length_cm
    # a stem does not jump: what is far off says that the picture was misread more than that the stem has changed
    surprise = abs(off) / (SURPRISE * total**0.5)
    surprises = _surprises(state.surprises, off, surprise > 1.0)
    if surprises >= LONGER_BELIEVED or surprises <= -SHORTER_BELIEVED:
        return LengthState(state.time_s, length_cm, length_var=error_cm**2)
    total *= max(1.0, surprise) ** 4
    gain, rate_gain = state.length_var / total, state.covariance / total
    return LengthState(
        state.time_s,
        state.length_cm + gain * off,
        float(np.clip(state.rate_cm_per_h + rate_gain * off, -0.2, 0.8)),
        (1.0 - gain) * state.length_var,
        max(1e-6, state.rate_var - rate_gain * state.covariance),
        (1.0 - gain) * state.covariance,
        surprises,
    )


def _surprises(before: float, off_cm: float, surprising: bool) -> float:
    if not surprising:
        return before * SURPRISES_FADE
    return max(before, 0.0) + 1.0 if off_cm > 0.0 else min(before, 0.0) - 1.0
