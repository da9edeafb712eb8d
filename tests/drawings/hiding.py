"""How much of a stem leaves may hide, so that a person can still say where it is."""

from __future__ import annotations

import cv2
import numpy as np

from drawings.growth import Posture
from flora_common.arrays import FloatArray

HIDDEN_CM = 2.5
"""No leaf may hide more of the stem than this in one place."""
TIP_HIDDEN_CM = 0.09
"""The stem's end is never further than this from a part of the stem that is seen."""


def fair(posture: Posture, hidden: FloatArray) -> bool:
    """Whether enough of the stem is seen, see ``HIDDEN_CM`` and ``TIP_HIDDEN_CM``."""
    seen = posture.line_cm[~hidden]
    if len(seen) < 0.5 * len(hidden) or np.hypot(*(seen - posture.line_cm[-1]).T).min() > TIP_HIDDEN_CM:
        return False
    edges = np.flatnonzero(np.diff(np.concatenate([[0], hidden.astype(int), [0]])))
    longest = (edges[1::2] - edges[::2]).max(initial=0)
    return bool(longest * (posture.along_cm[1] - posture.along_cm[0]) <= HIDDEN_CM)


def inside(points: FloatArray, polygon: FloatArray) -> FloatArray:
    """Which points (n, 2) lie in the polygon (m, 2); shape (n,), bool."""
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    near = ((points >= low) & (points <= high)).all(axis=1)
    outline = polygon.astype(np.float32)
    found = np.zeros(len(points), bool)
    for i in np.flatnonzero(near):
        found[i] = cv2.pointPolygonTest(outline, (float(points[i, 0]), float(points[i, 1])), False) >= 0
    return found
