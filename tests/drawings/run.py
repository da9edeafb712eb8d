"""Drawn runs: a setup and a plant of its own for every seed, photographed for days."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drawings.camera import Camera
from drawings.growth import Growth, Posture, light_at, light_schedule
from drawings.plant import Plant
from drawings.scene import make_scene
from drawings.stem import ToPx
from flora_common.runs import LIGHTS, CameraSection, Light
from truth_run import FULL_PX, TruthFrame, TruthRun

BACKGROUND_EACH = 2


@dataclass(frozen=True, slots=True)
class World:
    """Everything about one seed."""

    seed: int
    hours: float
    section: CameraSection
    camera: Camera
    schedule: list[tuple[float, Light]]
    plant: Plant

    def background(self) -> list[bytes]:
        """Photographs of the empty setup, each lamp state."""
        rng = np.random.default_rng([self.seed, 1])
        states = [light for light in LIGHTS for _ in range(BACKGROUND_EACH)]
        return [self.camera.photograph(rng, light, None, None).jpeg for light in states]

    def frame(self, time_s: float) -> TruthFrame:
        """The photograph at a time; the same whenever it is asked for."""
        return self.photographed(self.plant.growth.at(time_s))

    def photographed(self, posture: Posture) -> TruthFrame:
        """A photograph of the plant in this posture."""
        rng = np.random.default_rng([self.seed, 2, round(posture.time_s * 1000)])
        light = light_at(self.schedule, posture.time_s)
        age = posture.time_s / max(self.hours * 3600.0, 1.0)
        shot = self.camera.photograph(rng, light, self.plant, posture, age)
        shake_cm = shot.shake_px * (1.0, -1.0) / self.section.px_per_cm
        return TruthFrame(posture.time_s, light, shot.jpeg, posture.line_cm + shake_cm)


def make_world(
    seed: int,
    *,
    hours: float = 72.0,
    size_px: tuple[int, int] = FULL_PX,
    board: str | None = None,
    shapes: tuple[str, ...] | None = None,
) -> World:
    """All that a seed decides; ``board`` and ``shapes`` (of leaves) may be asked for."""
    camera_rng, scene_rng, growth_rng, plant_rng, sensor_rng = (np.random.default_rng([seed, 0, k]) for k in range(5))
    width, height = size_px
    scale = min(width / FULL_PX[0], height / FULL_PX[1])
    px_per_cm = float(camera_rng.uniform(10, 30) * scale)
    anchor_px = float(width * camera_rng.uniform(0.38, 0.62)), float(height * camera_rng.uniform(0.74, 0.94))
    to_px = ToPx(anchor_px, px_per_cm)
    schedule = light_schedule(growth_rng, hours)
    growth = Growth(growth_rng, schedule, hours)
    camera = Camera(sensor_rng, make_scene(scene_rng, size_px, to_px, board=board))
    section = CameraSection(anchor_px=anchor_px, px_per_cm=px_per_cm, width_px=width, height_px=height)
    return World(seed, hours, section, camera, schedule, Plant(plant_rng, growth, shapes))


def drawn_run(
    seed: int, *, hours: float = 72.0, every_s: float = 300.0, size_px: tuple[int, int] = FULL_PX
) -> TruthRun:
    """A run of drawn photographs with known stems: another plant, board, camera and lamps for every seed.

    Args:
        seed: decides everything.
        hours: how long the plant is watched.
        every_s: between two photographs.
        size_px: width and height; ``px_per_cm`` (10 to 30 at full size) shrinks with them.

    Returns:
        The run. The true stem of a frame carries the camera's shake (at most 0.15 px) and so starts that close to
        the anchor: it is where a perfect measurement in the picture would find it.
    """
    world = make_world(seed, hours=hours, size_px=size_px)

    def frames() -> Iterator[TruthFrame]:
        for time_s in np.arange(0.0, hours * 3600.0 + 1.0, every_s):
            yield world.frame(float(time_s))

    return TruthRun(f"drawn {seed}", world.section, world.background(), frames)
