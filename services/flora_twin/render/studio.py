"""The photograph: box, plant and shadows put together and exposed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from flora_common.geometry import FloatArray
from flora_twin.box import BOX, CAMERA, Box, PinholeCamera
from flora_twin.render import lighting
from flora_twin.render.backdrop import LENS_BLUR_PX, Backdrop
from flora_twin.render.foliage import Subject, plant_mesh
from flora_twin.render.mesh import Mesh
from flora_twin.render.sensor import Exposure, Sensor
from flora_twin.render.surfaces import Float32
from flora_twin.strips import OFF, LampLight

EXPOSURE_JITTER: Final = 0.008
FLASH_JITTER: Final = 0.015
_SUPERSAMPLE: Final = 3
_FULL_SCALE: Final = 2.5
"""Linear light that the plant's 8-bit canvas can hold; it is square-root coded."""
_SHADOW_CELLS_PER_CM: Final = 8.0
_SHADOW_REACH_CM: Final = 16.0
_SHADOW_DEPTH: Final = 0.82


@dataclass(frozen=True, slots=True)
class Lighting:
    """What shines while the shutter is open."""

    left: LampLight = OFF
    right: LampLight = OFF
    flash: bool = True


class Studio:
    """Takes photographs of one box. Building it costs about a second, a photograph some tens of milliseconds.

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
    ) -> npt.NDArray[np.uint8]:
        """One picture, shape (height, width, 3), blue, green, red.

        Args:
            lighting_now: lamps and flash.
            exposure: of the camera.
            subject: the plant; none gives the setup without a plant.
            tick: whole numbers that, with the studio's seed, fix all that is random in this picture.
        """
        rng = np.random.default_rng([self.seed, 41, *tick])
        brightness = 1.0 + EXPOSURE_JITTER * float(np.clip(rng.standard_normal(), -3, 3))
        flash = (1.0 + FLASH_JITTER * float(np.clip(rng.standard_normal(), -3, 3))) if lighting_now.flash else 0.0
        lamps = self.backdrop.lamps(lighting_now.left, lighting_now.right)
        scale = exposure.brightness * brightness
        light = np.asarray(cv2.addWeighted(self.backdrop.flash, flash * scale, lamps, scale, 0.0), dtype=np.float32)
        if subject is not None:
            mesh = plant_mesh(subject, self.camera.position_cm)
            shadow = _ShadowMap(mesh, self.box)
            if flash:
                self._shade_ground(light, shadow, flash * scale)
            self._paint(light, mesh, shadow, lighting_now, flash, scale)
        self.sensor.balance(light, exposure)
        return self.sensor.develop(light, exposure, rng)

    def photograph(
        self, lighting_now: Lighting, exposure: Exposure, subject: Subject | None, tick: tuple[int, ...]
    ) -> bytes:
        """The same as a JPEG file."""
        return self.sensor.encode(self.picture(lighting_now, exposure, subject, tick))

    def _shade_ground(self, light: Float32, shadow: _ShadowMap, level: float) -> None:
        """Take the flash away where the plant stands in its way to soil, pot and floor."""
        rows, columns = self.backdrop.window
        place = self.backdrop.shadow_map
        offset, scale = np.float32(_SHADOW_REACH_CM), np.float32(_SHADOW_CELLS_PER_CM)
        cells = (place + offset) * scale
        dark = cv2.remap(shadow.soft, cells[..., 0], cells[..., 1], cv2.INTER_LINEAR, borderValue=0.0)
        lost = self.backdrop.flash[rows, columns] * (dark * np.float32(level * _SHADOW_DEPTH))[..., None]
        light[rows, columns] -= lost

    def _paint(
        self, light: Float32, mesh: Mesh, shadow: _ShadowMap, lighting_now: Lighting, flash: float, scale: float
    ) -> None:
        """Draw the plant's faces over the picture, the farthest first."""
        colour = _shade(mesh, shadow, lighting_now, flash, self.box) * scale
        depth = self.camera.position_cm[2] - mesh.corners_cm[:, :, 2].mean(axis=1)
        order = np.argsort(-depth, kind="stable")
        pixels = self.camera.project(mesh.corners_cm)
        margin = 4.0
        low = np.floor(pixels.reshape(-1, 2).min(axis=0) - margin).astype(int)
        high = np.ceil(pixels.reshape(-1, 2).max(axis=0) + margin).astype(int) + 1
        x0, y0 = np.maximum(low, 0)
        x1, y1 = np.minimum(high, (self.camera.width_px, self.camera.height_px))
        if x1 - x0 < 2 or y1 - y0 < 2:
            return
        k = _SUPERSAMPLE
        canvas = np.zeros((int(y1 - y0) * k, int(x1 - x0) * k, 4), np.uint8)
        # A pixel's middle is at whole numbers; its k x k cells lie round it.
        corners = np.rint(((pixels - (x0, y0)) * k + (k - 1) / 2) * 16.0).astype(np.int32)
        coded = np.sqrt(np.clip(colour / _FULL_SCALE, 0.0, 1.0)) * 255.0
        for face in order:
            b, g, r = coded[face]
            cv2.fillConvexPoly(canvas, corners[face], (b, g, r, 255.0), cv2.LINE_8, 4)
        small = cv2.resize(canvas, (int(x1 - x0), int(y1 - y0)), interpolation=cv2.INTER_AREA)
        small = cv2.GaussianBlur(small.astype(np.float32), (0, 0), LENS_BLUR_PX)
        alpha = small[..., 3:] * np.float32(1.0 / 255.0)
        linear = (small[..., :3] / np.maximum(small[..., 3:], 1.0)) ** 2 * np.float32(_FULL_SCALE)
        linear *= self.backdrop.vignette[y0:y1, x0:x1, None]
        view = light[y0:y1, x0:x1]
        view += alpha * (linear - view)


