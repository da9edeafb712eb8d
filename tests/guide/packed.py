"""Examples as they are kept in files and learnt from: their pixels one after the other, whatever their sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from flora_common import files
from flora_common.arrays import ByteArray
from flora_common.geometry import arc_length
from flora_common.vision.path.evidence import Evidence
from flora_common.vision.path.guide import mean_colour
from flora_common.vision.path.sampler import places_along
from guide.canvas import SHIFT, Floats, corners
from guide.examples import Example

PLANES: Final = 5
"""Evidence, three of code, and how far the stem is."""
AWAY_STEPS: Final = 4.0
"""Of the last plane in a px."""
LINE_POINTS: Final = 64
_FAR_PX: Final = 2000.0


@dataclass(frozen=True, slots=True, eq=False)
class Packed:
    """Some examples.

    Attributes:
        pixels: shape (px of all, PLANES), row by row.
        size: shape (n, 2), width and height.
        colour: shape (n, 3), the mean code of each plant.
        line: shape (n, LINE_POINTS, 2), each stem, evenly by arc length, (x, y) px.
    """

    pixels: ByteArray
    size: Floats
    colour: Floats
    line: Floats

    def write(self, path: Path) -> None:
        """Keep them, whole or not at all."""
        with files.atomic_writer(path) as file:
            np.savez(file, **{one.name: getattr(self, one.name) for one in fields(self)})

    @classmethod
    def read(cls, path: Path) -> Packed:
        """Those that were kept."""
        with np.load(path, allow_pickle=False) as arrays:
            return cls(*(arrays[one.name] for one in fields(cls)))


def packed(examples: Sequence[Example]) -> Packed:
    """Some examples, packed; at least one."""
    planes = [np.dstack([one.plant, one.code, _away(one)]).reshape(-1, PLANES) for one in examples]
    return Packed(
        np.concatenate(planes),
        np.array([one.plant.shape[::-1] for one in examples], dtype=np.float32),
        np.stack([mean_colour(Evidence((0, 0), one.plant, one.code, 1.0)) for one in examples]),
        np.stack([_even(one.line) for one in examples]),
    )


def _away(example: Example) -> ByteArray:
    """How far each pixel is from the stem, as far as a byte goes."""
    drawn = np.full(example.plant.shape, 255, np.uint8)
    cv2.polylines(drawn, corners(np.clip(example.line, -_FAR_PX, _FAR_PX)), False, 0, 1, cv2.LINE_8, SHIFT)
    away = cv2.distanceTransform(drawn, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.minimum(np.rint(away * AWAY_STEPS), 255).astype(np.uint8)


def _even(line: Floats) -> Floats:
    line = line.astype(np.float64)
    s = arc_length(line)
    return places_along(line, s, np.linspace(0.0, float(s[-1]), LINE_POINTS)).astype(np.float32)
