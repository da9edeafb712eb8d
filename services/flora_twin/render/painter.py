"""Faces to pixels: the plant on a canvas of its own, with the share of each pixel that it covers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from flora_common.arrays import Float32Array, FloatArray
from flora_twin.box import PinholeCamera
from flora_twin.render import optics
from flora_twin.render.mesh import Mesh
from flora_twin.render.surfaces import Front

_SUPERSAMPLE: Final = 3
_FULL_SCALE: Final = 2.5
"""Linear light that the 8-bit canvas can hold; it is square-root coded."""
_MARGIN_PX: Final = 5


@dataclass(frozen=True, slots=True)
class Patch:
    """A part of the picture.

    Attributes:
        window: rows and columns.
        light: linear light of what is painted, shape (h, w, 3).
        cover: share of the pixel that is painted, shape (h, w, 3); the lens sets the colours apart.
    """

    window: tuple[slice, slice]
    light: Float32Array
    cover: Float32Array


def paint(mesh: Mesh, colour: FloatArray, camera: PinholeCamera, front: Front | None) -> Patch | None:
    """Draw faces, the farthest first; None where none is in the picture.

    Args:
        mesh: faces.
        colour: linear light of each, shape (n, 3), blue, green, red.
        camera: that sees them.
        front: edge of the pot that hides what is behind it; None hides nothing.
    """
    depth = camera.position_cm[2] - mesh.corners_cm[:, :, 2].mean(axis=1)
    order = np.argsort(-depth, kind="stable")
    pixels = camera.project(mesh.corners_cm)
    low = np.floor(pixels.reshape(-1, 2).min(axis=0) - _MARGIN_PX).astype(int)
    high = np.ceil(pixels.reshape(-1, 2).max(axis=0) + _MARGIN_PX).astype(int) + 1
    x0, y0 = (int(v) for v in np.maximum(low, 0))
    x1, y1 = (int(v) for v in np.minimum(high, (camera.width_px, camera.height_px)))
    if x1 - x0 < 2 or y1 - y0 < 2:
        return None
    canvas = np.zeros(((y1 - y0) * _SUPERSAMPLE, (x1 - x0) * _SUPERSAMPLE, 4), np.uint8)
    corners = _cells(pixels, x0, y0)
    coded = (np.sqrt(np.clip(colour / _FULL_SCALE, 0.0, 1.0)) * 255.0)[order].tolist()
    behind = int((depth[order] > front.depth_cm).sum()) if front else 0
    fill = cv2.fillConvexPoly
    for step, face in enumerate(order):
        if front and step == behind:
            cv2.fillPoly(canvas, [_cells(front.edge_px, x0, y0)], (0, 0, 0, 0), cv2.LINE_8, 4)
        b, g, r = coded[step]
        fill(canvas, corners[face], (b, g, r, 255.0), cv2.LINE_8, 4)
    if front and behind == len(order):
        cv2.fillPoly(canvas, [_cells(front.edge_px, x0, y0)], (0, 0, 0, 0), cv2.LINE_8, 4)
    small = cv2.resize(canvas, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
    window = (slice(y0, y1), slice(x0, x1))
    light, cover = optics.through_lens(small.astype(np.float32), window, camera)
    light = np.asarray((light / np.maximum(cover, 1.0)) ** 2 * np.float32(_FULL_SCALE), dtype=np.float32)
    return Patch(window, light, cover * np.float32(1.0 / 255.0))


def _cells(pixels: FloatArray, x0: int, y0: int) -> npt.NDArray[np.int32]:
    """Places on the canvas in sixteenths: a pixel's middle is at whole numbers, its k x k cells lie round it."""
    k = _SUPERSAMPLE
    cells = ((pixels - (x0, y0)) * k + (k - 1) / 2) * 16.0
    return np.rint(np.clip(cells, -3e5, 3e5)).astype(np.int32)
