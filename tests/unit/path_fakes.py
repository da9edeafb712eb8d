"""Drawn plants for tests of the path method, and how far off its tips are."""

from __future__ import annotations

import math

import cv2
import numpy as np

from flora_common.arrays import FloatArray
from flora_common.runs import CameraSection
from flora_common.vision.picture import Picture
from flora_common.vision.reading import StemReading

WIDTH, HEIGHT, SCALE = 480, 400, 20.0
ANCHOR = (240.0, 385.0)
CAMERA = CameraSection(anchor_px=ANCHOR, px_per_cm=SCALE, width_px=WIDTH, height_px=HEIGHT)
STEM = (60, 190, 150)


def drawn(picture: Picture, line_cm: FloatArray, colour: tuple[int, int, int] = STEM, width: int = 5) -> Picture:
    """A stem, or a leaf, along a line, shape (n, 2), painted over a picture of :data:`CAMERA`."""
    px = np.array(ANCHOR) + line_cm * np.array([SCALE, -SCALE])
    cv2.polylines(picture, [np.rint(16 * px).astype(np.int32)], False, colour, width, cv2.LINE_AA, 4)
    return picture


def tip_error_mm(reading: StemReading, line_cm: FloatArray) -> float:
    """How far the tip that was found is from a line's end."""
    assert reading.points_cm is not None
    return 10.0 * math.dist(reading.points_cm[-1], line_cm[-1])
