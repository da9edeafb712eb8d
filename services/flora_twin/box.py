"""The grow box: where lamps, flash, walls, pot, plant and camera are, and where the camera sees them.

One frame of reference for plant, lamps and camera: centimetres, origin at the anchor (where the stem leaves the soil),
x to the right in the picture, y up, z towards the camera.

Source of the figures: Wahby et al. 2018, section "Bio-hybrid setup" (lamps 30 cm above the soil and 35 cm to either
side at the back wall; camera 74 cm in front at 32 cm height; flash 80 cm above the ground over the pot). Heights of
camera and flash are read as above the ground. What the paper leaves open is marked as an estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.runs import CameraSection


@dataclass(frozen=True, slots=True)
class Box:
    """Places and sizes in cm; see the module's frame of reference."""

    lamp_distance_cm: float = 35.0
    lamp_height_cm: float = 30.0
    lamp_radius_cm: float = 3.6
    """Radius of the coil; an estimate (1 m of strip in three turns and a half)."""
    lamp_body_cm: float = 8.0
    """Height of the coiled cylinder; an estimate."""
    wall_z_cm: float = -16.0
    """The back wall; an estimate: the paper gives the box's depth only (120 cm)."""
    pot_height_cm: float = 12.0
    """Soil above the ground; an estimate."""
    pot_top_radius_cm: float = 6.4
    pot_bottom_radius_cm: float = 4.7
    rim_above_soil_cm: float = 0.5
    flash_above_ground_cm: float = 80.0
    camera_above_ground_cm: float = 32.0
    camera_distance_cm: float = 74.0

    @property
    def ground_y_cm(self) -> float:
        return -self.pot_height_cm

    @property
    def camera_y_cm(self) -> float:
        return self.camera_above_ground_cm - self.pot_height_cm

    @property
    def flash_cm(self) -> FloatArray:
        """Position of the flash lamp, shape (3,)."""
        return np.array([0.0, self.flash_above_ground_cm - self.pot_height_cm, 0.0])

    @property
    def lamps_cm(self) -> FloatArray:
        """Centres of the left and the right lamp, shape (2, 3)."""
        z = self.wall_z_cm + self.lamp_radius_cm + 1.0
        return np.array(
            [[-self.lamp_distance_cm, self.lamp_height_cm, z], [self.lamp_distance_cm, self.lamp_height_cm, z]]
        )

    @property
    def reference_distance_cm(self) -> float:
        """Distance from a lamp to the anchor: light is told relative to one full lamp there."""
        return float(np.linalg.norm(self.lamps_cm[0]))


BOX: Final = Box()


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


def camera_section() -> CameraSection:
    """The ``[camera]`` section of ``run.toml`` for the virtual box's photographs."""
    return CAMERA.camera_section()
