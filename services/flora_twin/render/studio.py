"""The photograph: box, plant and shadows put together and exposed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from flora_common.arrays import ByteArray, Float32Array, FloatArray
from flora_twin.box import BOX, CAMERA, Box, PinholeCamera
from flora_twin.render.backdrop import Backdrop, Ground
from flora_twin.render.foliage import Subject, plant, stem_mesh
from flora_twin.render.lighting import lamp_bgr
from flora_twin.render.painter import paint
from flora_twin.render.sensor import COLOUR_MATRIX, Exposure, Sensor
from flora_twin.render.shading import Lit, shade
from flora_twin.render.shadows import ground_cells, on_ground
from flora_twin.strips import OFF, LampLight

EXPOSURE_JITTER: Final = 0.005
FLASH_JITTER: Final = 0.010
"""Relative standard deviation from picture to picture, of most pictures."""
_ODD_ONES: Final = 0.15
_ODD_FACTOR: Final = 4.0
"""Share of the pictures that differ more, and how much: bulbs flicker rarely, but then they do."""
KNOCKED_SHARE: Final = 0.01
"""Of the picture's width: so far a camera looks beside where it did once it was knocked."""
_SHADOW_DEPTH: Final = 0.85
_SHADOW_SOFT_CM: Final = 0.45


@dataclass(frozen=True, slots=True)
class Lighting:
    """What shines while the shutter is open."""

    left: LampLight = OFF
    right: LampLight = OFF
    flash: bool = True


