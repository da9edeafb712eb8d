"""What one grow box has that another has not: its cloth, its pot, its cables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flora_common.arrays import FloatArray
from flora_twin.box import Box, PinholeCamera


@dataclass(frozen=True, slots=True)
class Decor:
    """Drawn from the box's seed. All values are estimates after photographs of such boxes.

    Attributes:
        cloth_bgr: reflectance of the cloth on the back wall, shape (3,). Black cloth sends red and infrared back.
        fold_cm: height of the drapes.
        crease: height of the sharp creases relative to normal.
        dust: specks relative to normal.
        pot_bgr: reflectance of the pot, shape (3,).
        soil_covered: whether the cloth of the pot covers its soil too.
        skirting: reflectance of the edge between wall and floor, 0 for none.
        hides_cm: stem that the pot's cloth hides from the camera, seen at the anchor.
        lamp_share: light of the left and the right lamp that reaches the plant and the cloth, relative to normal: coils
            are wound by hand and hang as they hang, shape (2,).
        flash_bgr: colour of the flash, shape (3,): a warm bulb before a camera whose gains are a compromise between it
            and the lamps.
        waves: amplitude (cm), count round the rim and phase of the cloth's edge, shape (n, 3).
    """

    cloth_bgr: FloatArray
    fold_cm: float
    crease: float
    dust: float
    pot_bgr: FloatArray
    soil_covered: bool
    skirting: float
    hides_cm: float
    lamp_share: FloatArray
    flash_bgr: FloatArray
    waves: FloatArray

    @staticmethod
    def draw(seed: int) -> Decor:
        """The decor of a box."""
        rng = np.random.default_rng([seed, 22])
        level = 0.030 * np.exp(0.22 * rng.standard_normal())
        cloth = level * np.array([1.0, rng.uniform(0.88, 1.0), rng.uniform(1.05, 1.7)])
        pot = rng.choice([0.10, 0.17, 0.42]) * np.exp(0.1 * rng.standard_normal())
        counts = np.array([2.0, 3.0, 5.0, 9.0, 14.0])
        amplitude = np.array([0.14, 0.10, 0.08, 0.05, 0.03]) * rng.uniform(0.4, 1.2, 5)
        return Decor(
            cloth_bgr=cloth,
            fold_cm=float(rng.uniform(0.6, 1.3)),
            crease=float(rng.uniform(0.6, 1.5)),
            dust=float(rng.uniform(0.5, 2.0)),
            pot_bgr=pot * np.array([1.0, 0.98, 1.0]),
            soil_covered=bool(rng.random() < 0.5),
            skirting=float(rng.choice([0.0, 0.10, 0.4])),
            hides_cm=float(rng.uniform(0.1, 0.6)),
            lamp_share=np.exp(0.6 * np.clip(rng.standard_normal(2), -1.4, 1.4)),
            flash_bgr=np.array([rng.uniform(0.34, 0.80), 0.96, rng.uniform(1.08, 1.40)]),
            waves=np.stack([amplitude, counts, rng.uniform(0.0, 2 * np.pi, 5)], axis=1),
        )

    def rim_cloth_cm(self, angle_rad: npt.NDArray[np.floating], camera: PinholeCamera, box: Box) -> FloatArray:
        """Height above the soil of the edge of the pot's cloth, at directions from x towards the camera."""
        distance = box.camera_distance_cm
        radius = cloth_radius_cm(box)
        # The ray over the edge to the camera passes the anchor's axis at ``hides_cm``.
        eye = float(camera.position_cm[1])
        front = self.hides_cm + (eye - self.hides_cm) * radius / distance
        angle = np.asarray(angle_rad, dtype=np.float64)
        raised = sum(a * np.sin(n * angle + phase) for a, n, phase in self.waves)
        ahead = sum(float(a * np.sin(n * np.pi / 2 + phase)) for a, n, phase in self.waves)
        return np.asarray(front + raised - ahead, dtype=np.float64)


def cloth_radius_cm(box: Box) -> float:
    """Radius of the pot's cloth, outside its rim."""
    return box.pot_top_radius_cm + 0.50
