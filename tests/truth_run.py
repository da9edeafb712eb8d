"""Photographed runs whose true stems are known: what the stem finders are judged on."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from flora_common.arrays import FloatArray
from flora_common.light_schedule import parse_schedule
from flora_common.runs import CameraSection, Light
from flora_twin.box import CAMERA, PinholeCamera
from flora_twin.photographs import background_pictures, photographed
from flora_twin.runs import open_loop

FULL_PX: Final = (CAMERA.width_px, CAMERA.height_px)


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


def twin_run(
    seed: int, *, hours: float = 72.0, every_s: float = 300.0, schedule: str = "6h", size_px: tuple[int, int] = FULL_PX
) -> TruthRun:
    """A run of the virtual grow box, photographed without the services."""
    lights = parse_schedule(schedule)
    camera = PinholeCamera(*size_px)

    def frames() -> Iterator[TruthFrame]:
        first = lights(0.0)
        for seen in photographed(seed, open_loop(schedule), hours, first=first, every_s=every_s, camera=camera):
            yield TruthFrame(seen.time_s, seen.light, seen.jpeg, seen.centreline_cm)

    return TruthRun(f"twin {seed}", camera.camera_section(), [*background_pictures(seed, camera).values()], frames)
