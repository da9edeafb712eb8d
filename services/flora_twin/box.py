"""The grow box: where lamps, flash, walls, pot and plant are.

One frame of reference for plant, lamps and camera: centimetres, origin at the anchor (where the stem leaves the soil),
x to the right in the picture, y up, z towards the camera.

Source of the figures: Wahby et al. 2018, section "Bio-hybrid setup" (lamps 30 cm above the soil and 35 cm to either side
at the back wall; camera 74 cm in front at 32 cm height; flash 80 cm above the ground over the pot). Heights of camera and
flash are read as above the ground. What the paper leaves open is marked as an estimate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.geometry import FloatArray


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
        return np.array([[-self.lamp_distance_cm, self.lamp_height_cm, z], [self.lamp_distance_cm, self.lamp_height_cm, z]])

    @property
    def reference_distance_cm(self) -> float:
        """Distance from a lamp to the anchor: light is told relative to one full lamp there."""
        return float(np.linalg.norm(self.lamps_cm[0]))


BOX: Final = Box()
