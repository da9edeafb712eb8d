"""The box without a plant: one picture per light, in linear light, ready to be added up."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from flora_common.arrays import BoolArray, Float32Array, FloatArray
from flora_twin.box import Box, PinholeCamera
from flora_twin.render import lighting, optics
from flora_twin.render.sensor import COLOUR_MATRIX
from flora_twin.render.surfaces import FLOOR, HOLDER, LAMP, LINER, POT, SOIL, WALL, Surfaces, see_box
from flora_twin.strips import OFF, LampLight

_KEPT: Final = 4
_EMISSION: Final = 14.0
_SATURATED: Final = 6.0
_LINER_WRAP: Final = 0.30
_SHADING_RIM_CM: Final = 1.6
"""Mean height above the soil of what the pot and its cloth hold against the lamps."""


@dataclass(frozen=True, slots=True)
class Ground:
    """Pixels from which the plant can keep a light.

    Attributes:
        window: rows and columns.
        ray_cm: where the light's ray to the pixel passes the plane y = 0, x and z, shape (h, w, 2): what stands in
            that ray shadows the pixel. Far away where the plant casts no shadow.
        light: the light there is to lose, shape (h, w, 3).
    """

    window: tuple[slice, slice]
    ray_cm: Float32Array
    light: Float32Array

    @staticmethod
    def of(surfaces: Surfaces, part: BoolArray, light_cm: FloatArray, light: Float32Array) -> Ground:
        """The pixels of a part of the picture, and what a light at a place gives them."""
        rows, columns = np.nonzero(part.any(axis=1))[0], np.nonzero(part.any(axis=0))[0]
        window = (slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1))
        place = surfaces.place_cm[window]
        stretch = light_cm[1] / (light_cm[1] - place[..., 1])
        ray = light_cm[[0, 2]] + (place[..., [0, 2]] - light_cm[[0, 2]]) * stretch[..., None]
        ray[~part[window]] = 1e4
        return Ground(window, np.ascontiguousarray(ray, dtype=np.float32), np.ascontiguousarray(light[window]))


class Backdrop:
    """The static part of all photographs.

    Attributes:
        flash: shape (height, width, 3), the box under the flash alone.
        vignette: shape (height, width), fall of brightness towards the corners.
        lamp_share: light of the left and the right lamp relative to normal, shape (2,).
        flash_bgr: the flash's colour, shape (3,).
        front: edge of the pot that hides the stem's foot.
        ground: where the flash's light can be kept off the ground.
        soil: the same for the left and the right lamp, in sensor colours for white lamps.
    """

    def __init__(self, camera: PinholeCamera, box: Box, seed: int) -> None:
        self.camera = camera
        surfaces = see_box(camera, box, seed)
        self.front = surfaces.front
        self.lamp_share = surfaces.decor.lamp_share
        self.flash_bgr = surfaces.decor.flash_bgr
        self.vignette = optics.vignette(camera)
        flash = self._finish(_flash_light(surfaces, box))
        self.flash = np.asarray(cv2.transform(flash, COLOUR_MATRIX), dtype=np.float32)
        self._lamps = [self._finish(_lamp_light(surfaces, box, i), glare=surfaces.glow[i]) for i in range(2)]
        self.leak = self._finish(surfaces.albedo * np.float32(lighting.LEAK))
        low = np.isin(surfaces.kind, (FLOOR, SOIL, POT, LINER)) & (np.abs(surfaces.place_cm[..., 0]) < 24.0)
        self.ground = Ground.of(surfaces, low, box.flash_cm, self.flash)
        inside = np.isin(surfaces.kind, (SOIL, LINER)) & (surfaces.place_cm[..., 2] < 0.9 * box.pot_top_radius_cm)
        self.soil = [Ground.of(surfaces, inside, box.lamps_cm[i], self._lamps[i]) for i in range(2)]
        self._ready: OrderedDict[tuple[LampLight, LampLight], Float32Array] = OrderedDict()

    def lamps(self, left: LampLight, right: LampLight) -> Float32Array:
        """The box under its lamps alone, shape (height, width, 3); kept for the states used last. Do not change it."""
        key = (left, right)
        if key in self._ready:
            self._ready.move_to_end(key)
            return self._ready[key]
        total = self.leak.copy()
        for lamp, unit in zip(key, self._lamps, strict=True):
            if lamp != OFF:
                total += unit * lighting.lamp_bgr(lamp)
        total = np.asarray(cv2.transform(total, COLOUR_MATRIX), dtype=np.float32)
        np.minimum(total, _SATURATED, out=total)
        self._ready[key] = total
        if len(self._ready) > _KEPT:
            self._ready.popitem(last=False)
        return total

    def _finish(self, light: Float32Array, glare: Float32Array | None = None) -> Float32Array:
        """Glare of the lens round what is lit itself, blur and vignetting of the lens."""
        if glare is not None:
            light = light + (_EMISSION * glare)[..., None]
            small = cv2.resize(glare, None, fx=0.125, fy=0.125, interpolation=cv2.INTER_AREA)
            wide = 4.5 * cv2.GaussianBlur(small, (0, 0), 6.0) + 0.6 * cv2.GaussianBlur(small, (0, 0), 26.0)
            light += cv2.resize(wide, (light.shape[1], light.shape[0]), interpolation=cv2.INTER_LINEAR)[..., None]
        blurred = optics.whole_picture(np.asarray(light, np.float32), self.camera)
        return np.ascontiguousarray(blurred * self.vignette[..., None], dtype=np.float32)


def _facing(surfaces: Surfaces, towards: Float32Array) -> Float32Array:
    return np.asarray(np.maximum(np.einsum("...i,...i->...", surfaces.normal, towards), 0.0), dtype=np.float32)


def _past_edge(surfaces: Surfaces, towards: Float32Array, wrap: float) -> Float32Array:
    """The cosine of a surface that sees a wide light past its edge too."""
    cosine = np.einsum("...i,...i->...", surfaces.normal, towards)
    return np.asarray(np.maximum(cosine + wrap, 0.0) / (1.0 + wrap), dtype=np.float32)


def _flash_light(s: Surfaces, box: Box) -> Float32Array:
    level, towards = lighting.flash_at(s.place_cm, box)
    direct = level * _facing(s, towards)
    liner = s.kind == LINER
    direct[liner] = (level * _past_edge(s, towards, _LINER_WRAP))[liner]
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
    total: Float32Array = s.albedo * (direct + bounce)[..., None] * s.decor.flash_bgr.astype(np.float32)
    return total


def _lamp_light(s: Surfaces, box: Box, which: int) -> Float32Array:
    level, towards = lighting.lamp_at(s.place_cm, which, box)
    level *= np.float32(s.decor.lamp_share[which])
    direct = level * _facing(s, towards)
    direct[(s.kind == LAMP) | (s.kind == HOLDER)] = 0.0
    liner = s.kind == LINER
    direct[liner] = (level * _past_edge(s, towards, _LINER_WRAP))[liner]
    wall = s.kind == WALL
    direct[wall] = (level * _past_edge(s, towards, lighting.LAMP_WRAP))[wall]
    low = (s.kind == FLOOR) | (s.kind == SOIL)
    direct[low] *= _pot_shadow(s.place_cm[low], box.lamps_cm[which], box)
    total: Float32Array = (
        s.albedo * (direct + lighting.LAMP_BOUNCE * lighting.LAMP_LEVEL * s.decor.lamp_share[which])[..., None]
    )
    return total


def _pot_shadow(place_cm: Float32Array, lamp_cm: FloatArray, box: Box) -> Float32Array:
    """1 where the lamp is seen, 0 where the pot stands between; soft because the lamp is wide."""
    step = lamp_cm - place_cm
    end = np.clip((_SHADING_RIM_CM - place_cm[..., 1]) / step[..., 1], 0.0, 1.0)
    along = -(place_cm[..., 0] * step[..., 0] + place_cm[..., 2] * step[..., 2])
    t = np.clip(along / (step[..., 0] ** 2 + step[..., 2] ** 2), 0.0, end)
    distance = np.hypot(place_cm[..., 0] + t * step[..., 0], place_cm[..., 2] + t * step[..., 2])
    seen = np.where(end > 0.02, _smooth(distance, box.pot_top_radius_cm - 1.0, box.pot_top_radius_cm + 0.8), 1.0)
    return np.asarray(seen, dtype=np.float32)


def _smooth(value: npt.NDArray[np.floating], low: float, high: float) -> Float32Array:
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t), dtype=np.float32)
