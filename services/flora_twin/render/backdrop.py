"""The box without a plant: one picture per light, in linear light, ready to be added up."""

from __future__ import annotations

from collections import OrderedDict
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from flora_twin.box import Box, PinholeCamera
from flora_twin.render import lighting
from flora_twin.render.surfaces import FLOOR, LAMP, POT, SOIL, Float32, Surfaces, see_box
from flora_twin.strips import OFF, LampLight

LENS_BLUR_PX: Final = 0.75
_KEPT: Final = 4
_EMISSION: Final = 14.0
_SATURATED: Final = 6.0


class Backdrop:
    """The static part of all photographs.

    Attributes:
        flash: shape (height, width, 3), the box under the flash alone.
        vignette: shape (height, width), fall of brightness towards the corners.
        shadow_map: for the ground window, the place (x, z) in cm on the plane y = 0 where the flash's ray to the pixel
            passes, shape (h, w, 2): what stands in that ray shadows the pixel.
        window: rows and columns of the ground window.
    """

    def __init__(self, camera: PinholeCamera, box: Box, seed: int) -> None:
        surfaces = see_box(camera, box, seed)
        self.vignette = _vignette(camera)
        self.flash = self._finish(_flash_light(surfaces, box))
        self._lamps = [self._finish(_lamp_light(surfaces, box, i), glare=surfaces.glow[i]) for i in range(2)]
        self.leak = self._finish(surfaces.albedo * np.float32(lighting.LEAK))
        self.window, self.shadow_map = _shadow_map(surfaces, box)
        self._ready: OrderedDict[tuple[LampLight, LampLight], Float32] = OrderedDict()

    def lamps(self, left: LampLight, right: LampLight) -> Float32:
        """The box under its lamps alone, shape (height, width, 3); kept for the states used last. Do not change it."""
        key = (left, right)
        if key in self._ready:
            self._ready.move_to_end(key)
            return self._ready[key]
        total = self.leak.copy()
        for lamp, unit in zip(key, self._lamps, strict=True):
            if lamp != OFF:
                total += unit * lighting.lamp_bgr(lamp)
        np.minimum(total, _SATURATED, out=total)
        self._ready[key] = total
        if len(self._ready) > _KEPT:
            self._ready.popitem(last=False)
        return total

    def _finish(self, light: Float32, glare: Float32 | None = None) -> Float32:
        """Glare of the lens round what is lit itself, blur and vignetting of the lens."""
        if glare is not None:
            light = light + (_EMISSION * glare)[..., None]
            small = cv2.resize(glare, None, fx=0.125, fy=0.125, interpolation=cv2.INTER_AREA)
            wide = 0.60 * cv2.GaussianBlur(small, (0, 0), 4.0) + 0.22 * cv2.GaussianBlur(small, (0, 0), 26.0)
            light += cv2.resize(wide, (light.shape[1], light.shape[0]), interpolation=cv2.INTER_LINEAR)[..., None]
        blurred = cv2.GaussianBlur(np.asarray(light, np.float32), (0, 0), LENS_BLUR_PX)
        return np.ascontiguousarray(blurred * self.vignette[..., None], dtype=np.float32)


def _vignette(camera: PinholeCamera) -> Float32:
    ray = camera.rays()
    r2 = ray[..., 0] ** 2 + ray[..., 1] ** 2
    return np.asarray(1.0 / (1.0 + 0.85 * r2), dtype=np.float32)


def _facing(surfaces: Surfaces, towards: Float32) -> Float32:
    return np.asarray(np.maximum(np.einsum("...i,...i->...", surfaces.normal, towards), 0.0), dtype=np.float32)


def _flash_light(s: Surfaces, box: Box) -> Float32:
    level, towards = lighting.flash_at(s.place_cm, box)
    direct = level * _facing(s, towards)
    # The pot's rim keeps the flash from the floor round the pot and from the pot's own side.
    floor = s.kind == FLOOR
    drop = (box.flash_cm[1] - box.rim_above_soil_cm) / (box.flash_cm[1] - s.place_cm[..., 1])
    through = np.hypot(s.place_cm[..., 0], s.place_cm[..., 2]) * drop
    open_sky = _smooth(through, box.pot_top_radius_cm - 0.2, box.pot_top_radius_cm + 1.2)
    direct[floor] *= open_sky[floor]
    near_pot = np.exp(
        -np.maximum(np.hypot(s.place_cm[..., 0], s.place_cm[..., 2]) - box.pot_bottom_radius_cm, 0.0) / 4.0
    )
    bounce = lighting.FLASH_BOUNCE * level
    bounce[floor] *= (1.0 - 0.55 * near_pot)[floor]
    side = s.kind == POT
    bounce[side] *= (0.75 + 0.25 * s.normal[..., 2])[side]
    total: Float32 = s.albedo * (direct + bounce)[..., None] * lighting.FLASH_BGR
    return total


def _lamp_light(s: Surfaces, box: Box, which: int) -> Float32:
    level, towards = lighting.lamp_at(s.place_cm, which, box)
    direct = level * _facing(s, towards)
    direct[s.kind == LAMP] = 0.0
    low = (s.kind == FLOOR) | (s.kind == SOIL)
    direct[low] *= _pot_shadow(s.place_cm, box.lamps_cm[which], box)[low]
    total: Float32 = s.albedo * (direct + lighting.LAMP_BOUNCE * lighting.LAMP_LEVEL)[..., None]
    return total


def _pot_shadow(place_cm: Float32, lamp_cm: npt.NDArray[np.float64], box: Box) -> Float32:
    """1 where the lamp is seen, 0 where the pot stands between; soft because the lamp is wide."""
    step = lamp_cm - place_cm
    end = np.clip((box.rim_above_soil_cm - place_cm[..., 1]) / step[..., 1], 0.0, 1.0)
    along = -(place_cm[..., 0] * step[..., 0] + place_cm[..., 2] * step[..., 2])
    t = np.clip(along / (step[..., 0] ** 2 + step[..., 2] ** 2), 0.0, end)
    distance = np.hypot(place_cm[..., 0] + t * step[..., 0], place_cm[..., 2] + t * step[..., 2])
    seen = np.where(end > 0.02, _smooth(distance, box.pot_top_radius_cm - 1.0, box.pot_top_radius_cm + 0.8), 1.0)
    return np.asarray(seen, dtype=np.float32)


def _shadow_map(s: Surfaces, box: Box) -> tuple[tuple[slice, slice], Float32]:
    ground = (s.kind == FLOOR) | (s.kind == SOIL) | (s.kind == POT)
    ground &= np.abs(s.place_cm[..., 0]) < 24.0
    rows, columns = np.nonzero(ground.any(axis=1))[0], np.nonzero(ground.any(axis=0))[0]
    window = (slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1))
    place = s.place_cm[window]
    shrink = box.flash_cm[1] / (box.flash_cm[1] - place[..., 1])
    out = np.stack([place[..., 0] * shrink, place[..., 2] * shrink], axis=-1)
    out[~ground[window]] = 1e4
    return window, np.ascontiguousarray(out, dtype=np.float32)


def _smooth(value: npt.NDArray[np.floating], low: float, high: float) -> Float32:
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t), dtype=np.float32)