class Studio:
    """Takes photographs of one box. Building it costs about two seconds, a photograph some tens of milliseconds.

    Args:
        seed: textures of the box and the pool of noise; the same seed gives the same box.
        camera: where it stands and what it sees.
        box: where everything is.
    """

    def __init__(self, seed: int, camera: PinholeCamera = CAMERA, box: Box = BOX) -> None:
        self.camera, self.box, self.seed = camera, box, seed
        self.backdrop = Backdrop(camera, box, seed)
        self.sensor = Sensor(camera.width_px, camera.height_px, seed)

    def picture(
        self,
        lighting_now: Lighting,
        exposure: Exposure,
        subject: Subject | None,
        tick: tuple[int, ...],
        *,
        knocked: bool = False,
    ) -> ByteArray:
        """One picture, shape (height, width, 3), blue, green, red.

        Args:
            lighting_now: lamps and flash.
            exposure: of the camera.
            subject: the plant; none gives the setup without a plant.
            tick: whole numbers that, with the studio's seed, fix all that is random in this picture.
            knocked: whether the camera looks beside where it did.
        """
        rng = np.random.default_rng([self.seed, 41, *tick])
        brightness = _jitter(rng, EXPOSURE_JITTER)
        flash = _jitter(rng, FLASH_JITTER) if lighting_now.flash else 0.0
        lamps = self.backdrop.lamps(lighting_now.left, lighting_now.right)
        scale = exposure.brightness * brightness
        light = np.asarray(cv2.addWeighted(self.backdrop.flash, flash * scale, lamps, scale, 0.0), dtype=np.float32)
        if subject is not None:
            self._add_plant(light, subject, lighting_now, flash, scale)
        if knocked:
            light = _knocked(light)
        self.sensor.balance(light, exposure)
        return self.sensor.develop(light, exposure, rng)

    def visible(self, subject: Subject) -> FloatArray:
        """Share of the stem that is in view at each point of its centreline, shape (n,), 0 to 1.

        Blades, petioles and the pot's cloth hide the rest. The folded leaflets of the bud count as stem: the eye takes
        them for its end.
        """
        eye = self.camera.position_cm
        bare, foliage = stem_mesh(subject, eye), plant(subject, eye)
        whole = foliage.mesh
        stem = (np.arange(len(whole.owner)) < len(bare.owner)) | (whole.owner >= foliage.bud_owner)
        white = np.ones((len(bare.owner), 3))
        alone = paint(bare, white, self.camera, None)
        among = paint(whole, np.repeat(stem[:, None], 3, axis=1).astype(np.float64), self.camera, self.backdrop.front)
        out = np.zeros(len(subject.centreline_cm))
        if alone is None or among is None:
            return out
        seen = [np.zeros((self.camera.height_px, self.camera.width_px), np.float32) for _ in range(2)]
        for picture, patch in zip(seen, (alone, among), strict=True):
            picture[patch.window] = np.minimum(patch.light[..., 1], 1.0) * patch.cover[..., 1]
        x, y = np.rint(self.camera.project(subject.centreline_cm)).astype(int).T
        inside = (x >= 0) & (y >= 0) & (x < self.camera.width_px) & (y < self.camera.height_px)
        own, left = (picture[y[inside], x[inside]] for picture in seen)
        out[inside] = np.where(own > 0.05, np.clip(left / np.maximum(own, 0.05), 0.0, 1.0), 0.0)
        return out

    def _add_plant(
        self, light: Float32Array, subject: Subject, lighting_now: Lighting, flash: float, scale: float
    ) -> None:
        foliage = plant(subject, self.camera.position_cm)
        radius = subject.parameters.base_radius_cm
        lamps = [
            lamp_bgr(lamp) * share * scale if lamp != OFF else None
            for lamp, share in zip((lighting_now.left, lighting_now.right), self.backdrop.lamp_share, strict=True)
        ]
        lit = Lit(self.backdrop.flash_bgr * flash * scale if flash else None, (lamps[0], lamps[1]))
        if flash:
            dark = on_ground(foliage, radius, self.box.flash_cm, _SHADOW_SOFT_CM)
            ground = self.backdrop.ground
            light[ground.window] -= _lost(ground, dark, np.float32(flash * scale * _SHADOW_DEPTH))
        for which, lamp in enumerate((lighting_now.left, lighting_now.right)):
            if lamp != OFF:
                dark = on_ground(foliage, radius, self.box.lamps_cm[which], _SHADOW_SOFT_CM)
                soil = self.backdrop.soil[which]
                lost = _lost(soil, dark, lamp_bgr(lamp) * np.float32(scale * _SHADOW_DEPTH))
                light[soil.window] -= cv2.transform(lost, COLOUR_MATRIX)
        colour = shade(foliage, lit, subject.parameters.leaf_gloss, self.camera.position_cm, self.box) @ COLOUR_MATRIX.T
        patch = paint(foliage.mesh, colour, self.camera, self.backdrop.front)
        if patch is not None:
            view = light[patch.window]
            view += patch.cover * (patch.light * self.backdrop.vignette[patch.window][..., None] - view)


def _knocked(light: Float32Array) -> Float32Array:
    """What falls on the sensor of a camera that was turned a little: all of it elsewhere, the rim drawn out."""
    width = light.shape[1]
    by = KNOCKED_SHARE * width * np.array([0.8, -0.6])
    matrix = np.array([[1.0, 0.0, by[0]], [0.0, 1.0, by[1]]])
    moved = cv2.warpAffine(light, matrix, (width, light.shape[0]), borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, dtype=np.float32)


def _jitter(rng: np.random.Generator, size: float) -> float:
    factor = _ODD_FACTOR if rng.random() < _ODD_ONES else 1.0
    return 1.0 + size * factor * float(np.clip(rng.standard_normal(), -2.5, 2.5))


def _lost(ground: Ground, dark: Float32Array, level: np.float32 | Float32Array) -> Float32Array:
    """Light that is missing where the plant stands in its way, shape (h, w, 3)."""
    cells = ground_cells(ground.ray_cm)
    share = cv2.remap(dark, cells[..., 0], cells[..., 1], cv2.INTER_LINEAR, borderValue=0.0)
    return np.asarray(ground.light * (share[..., None] * level), dtype=np.float32)