class _ShadowMap:
    """What the flash sees of the plant: heights on a grid, by rays onto the plane y = 0."""

    def __init__(self, mesh: Mesh, box: Box) -> None:
        size = int(2 * _SHADOW_REACH_CM * _SHADOW_CELLS_PER_CM)
        self._flash_y = float(box.flash_cm[1])
        self.height = np.full((size, size), -100.0, np.float32)
        cells = np.rint(self._cells(mesh.corners_cm) * 16.0).astype(np.int32)
        top = mesh.corners_cm[..., 1].mean(axis=1)
        blades = np.nonzero(mesh.flat > 0)[0]
        for face in blades[np.argsort(top[blades], kind="stable")]:
            cv2.fillConvexPoly(self.height, cells[face], float(top[face]), cv2.LINE_8, 4)
        covered = (self.height > -50.0).astype(np.float32)
        self.soft = cv2.GaussianBlur(covered, (0, 0), 3.0)

    def _cells(self, places_cm: FloatArray) -> FloatArray:
        shrink = self._flash_y / (self._flash_y - places_cm[..., 1])
        return np.asarray(
            (places_cm[..., [0, 2]] * shrink[..., None] + _SHADOW_REACH_CM) * _SHADOW_CELLS_PER_CM, dtype=np.float64
        )

    def over(self, places_cm: FloatArray) -> FloatArray:
        """1 where something of the plant hangs over a place (n, 3), else 0."""
        size = self.height.shape[0]
        cell = np.clip(np.rint(self._cells(places_cm)).astype(int), 0, size - 1)
        return np.asarray(self.height[cell[:, 1], cell[:, 0]] > places_cm[:, 1] + 0.35, dtype=np.float64)


def _shade(mesh: Mesh, shadow: _ShadowMap, lighting_now: Lighting, flash: float, box: Box) -> FloatArray:
    """Light from each face to the camera, shape (n, 3), blue, green, red."""
    place = mesh.corners_cm.mean(axis=1)
    total = np.full((len(place), 3), lighting.LEAK)
    if flash:
        level, towards = lighting.flash_at(place, box)
        level = level * flash
        blocked = 1.0 - 0.70 * shadow.over(place)
        total += (level * (blocked * _received(mesh, towards) + lighting.FLASH_BOUNCE))[:, None] * lighting.FLASH_BGR
    for which, lamp in enumerate((lighting_now.left, lighting_now.right)):
        if lamp != OFF:
            level, towards = lighting.lamp_at(place, which, box)
            got = level * _received(mesh, towards) + lighting.LAMP_BOUNCE * lighting.LAMP_LEVEL
            total += got[:, None] * lighting.lamp_bgr(lamp)
    return np.asarray(total * mesh.albedo, dtype=np.float64)


def _received(mesh: Mesh, towards: Float32) -> FloatArray:
    """Share of a light that a face sends on: stems are bright past their edge, blades let some through."""
    facing = np.einsum("ij,ij->i", mesh.normal, towards)
    round_stem = np.maximum((facing + 0.55) / 1.55, 0.0)
    thin_blade = 0.12 + 0.88 * np.abs(facing)
    return np.asarray(np.where(mesh.flat > 0, thin_blade, round_stem), dtype=np.float64)
