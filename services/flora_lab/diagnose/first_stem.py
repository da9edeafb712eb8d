"""The stem that a free run starts from, rid of what its measurement added.

Ten points of a young stem lie less than a centimetre apart: an error of a quarter of a millimetre turns the lowest
piece by two degrees, and tissue at the foot keeps for days what it is told. So the first stem is the plainest curve
that differs from the measured points by no more than they differ by themselves.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from flora_common.arrays import Array

_ROWS: Final = 3
"""The curve is laid through the mean of so many at most."""
_ROWS_S: Final = 600.0
"""They lie within so many seconds: later ones tell another stem."""
_NOISE_ROWS: Final = 13
"""So many tell how much points differ from row to row."""
_LEAST_CM: Final = 0.005
_DEGREES: Final = (1, 2, 3, 4, 5)
_WITHIN: Final = 1.25
"""How much farther off than the noise a curve may be."""
_NORMAL: Final = 1.4826
"""Standard deviation over the median of what is away from the middle, of a normal distribution."""


def first_stem(points_cm: Array, step_s: float) -> Array:
    """The stem at the start of a run, shape (10, 2), its foot at the anchor.

    Args:
        points_cm: measured stems, shape (rows, 10, 2), the first one seen.
        step_s: between them.
    """
    first = points_cm[: min(_ROWS, 1 + int(_ROWS_S // step_s))]
    told = np.nanmean(first, axis=0)
    noise_cm = _noise_cm(points_cm[:_NOISE_ROWS]) / np.sqrt(np.isfinite(first[:, -1, 0]).sum())
    return np.stack([_plainest(told[:, axis], noise_cm[axis]) for axis in range(2)], axis=1)


def _noise_cm(points_cm: Array) -> Array:
    """Standard deviation of both coordinates from row to row, shape (2,). Most points hardly move in five minutes."""
    steps = np.diff(points_cm[:, 1:], axis=0)
    steps = steps[np.isfinite(steps).all(axis=(1, 2))]
    if not len(steps):
        return np.full(2, _LEAST_CM)
    away = np.abs(steps - np.median(steps, axis=0)).reshape(-1, 2)
    return np.asarray(np.maximum(_NORMAL * np.median(away, axis=0) / np.sqrt(2.0), _LEAST_CM))


def _plainest(values: Array, noise_cm: float) -> Array:
    """A polynomial through the anchor along the points, of the lowest degree that will do; else the values."""
    along = np.linspace(0.0, 1.0, len(values))
    for degree in _DEGREES:
        powers = along[:, None] ** np.arange(1, degree + 1)
        weights = np.linalg.lstsq(powers, values, rcond=None)[0]
        curve = powers @ weights
        off_cm = np.sqrt(np.sum((curve - values) ** 2) / (len(values) - 1 - degree))
        if off_cm <= _WITHIN * noise_cm:
            return np.asarray(curve)
    return values
