"""Plants modelled in three dimensions, photographed and found as on a rig."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from flora_common.arrays import ByteArray
from flora_common.runs import CameraSection
from flora_common.vision.lamp_states import from_background
from flora_common.vision.path.evidence import PlantFinder
from flora_common.vision.path.settings import PathSettings
from guide.canvas import Floats
from guide.examples import Example, as_seen
from guide.shoots import Shoot
from guide.surfaces import Light, Surfaces, View, texture

LEAST_HANGS_CM: Final = 0.1
"""A stem that hangs lower is looked for below its anchor, as a rig's owner would ask for."""


def modelled_example(seed: int, habit: type[Shoot] = Shoot) -> Example | None:
    """The plant of a seed and of a habit, as the finder sees it; None where it does not."""
    rng = np.random.default_rng([seed, 13])
    plant = habit(rng)
    axis = plant.grow()
    scale = float(np.exp(rng.uniform(np.log(9.0), np.log(30.0))))
    view = _view(rng, plant.surfaces, axis, scale)
    lights = _lights(rng)
    full, empty = plant.surfaces.photographed(texture(rng, view.size_px), view, lights, float(rng.uniform(0.15, 0.7)))
    gain = float(np.exp(rng.uniform(np.log(0.12), np.log(0.95))) / np.quantile(np.maximum(full, empty), 0.98))
    noise, blur = float(rng.uniform(0.002, 0.02)), float(rng.uniform(0.4, 1.1))
    camera = CameraSection(view.anchor_px, scale, *view.size_px)
    taken = [_taken(rng, one, gain, noise, blur) for one in (empty, empty, full)]
    hangs_cm = -float(axis[:, 1].min())
    settings = PathSettings(below_anchor_cm=hangs_cm + 0.5 if hangs_cm > LEAST_HANGS_CM else 0.0)
    finder = PlantFinder(from_background(taken[:2]), camera, settings)
    return as_seen(finder.find(taken[2]), view.to_px(axis), scale)


def _taken(rng: np.random.Generator, linear: Floats, gain: float, noise: float, blur: float) -> ByteArray:
    """What a camera makes of linear light: a decoded JPEG."""
    light = cv2.GaussianBlur(linear, (0, 0), blur) * np.float32(gain * (1.0 + rng.normal() * 0.02))
    light += rng.standard_normal(light.shape, dtype=np.float32) * np.float32(noise) * np.sqrt(np.maximum(light, 0.003))
    light = np.clip(light, 0.0, 1.0)
    code = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-6) ** (1 / 2.4) - 0.055)
    _, jpeg = cv2.imencode(
        ".jpg", (255.0 * code + 0.5).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(82, 97))]
    )
    return np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_COLOR), dtype=np.uint8)


def _view(rng: np.random.Generator, surfaces: Surfaces, axis: Floats, scale: float) -> View:
    away, board = float(rng.uniform(35, 120)), float(rng.uniform(3, 25))
    places = np.concatenate([surfaces.places(), axis])[:, :2]
    low, high = np.quantile(places, 0.02, axis=0), np.quantile(places, 0.98, axis=0)
    low, high = np.minimum(low, axis[:, :2].min(axis=0)) - 2.5, np.maximum(high, axis[:, :2].max(axis=0)) + 2.5
    low = np.clip(low, -14.0, -1.2)
    high = np.clip(high, 1.5, 30.0)
    return View(
        (int((high[0] - low[0]) * scale), int((high[1] - low[1]) * scale)),
        (float(-low[0] * scale), float(high[1] * scale)),
        scale,
        away,
        board,
    )


def _lights(rng: np.random.Generator) -> tuple[Light, ...]:
    """A flash near the camera, and in most pictures a coloured lamp at one side."""
    found = []
    side = rng.choice([-1, 1])
    flash = (rng.normal() * 0.25, rng.uniform(0, 0.5), 1.0, 0.05)
    lamp = (side * rng.uniform(0.5, 2.5), rng.uniform(0.2, 2.5), rng.uniform(0, 1.0), 0.6)
    for beside, above, strength, tint in (flash, lamp):
        towards = np.array([beside, above, 1.0])
        colour = np.exp(rng.normal(size=3) * tint) * strength
        found.append(Light(towards / np.linalg.norm(towards), colour, float(rng.uniform(1.0, 9.0))))
    return tuple(found)
