"""Photographed runs whose true stems are known: what the stem finders are judged on."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from flora_common.geometry import FloatArray
from flora_common.runs import LEVELS, CameraSection, Light
from flora_twin.box import CAMERA
from flora_twin.grow import LightSchedule, parse_schedule
from flora_twin.strips import LampLight, strip_bytes
from flora_twin.world import World

EXPOSURE_US = 20_000.0


@dataclass(frozen=True, slots=True)
class TruthFrame:
    """One photograph of a plant.

    Attributes:
        time_s: since the start of the run.
        light: the lamp that shines in it.
        jpeg: the file.
        centreline_cm: the true stem as a perfect measurement in the picture would find it, shape (n, 2), anchor first,
            tip last, x right, y up.
    """

    time_s: float
    light: Light
    jpeg: bytes
    centreline_cm: FloatArray


@dataclass(frozen=True, slots=True)
class TruthRun:
    """A run: background pictures (JPEG, every lamp state), and frames, which are made as they are asked for."""

    name: str
    camera: CameraSection
    background: Sequence[bytes]
    frames: Callable[[], Iterator[TruthFrame]]


def twin_run(seed: int, *, hours: float = 72.0, every_s: float = 300.0, schedule: str = "6h") -> TruthRun:
    """A run of the virtual grow box, photographed without the services."""
    lights = parse_schedule(schedule)
    lamp = LampLight(0.35, 0.45, 1.0)
    strips = {
        name: strip_bytes(*(lamp if level else LampLight() for level in levels)) for name, levels in LEVELS.items()
    }
    empty = World(seed, planted=False)
    empty.advance_to(50.0)  # a time of their own: noise is drawn from it
    empty.set_flash(True)
    background = []
    for light in ("left", "right", "dark", "both"):
        empty.set_strips(strips[light])
        background += [empty.photograph(EXPOSURE_US)[0] for _ in range(2)]

    def frames() -> Iterator[TruthFrame]:
        yield from _photographed(World(seed), lights, strips, hours * 3600.0, every_s)

    return TruthRun(f"twin {seed}", CAMERA.camera_section(), background, frames)


def _photographed(
    world: World, lights: LightSchedule, strips: dict[Light, bytes], seconds: float, every_s: float
) -> Iterator[TruthFrame]:
    world.set_flash(True)
    for time_s in np.arange(0.0, seconds + 1.0, every_s):
        world.advance_to(float(time_s))
        light = lights(max(0.0, float(time_s) - 1.0))
        world.set_strips(strips[light])
        jpeg, _ = world.photograph(EXPOSURE_US)
        truth = world.truth()
        assert truth is not None
        yield TruthFrame(float(time_s), light, jpeg, truth.centreline_cm)
        world.set_strips(strips[lights(float(time_s))])
