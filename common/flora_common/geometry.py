"""Stem, obstacle, target, collision and fitness, in the picture plane.

One frame of reference for rig and lab alike: centimetres, origin at the anchor (where the stem leaves the soil),
x to the right in the picture, y up. All functions are pure and take plain numpy arrays.

Sources: Wahby et al. 2018, section "Stem motion tracking" (ten points), "Task" (obstacle, target) and the equation
of the behavioural fitness F.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from flora_common.arrays import FloatArray
from flora_common.runs import CameraSection
from flora_common.shapes import STEM_POINTS, Obstacle


def unit(vector: FloatArray) -> FloatArray:
    """A vector, shape (2,), at length 1; nothing where it has none."""
    return np.asarray(vector / max(1e-9, float(np.hypot(vector[0], vector[1]))), dtype=np.float64)


def heading_at_end(line: FloatArray, over: float) -> FloatArray:
    """Where the last piece of a line, shape (n, 2), leads, of length 1; that is ``over`` long, or all of the line."""
    s = arc_length(line)
    return unit(line[-1] - line[int(np.searchsorted(s, s[-1] - over))])


def collides(points_cm: npt.ArrayLike, obstacle: Obstacle) -> bool:
    """Whether the polyline through ``points_cm`` touches the obstacle anywhere, not only at its points.

    Args:
        points_cm: shape (n, 2), n >= 2, in cm.
        obstacle: the rectangle; its edge belongs to it.

    Returns:
        True where at least one segment has a point in common with the closed rectangle (Liang-Barsky clipping of each
        segment against the four half planes, all segments at once).
    """
    p = np.asarray(points_cm, dtype=np.float64)
    start, step = p[:-1], np.diff(p, axis=0)
    low = np.array([obstacle.left_cm, obstacle.bottom_cm])
    high = np.array([obstacle.right_cm, obstacle.top_cm])
    with np.errstate(divide="ignore", invalid="ignore"):
        t_a = (low - start) / step
        t_b = (high - start) / step
    parallel = step == 0.0
    outside = parallel & ((start < low) | (start > high))
    t_enter = np.where(parallel, -np.inf, np.minimum(t_a, t_b)).max(axis=1)
    t_leave = np.where(parallel, np.inf, np.maximum(t_a, t_b)).min(axis=1)
    hit = (np.maximum(t_enter, 0.0) <= np.minimum(t_leave, 1.0)) & ~outside.any(axis=1)
    return bool(hit.any())


def clearance_cm(points_cm: npt.ArrayLike, obstacle: Obstacle) -> float:
    """Smallest distance in cm between the polyline (n, 2) and the obstacle; 0 where they touch."""
    if collides(points_cm, obstacle):
        return 0.0
    p = np.asarray(points_cm, dtype=np.float64)
    low = np.array([obstacle.left_cm, obstacle.bottom_cm])
    high = np.array([obstacle.right_cm, obstacle.top_cm])
    outside = np.maximum(np.maximum(low - p, p - high), 0.0)
    nearest = float(np.hypot(outside[:, 0], outside[:, 1]).min())
    corners = np.array(
        [
            (obstacle.left_cm, obstacle.bottom_cm),
            (obstacle.left_cm, obstacle.top_cm),
            (obstacle.right_cm, obstacle.bottom_cm),
            (obstacle.right_cm, obstacle.top_cm),
        ]
    )
    return min(nearest, float(distance_to_polyline_cm(corners, p).min()))


def distance_to_polyline_cm(points_cm: npt.ArrayLike, polyline_cm: npt.ArrayLike) -> FloatArray:
    """Distance of each point (m, 2) to the polyline (n, 2), n >= 2; returns shape (m,)."""
    q = np.asarray(points_cm, dtype=np.float64)[:, None, :]
    line = np.asarray(polyline_cm, dtype=np.float64)
    a, ab = line[:-1], np.diff(line, axis=0)
    length2 = np.maximum((ab**2).sum(axis=1), 1e-30)
    t = np.clip(((q - a) * ab).sum(axis=2) / length2, 0.0, 1.0)
    nearest = a + t[..., None] * ab
    distances: FloatArray = np.sqrt(((q - nearest) ** 2).sum(axis=2)).min(axis=1)
    return distances


def to_px(points_cm: FloatArray, camera: CameraSection) -> FloatArray:
    """Points (..., 2) in cm from the anchor, y up, as places of the picture in px, y down."""
    return np.asarray(np.array(camera.anchor_px) + points_cm * np.array([1.0, -1.0]) * camera.px_per_cm)


def turned_right(points: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Points (n, k, 2), y up, turned about (0, 0) to the right by angles, shape (n,)."""
    cos, sin = np.cos(angle_rad)[:, None], np.sin(angle_rad)[:, None]
    x, y = points[..., 0], points[..., 1]
    return np.stack([x * cos + y * sin, y * cos - x * sin], axis=-1)


def polyline_length(points: FloatArray) -> FloatArray:
    """Length of polylines through points of shape (..., n, 2), in their unit; shape (...)."""
    steps = np.diff(points, axis=-2)
    return np.asarray(np.hypot(steps[..., 0], steps[..., 1]).sum(axis=-1))


def arc_length(line: FloatArray) -> FloatArray:
    """Distance along a polyline (n, 2) from its first point, in its unit; shape (n,)."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])


def resample_by_height(centreline_cm: npt.ArrayLike, count: int = STEM_POINTS) -> FloatArray:
    """Points of a centreline at heights evenly spaced from anchor to tip: the convention of ``track.csv``.

    Args:
        centreline_cm: shape (n, 2), anchor first, tip last.
        count: number of points.

    Returns:
        Shape (count, 2). The first is the anchor, the last the tip. Where the line passes a height more than once
        (a stem that folds back), the passage nearest to the anchor along the stem is taken.
    """
    line = np.asarray(centreline_cm, dtype=np.float64)
    heights = np.linspace(line[0, 1], line[-1, 1], count)
    out = np.empty((count, 2))
    out[0], out[-1] = line[0], line[-1]
    if (np.diff(line[:, 1]) > 0).all():  # the usual case, and some ten times faster than looking for each crossing
        out[1:-1, 0], out[1:-1, 1] = np.interp(heights[1:-1], line[:, 1], line[:, 0]), heights[1:-1]
        return out
    for i in range(1, count - 1):
        below = line[:, 1] - heights[i]
        crossing = np.nonzero((below[:-1] <= 0) & (below[1:] > 0) | (below[:-1] >= 0) & (below[1:] < 0))[0]
        if crossing.size == 0:
            nearest = line[int(np.argmin(np.abs(below)))]
            out[i] = nearest[0], heights[i]
            continue
        k = int(crossing[0])
        share = below[k] / (below[k] - below[k + 1])
        out[i] = line[k, 0] + share * (line[k + 1, 0] - line[k, 0]), heights[i]
    return out
