"""Values of the evidence at places between pixels, and lines through them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np

from flora_common.arrays import Float32Array, FloatArray
from flora_common.vision.path.evidence import Evidence

ROW_PX: Final = 1024
LEAF_GREENER: Final = (6.0, 14.0)
"""Code units, green against red, by which leaves are greener than the stem that bears them: from no leaf to surely one.
Colours differ from plant to plant and under other lamps; this does not depend on how much light falls on either."""
HALF_LIGHT_LEVEL: Final = 0.65
"""Share of full evidence at which half of the light comes from the plant: evidence is logarithmic. Edges and ends of a
stem lie there."""


class Sampler:
    """Values of the evidence at places of the full picture, linear between pixels, 0 outside.

    Attributes:
        least: what has less evidence than this was taken for noise.
    """

    def __init__(self, evidence: Evidence) -> None:
        self.least = evidence.least
        self._plant, self._tone = evidence.plant, evidence.tone
        green, red = evidence.code[..., 1], evidence.code[..., 2]
        self._green = np.asarray(cv2.subtract(green, red, dtype=cv2.CV_32F), dtype=np.float32)
        self._origin = np.array(evidence.origin_px, dtype=np.float64)

    def plant(self, places: FloatArray) -> FloatArray:
        """Evidence of plant at places (..., 2)."""
        return self.plant_at(places[..., 0], places[..., 1])

    def plant_at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """The same at places whose coordinates are apart, which takes half as long for many."""
        return self._at(self._plant, x, y)

    def tone(self, places: FloatArray) -> FloatArray:
        """Brightness at places (..., 2)."""
        return self.tone_at(places[..., 0], places[..., 1])

    def tone_at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """The same at places whose coordinates are apart."""
        return self._at(self._tone, x, y)

    def green(self, places: FloatArray) -> FloatArray:
        """How much greener than red it is at places (..., 2)."""
        return self._at(self._green, places[..., 0], places[..., 1])

    def stem(self, places: FloatArray, green: float) -> FloatArray:
        """Evidence of plant at places (..., 2), but not of what is greener than a stem that is so green: a leaf."""
        return self.plant(places) * self.no_leaf(places, green)

    def no_leaf(self, places: FloatArray, green: float) -> FloatArray:
        """1 where it is as green as a stem at places (..., 2), 0 where it is as much greener as leaves are."""
        return np.clip((green + LEAF_GREENER[1] - self.green(places)) / (LEAF_GREENER[1] - LEAF_GREENER[0]), 0.0, 1.0)

    def _at(self, values: Float32Array, x: FloatArray, y: FloatArray) -> FloatArray:
        return values_at(values, x, y, self._origin)


def values_at(
    values: Float32Array, x: FloatArray, y: FloatArray, origin: Sequence[float] | FloatArray = (0.0, 0.0)
) -> FloatArray:
    """Values at places, linear between pixels and 0 outside; shape of ``x``.

    Args:
        values: shape (height, width), its first pixel at ``origin``.
        x, y: of the places, in its pixels.
        origin: (x, y).
    """
    if x.size == 0:
        return np.zeros(x.shape)
    # OpenCV takes no picture of places with more than 32767 rows or columns
    columns = min(x.size, ROW_PX)
    maps = np.zeros((2, -(-x.size // columns) * columns), np.float32)
    for one, v, first in zip(maps, (x, y), origin, strict=True):
        np.subtract(v.ravel(), first, out=one[: x.size], casting="same_kind")
    right, down = maps.reshape(2, -1, columns)
    found = cv2.remap(values, right, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(found.ravel()[: x.size], dtype=np.float64).reshape(x.shape)


def normals(line: FloatArray) -> FloatArray:
    """Unit vectors across a line (n, 2)."""
    tangent = np.gradient(line, axis=0)
    tangent /= np.maximum(np.hypot(tangent[:, 0], tangent[:, 1]), 1e-9)[:, None]
    return np.column_stack([-tangent[:, 1], tangent[:, 0]])


def places_along(line: FloatArray, s: FloatArray, at: FloatArray) -> FloatArray:
    """Places at some distances along a line (n, 2), whose own points lie at distances ``s``; shape (len(at), 2)."""
    return np.column_stack([np.interp(at, s, line[:, k]) for k in range(2)])
