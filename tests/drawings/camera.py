"""The drawn camera: lens, shake, lamps that flicker and drift, noise, JPEG."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from drawings.growth import Posture
from drawings.plant import Plant, extent_cm
from drawings.scene import Scene, Source
from drawings.stem import Canvas, ToPx
from drawings.textures import Picture, Rng
from flora_common.arrays import FloatArray
from flora_common.runs import Light

SHAKE_PX = 0.15


@dataclass(frozen=True, slots=True)
class Shot:
    """A photograph, and by how much the camera was off its place when it was taken."""

    jpeg: bytes
    shake_px: FloatArray


class Camera:
    """Takes photographs of a scene; blurs the scene's own pictures once, in place."""

    def __init__(self, rng: Rng, scene: Scene) -> None:
        self.scene = scene
        self.blur_px = float(rng.uniform(0.5, 1.3))
        self.quality = int(rng.integers(75, 96))
        self.shake_px = float(rng.uniform(0.0, 0.08))
        self.flash_jitter = float(rng.uniform(0.0, 0.03))
        self.exposure_jitter = float(rng.uniform(0.0, 0.02))
        self.drift = rng.uniform(-0.04, 0.04, 3)
        self.read = float(rng.uniform(0.0008, 0.0035))
        shot = float(rng.uniform(0.8, 3.0))
        height, width = scene.front.shape
        for source in scene.sources.values():
            source.picture[:] = cv2.GaussianBlur(source.picture, None, self.blur_px)
        self._front = cv2.GaussianBlur(scene.front, None, self.blur_px)
        # Two tables of noise, each taken from another place per picture: as good as new. Neighbouring pixels
        # share a little, as after a sensor's colour filter.
        table = rng.standard_normal((2, height + 64, width + 64, 3), dtype=np.float32)
        self._noise = [cv2.GaussianBlur(t, None, 0.45) * 1.5 for t in table]
        self._noise[0] *= self.read
        self._noise[1] *= shot

    def photograph(
        self, rng: Rng, light: Light, plant: Plant | None, posture: Posture | None, age: float = 0.0
    ) -> Shot:
        """Take a photograph; ``age`` is the share of the run that is over, for what drifts."""
        shake = np.clip(rng.normal(0, max(self.shake_px, 1e-9), 2), -SHAKE_PX, SHAKE_PX)
        exposure = 1.0 + float(np.clip(rng.normal(0, 0.5), -1, 1)) * self.exposure_jitter
        gains = {
            name: exposure * (1.0 + self.drift[k] * age + (flicker if name == "flash" else 0.0))
            for k, name in enumerate(("flash", "left", "right"))
            for flicker in (float(np.clip(rng.normal(0, 0.5), -1, 1)) * self.flash_jitter,)
        }
        names = self.scene.shining(light)
        canvas = None
        if plant is not None and posture is not None:
            to_px = ToPx(
                (self.scene.to_px.anchor_px[0] + shake[0], self.scene.to_px.anchor_px[1] + shake[1]),
                self.scene.to_px.px_per_cm,
            )
            canvas = self._draw(plant, posture, names, gains, to_px)
        first, *others = names
        linear = self.scene.sources[first].picture * np.float32(gains[first])
        if canvas is not None:
            self._cast(linear, self.scene.sources[first], canvas)
        for name in others:
            source = self.scene.sources[name]
            if canvas is None:
                linear = cv2.scaleAdd(source.picture, gains[name], linear)
            else:
                lamp = source.picture * np.float32(gains[name])
                self._cast(lamp, source, canvas)
                cv2.add(linear, lamp, linear)
        linear = _shifted(linear, shake)
        if canvas is not None:
            rows = slice(canvas.top, canvas.top + canvas.cover.shape[0])
            columns = slice(canvas.left, canvas.left + canvas.cover.shape[1])
            seen = 1.0 - self._front[rows, columns]
            linear[rows, columns] *= (1.0 - canvas.cover * seen)[..., None]
            linear[rows, columns] += canvas.colour * seen[..., None]
        return Shot(self._develop(linear, rng), shake)

    def _draw(self, plant: Plant, posture: Posture, names: list[str], gains: dict[str, float], to_px: ToPx) -> Canvas:
        height, width = self.scene.front.shape
        corners = to_px(extent_cm(posture, plant.placed(posture)))
        low, high = corners.min(axis=0) - 12, corners.max(axis=0) + 13
        left, top = max(0, int(low[0])), max(0, int(low[1]))
        canvas = Canvas.empty(left, top, min(width, int(high[0])), min(height, int(high[1])))
        lights = [self.scene.sources[n].lit.brighter(gains[n]) for n in names]
        plant.draw(canvas, posture, lights, to_px)
        canvas.colour = cv2.GaussianBlur(canvas.colour, None, self.blur_px)
        canvas.cover = cv2.GaussianBlur(canvas.cover, None, self.blur_px)
        return canvas

    def _cast(self, picture: Picture, source: Source, canvas: Canvas) -> None:
        """Darken the setup where the plant keeps this light off."""
        cm = self.scene.to_px.px_per_cm
        part = 4
        soft = max(0.6, source.shadow_soft_cm * cm / part)
        margin = math.ceil(3 * soft)
        small = cv2.resize(canvas.cover, None, fx=1 / part, fy=1 / part, interpolation=cv2.INTER_AREA)
        small = cv2.copyMakeBorder(small, margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=0.0)
        small = cv2.GaussianBlur(small, None, soft) * np.float32(source.shadow_depth)
        x = canvas.left + round(source.shadow_cm[0] * cm) - margin * part
        y = canvas.top - round(source.shadow_cm[1] * cm) - margin * part
        shade = cv2.resize(small, None, fx=part, fy=part, interpolation=cv2.INTER_LINEAR)
        height, width = picture.shape[:2]
        x_low, y_low = max(x, 0), max(y, 0)
        x_high, y_high = min(x + shade.shape[1], width), min(y + shade.shape[0], height)
        if x_low >= x_high or y_low >= y_high:
            return
        shade = shade[y_low - y : y_high - y, x_low - x : x_high - x]
        picture[y_low:y_high, x_low:x_high] *= (1.0 - shade)[..., None]

    def _develop(self, linear: Picture, rng: Rng) -> bytes:
        height, width = linear.shape[:2]
        rows, columns = rng.integers(0, 65, 2), rng.integers(0, 65, 2)
        views = [t[r : r + height, c : c + width] for t, r, c in zip(self._noise, rows, columns, strict=True)]
        cv2.add(linear, views[0], linear)
        cv2.max(linear, 0.0, linear)
        # A square root makes the noise of counted light the same at every brightness.
        cv2.sqrt(linear, linear)
        picture = cv2.convertScaleAbs(cv2.max(cv2.scaleAdd(linear, 255.0, views[1]), 0.0))
        return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, self.quality])[1])


def _shifted(picture: Picture, by_px: FloatArray) -> Picture:
    """The picture moved by less than a pixel to the right and down."""
    kernels = [np.array([max(-d, 0.0), 1.0 - abs(d), max(d, 0.0)], np.float32)[::-1] for d in by_px]
    return cv2.sepFilter2D(picture, cv2.CV_32F, kernels[0], kernels[1], borderType=cv2.BORDER_REPLICATE)
