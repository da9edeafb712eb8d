"""Photographs of virtual plants without the services: for data sets, and for judging who finds the stems.

The camera looks as a rig's does: a photograph every five minutes, flash on, under the lamp that shone since the one
before; and the setup without a plant under every lamp state beforehand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from flora_common.arrays import FloatArray
from flora_common.runs import FRAMES_HEADER, LEVELS, LIGHTS, Light, RunFolder, run_file_text, track_text
from flora_twin.box import CAMERA, PinholeCamera
from flora_twin.grow import FRAME_S
from flora_twin.runs import PlannedRun, Steering
from flora_twin.strips import LampLight, strip_bytes
from flora_twin.world import World

EXPOSURE_US: Final = 20_000.0
LAMP_COLOUR: Final = LampLight(0.35, 0.45, 1.0)
"""Bluish white, as in photographs of such rigs."""
STRIPS: Final = {
    name: strip_bytes(*(LAMP_COLOUR if level else LampLight() for level in levels)) for name, levels in LEVELS.items()
}
"""What the chain of both lamps is sent, by light."""
OF_EACH_LAMP_STATE: Final = 2
"""Background pictures: no two are alike, for lamps and flash flicker."""
TRUTH_CSV: Final = "truth.csv"
"""Where the stems truly are: no part of a run folder, which nobody reads as a run's track."""
_SETUP_S: Final = 50.0
"""When the background is photographed: a time that no photograph of the plant has, for noise is drawn from it."""


@dataclass(frozen=True, slots=True)
class Photograph:
    """One photograph of a plant.

    Attributes:
        time_s: since the start of the run.
        light: the lamp that shines in it, and shone since the one before.
        jpeg: the file.
        centreline_cm: the true stem as a perfect measurement in the picture would find it, shape (n, 2), anchor first,
            tip last, x right, y up.
        points_cm: ten points of it, shape (10, 2), the convention of ``track.csv``.
    """

    time_s: float
    light: Light
    jpeg: bytes
    centreline_cm: FloatArray
    points_cm: FloatArray


def background_pictures(seed: int, camera: PinholeCamera = CAMERA) -> dict[str, bytes]:
    """The setup without a plant, every lamp state: file name to JPEG."""
    empty = World(seed, planted=False, camera=camera)
    empty.advance_to(_SETUP_S)
    empty.set_flash(True)
    pictures = {}
    for light in LIGHTS:
        empty.set_strips(STRIPS[light])
        for number in range(1, OF_EACH_LAMP_STATE + 1):
            pictures[f"{light}-{number}.jpg"] = empty.photograph(EXPOSURE_US)[0]
    return pictures


def photographed(
    seed: int,
    steering: Steering,
    hours: float,
    *,
    first: Light = "dark",
    every_s: float = FRAME_S,
    camera: PinholeCamera = CAMERA,
) -> Iterator[Photograph]:
    """A plant's photographs, each made when it is asked for.

    Args:
        seed: the individual, and all chance.
        steering: tells the lamp from each photograph to the next, from where the tip truly is.
        hours: length of the run.
        first: the lamp in the first photograph.
        every_s: seconds between photographs.
        camera: that takes them.
    """
    world, light = World(seed, camera=camera), first
    world.set_flash(True)
    world.set_strips(STRIPS[light])
    for time_s in np.arange(0.0, hours * 3600.0 + 1.0, every_s):
        world.advance_to(float(time_s))
        jpeg, _ = world.photograph(EXPOSURE_US)
        truth = world.truth()
        assert truth is not None
        yield Photograph(float(time_s), light, jpeg, truth.centreline_cm, truth.points_cm)
        light = steering(float(time_s), float(truth.tip_cm[0]), light)
        world.set_strips(STRIPS[light])


def write_run(
    path: Path, run: PlannedRun, hours: float, on_photograph: Callable[[], None], camera: PinholeCamera = CAMERA
) -> None:
    """A run folder with photographs, and without a track: who wants one finds the stems; what is true is kept apart.

    Args:
        path: an empty folder.
        run: which plant, under which light.
        hours: length of the run.
        on_photograph: called after each.
        camera: that takes them.
    """
    folder = RunFolder(path)
    run_file = msgspec.structs.replace(run.run_file, camera=camera.camera_section())
    folder.run_toml.write_text(run_file_text(run_file), encoding="utf-8")
    folder.background.mkdir()
    folder.frames.mkdir()
    for name, jpeg in background_pictures(run.seed, camera).items():
        (folder.background / name).write_bytes(jpeg)
    lines, times_s, lights, stems = [FRAMES_HEADER], [], [], []
    for number, seen in enumerate(photographed(run.seed, run.steering, hours, camera=camera)):
        file = folder.frames / f"{number:06d}.jpg"
        file.write_bytes(seen.jpeg)
        lines.append(f"{file.relative_to(path)},{seen.time_s:.3f},{seen.light}")
        times_s.append(seen.time_s)
        lights.append(seen.light)
        stems.append(seen.points_cm)
        on_photograph()
    folder.frames_csv.write_text("\n".join(lines) + "\n", encoding="utf-8")
    (path / TRUTH_CSV).write_text(track_text(times_s, lights, stems), encoding="utf-8")


def photographs_in(hours: float) -> int:
    """How many photographs a run of so many hours has."""
    return int((hours * 3600.0 + 1.0) // FRAME_S) + 1
