"""At what part of their size pictures are looked at.

Beyond some eleven pixels across the widest stem more of them tell nothing of where it is, and cost time with their
square. A JPEG's decoder averages while it decodes, so that a picture of half the size also takes half the time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import msgspec

from flora_common.arrays import FloatArray
from flora_common.runs import CameraSection
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.picture import REDUCTIONS, Reduction, full_px, reduced_size

WIDEST_STEM_PX: Final = 11.0
"""The widest stem keeps so many px: what the method was made for, 18 px per cm and stems of up to 6 mm."""
LEAST_SIDE_PX: Final = 400
"""A picture keeps so many px along its shorter side."""


@dataclass(frozen=True, slots=True)
class Reduced:
    """Pictures as they are looked at.

    Attributes:
        reduction: they have 1/reduction of the camera's width and height.
        camera: anchor, scale and size in their px.
        settings: with the window in their px.
    """

    reduction: Reduction
    camera: CameraSection
    settings: PathSettings

    @property
    def widest_px(self) -> float:
        """Width of the widest stem."""
        return self.settings.widest_stem_cm * self.camera.px_per_cm

    def full_px(self, places_px: FloatArray) -> FloatArray:
        """Places (..., 2) in px of the full picture."""
        return places_px if self.reduction == 1 else full_px(places_px, self.reduction)


def reduced(camera: CameraSection, settings: PathSettings) -> Reduced:
    """How the pictures of a camera are looked at.

    Args:
        camera: px of the full picture.
        settings: their reduction, where it is to be another one than the scale asks for.
    """
    reduction = _fitting(camera, settings) if settings.reduction is None else settings.reduction
    if reduction == 1:
        return Reduced(1, camera, settings)
    width, height = reduced_size((camera.width_px, camera.height_px), reduction)
    seen = msgspec.structs.replace(
        camera,
        anchor_px=(_reduced_px(camera.anchor_px[0], reduction), _reduced_px(camera.anchor_px[1], reduction)),
        px_per_cm=camera.px_per_cm / reduction,
        width_px=width,
        height_px=height,
    )
    if settings.window_px is not None:
        x0, y0, x1, y1 = (_reduced_px(v, reduction) for v in settings.window_px)
        settings = msgspec.structs.replace(settings, window_px=(x0, y0, x1, y1))
    return Reduced(reduction, seen, settings)


def _fitting(camera: CameraSection, settings: PathSettings) -> Reduction:
    widest_px = settings.widest_stem_cm * camera.px_per_cm
    shorter_px = min(camera.width_px, camera.height_px)
    fits = [r for r in REDUCTIONS if widest_px >= WIDEST_STEM_PX * r and shorter_px >= LEAST_SIDE_PX * r]
    return max(fits, default=1)


def _reduced_px(place_px: float, reduction: int) -> float:
    return (place_px + 0.5) / reduction - 0.5
