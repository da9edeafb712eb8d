"""The pinhole camera: from places in the box to pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.geometry import FloatArray
from flora_common.runs import CameraSection
from flora_twin.box import BOX, Box


@dataclass(frozen=True, slots=True)
class PinholeCamera:
    """A camera that looks horizontally, square to the back wall.

    The default is the Pi camera v2 (field of view 62.2 x 48.8 degrees, data sheet of the IMX219 module) binned to
    1640 x 1232. Both directions share one focal length: pixels are square.
    """

    width_px: int = 1640
    height_px: int = 1232
    horizontal_field_deg: float = 62.2
    box: Box = BOX

    @property
    def focal_px(self) -> float:
        return self.width_px / 2 / math.tan(math.radians(self.horizontal_field_deg) / 2)

    @property
    def position_cm(self) -> FloatArray:
        """Shape (3,)."""
        return np.array([0.0, self.box.camera_y_cm, self.box.camera_distance_cm])

    @property
    def px_per_cm(self) -> float:
        """Scale in the plane of the plant, z = 0."""
        return self.focal_px / self.box.camera_distance_cm

    @property
    def anchor_px(self) -> tuple[float, float]:
        """Where the stem leaves the soil: x to the right and y down from the top left corner of the picture."""
        x, y = self.project(np.zeros((1, 3)))[0]
        return float(x), float(y)

    def project(self, points_cm: FloatArray) -> FloatArray:
        """Pixels (..., 2) of places (..., 3); the middle of the first pixel is (0, 0)."""
        offset = np.asarray(points_cm, dtype=np.float64) - self.position_cm
        depth = np.maximum(-offset[..., 2], 1.0)
        x = (self.width_px - 1) / 2 + self.focal_px * offset[..., 0] / depth
        y = (self.height_px - 1) / 2 - self.focal_px * offset[..., 1] / depth
        return np.stack([x, y], axis=-1)

    def rays(self) -> FloatArray:
        """Directions (height, width, 3) through all pixels, with z = -1: multiples are depths in cm."""
        x = (np.arange(self.width_px) - (self.width_px - 1) / 2) / self.focal_px
        y = ((self.height_px - 1) / 2 - np.arange(self.height_px)) / self.focal_px
        out = np.empty((self.height_px, self.width_px, 3))
        out[..., 0], out[..., 1], out[..., 2] = x[None, :], y[:, None], -1.0
        return out

    def to_picture_plane_cm(self, pixels: FloatArray) -> FloatArray:
        """What a measurement in the picture gives: pixels (..., 2) as cm from the anchor at the scale of z = 0."""
        ax, ay = self.anchor_px
        p = np.asarray(pixels, dtype=np.float64)
        return np.stack([(p[..., 0] - ax) / self.px_per_cm, (ay - p[..., 1]) / self.px_per_cm], axis=-1)

    def camera_section(self) -> CameraSection:
        """The ``[camera]`` section of ``run.toml`` for pictures of this camera."""
        return CameraSection(
            anchor_px=self.anchor_px, px_per_cm=self.px_per_cm, width_px=self.width_px, height_px=self.height_px
        )


CAMERA: Final = PinholeCamera()
