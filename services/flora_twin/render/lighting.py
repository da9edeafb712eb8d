"""How strong the lights are, and what they do to a matte surface."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from flora_common.arrays import Float32Array, FloatArray
from flora_twin.box import Box
from flora_twin.strips import LampLight

FLASH_LEVEL: Final = 1.15
"""Light of the flash on a white surface at the anchor that faces it. Estimate: a household bulb at 20 ms."""
FLASH_RADIUS_CM: Final = 6.0
FLASH_BOUNCE: Final = 0.30
"""Share of the flash that comes back from the box's walls from all sides. Estimate."""
LAMP_LEVEL: Final = 0.95
"""Light of one full white lamp on a white surface at the anchor that faces it. Estimate."""
LAMP_BOUNCE: Final = 0.07
LAMP_WRAP: Final = 0.06
"""How far past its edge a surface still sees the lamp, which is wide: share of the cosine."""
LEAK: Final = 0.004
"""Daylight that leaks into the box. Estimate."""

_PRIMARIES: Final = np.array([[0.02, 0.13, 1.20], [0.06, 0.85, 0.22], [0.74, 0.09, 0.02]])
"""Rows blue, green, red of the sensor; columns red, green, blue of the strip (630, 530, 475 nm). Estimate."""


def lamp_bgr(lamp: LampLight) -> Float32Array:
    """What the sensor sees of one lamp's colour: about 1 for full white, which looks bluish beside the warm flash."""
    return np.asarray(_PRIMARIES @ lamp.rgb, dtype=np.float32)


def flash_at(place_cm: npt.NDArray[np.floating], box: Box) -> tuple[Float32Array, Float32Array]:
    """Level (...) of the flash at places (..., 3) and the unit vectors (..., 3) towards it."""
    level, towards = _point_light(place_cm, box.flash_cm)
    shade = np.maximum(towards[..., 1], 0.0) ** 1.5  # the lamp's shade sends its light down
    return (level * shade * FLASH_LEVEL * float(box.flash_cm[1]) ** 2).astype(np.float32), towards


def lamp_at(place_cm: npt.NDArray[np.floating], which: int, box: Box) -> tuple[Float32Array, Float32Array]:
    """Level (...) of lamp 0 (left) or 1 (right) at places (..., 3) and the unit vectors (..., 3) towards it."""
    level, towards = _point_light(place_cm, box.lamps_cm[which], softened_cm2=box.lamp_radius_cm**2)
    return (level * LAMP_LEVEL * box.reference_distance_cm**2).astype(np.float32), towards


def _point_light(
    place_cm: npt.NDArray[np.floating], source_cm: FloatArray, softened_cm2: float = 0.0
) -> tuple[Float32Array, Float32Array]:
    offset = (source_cm - place_cm).astype(np.float32)
    r2 = np.einsum("...i,...i->...", offset, offset)
    return 1.0 / (r2 + np.float32(softened_cm2)), offset / np.sqrt(r2)[..., None]
