"""From ten points to a chain of segments and back: a smooth line through a measured stem."""

from __future__ import annotations

from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_common.errors import BadInput
from flora_common.shapes import STEM_POINTS
from flora_lab.simulator.measured import LEAST_CM
from flora_lab.simulator.rod import CAPACITY, points_lane

SEGMENT_CM: Final = 0.35
_FINE: Final = 16
"""Places per piece of the spline."""


def rods_through(points_cm: Array) -> tuple[Array, Array, Array]:
    """Segments of rods that run through measured stems.

    A natural cubic spline over the chord lengths goes through the points; a rod's segments are chords of equal arcs.

    Args:
        points_cm: shape (batch, 10, 2), the anchor first.

    Returns:
        ``length`` and ``angle`` (rad from the vertical, positive to the right) of shape (batch, CAPACITY), ``count`` of
        shape (batch,).

    Raises:
        BadInput: points that are not finite, or a stem of no length.
    """
    points = np.asarray(points_cm, dtype=np.float64)
    if not np.isfinite(points).all():
        raise BadInput("a simulator can only start from a stem that was measured: some points are not finite")
    batch = len(points)
    length, angle = np.zeros((batch, CAPACITY)), np.zeros((batch, CAPACITY))
    count = np.zeros(batch, dtype=np.int64)
    for b in range(batch):
        line = smooth_line(points[b])
        step = np.hypot(*np.diff(line, axis=0).T)
        arc = np.concatenate([[0.0], np.cumsum(step)])
        if arc[-1] < LEAST_CM:
            raise BadInput(f"a simulator cannot start from a stem of {10 * arc[-1]:.1f} mm; at least 1 mm is needed")
        n = min(int(np.ceil(arc[-1] / SEGMENT_CM)), CAPACITY - 1)
        at = np.linspace(0.0, arc[-1], n + 1)
        corners = np.stack([np.interp(at, arc, line[:, axis]) for axis in range(2)], axis=1)
        corners[-1] = points[b, -1]
        chord = np.diff(corners, axis=0)
        length[b, :n] = np.hypot(chord[:, 0], chord[:, 1])
        angle[b, :n] = np.unwrap(np.arctan2(chord[:, 0], chord[:, 1]))
        count[b] = n
    return length, angle, count


def can_start(points_cm: Array) -> Array:
    """Whether :func:`rods_through` can make rods of stems (batch, 10, 2), shape (batch,)."""
    chords = np.hypot(*np.moveaxis(np.diff(points_cm, axis=1), -1, 0))
    # False as well where a point is not finite. The line through the points is no shorter than their chords.
    return np.asarray(chords.sum(axis=1) >= LEAST_CM)


def points_of(length: Array, angle: Array, count: Array) -> Array:
    """Ten points of rods, shape (batch, 10, 2), as a track has them."""
    out = np.empty((len(count), STEM_POINTS, 2))
    for b in range(len(count)):
        points_lane(length[b], angle[b], count[b], out[b])
    return out


def smooth_line(points: Array) -> Array:
    """Natural cubic spline through points (n, 2) that differ, at ``_FINE`` places per piece."""
    gap = np.hypot(*np.diff(points, axis=0).T)
    points = points[np.concatenate([[True], gap > 1e-6])]
    gap = np.hypot(*np.diff(points, axis=0).T)
    n = len(points)
    if n < 3:
        return points if n == 2 else np.repeat(points, 2, axis=0)
    # Second derivatives m: the usual tridiagonal system, zero at both ends.
    system, right = np.eye(n), np.zeros((n, 2))
    slope = np.diff(points, axis=0) / gap[:, None]
    for i in range(1, n - 1):
        system[i, i - 1 : i + 2] = gap[i - 1], 2.0 * (gap[i - 1] + gap[i]), gap[i]
        right[i] = 6.0 * (slope[i] - slope[i - 1])
    m = np.linalg.solve(system, right)
    u = np.arange(_FINE) / _FINE
    a, b = (1.0 - u)[None, :, None], u[None, :, None]
    h2 = (gap**2 / 6.0)[:, None, None]
    pieces = a * points[:-1, None] + b * points[1:, None] + h2 * ((a**3 - a) * m[:-1, None] + (b**3 - b) * m[1:, None])
    return np.concatenate([pieces.reshape(-1, 2), points[-1:]])
