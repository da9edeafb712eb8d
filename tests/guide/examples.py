"""What the network learns from: plants as the finder sees them, with their stems."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from drawings.run import make_world
from flora_common.arrays import ByteArray
from flora_common.runs import CameraSection
from flora_common.vision.lamp_states import from_background
from flora_common.vision.path.evidence import Evidence, PlantFinder
from flora_common.vision.path.settings import PathSettings
from guide.canvas import PX_PER_CM, Floats
from truth_run import TruthFrame, twin_run

HOURS = 72.0


@dataclass(frozen=True, slots=True, eq=False)
class Example:
    """A plant at 20 px per cm.

    Attributes:
        plant: shape (height, width), evidence up to 127.
        code: shape (height, width, 3), logarithmic code.
        line: shape (n, 2), the true stem, anchor first, apex last, (x, y) px.
    """

    plant: ByteArray
    code: ByteArray
    line: Floats


def photographed(finder: PlantFinder, camera: CameraSection, frame: TruthFrame) -> Example | None:
    """A photograph with a known stem as the finder sees it; None where it sees nothing."""
    picture = cv2.imdecode(np.frombuffer(frame.jpeg, np.uint8), cv2.IMREAD_COLOR)
    seen = finder.find(np.asarray(picture, dtype=np.uint8))
    line_px = frame.centreline_cm * [camera.px_per_cm, -camera.px_per_cm] + np.array(camera.anchor_px)
    return as_seen(seen, line_px, camera.px_per_cm)


def as_seen(seen: Evidence, line_px: Floats, px_per_cm: float) -> Example | None:
    """What was found of a plant, with its stem's line, shape (n, 2), px of the picture; None where that is nothing."""
    if seen.empty:
        return None
    height, width = seen.plant.shape
    size = [max(8, round(v * PX_PER_CM / px_per_cm)) for v in (width, height)]
    how = cv2.INTER_AREA if size[0] < width else cv2.INTER_LINEAR
    plant = cv2.resize(np.minimum(seen.plant, 127.0), size, interpolation=how).astype(np.uint8)
    code = cv2.resize(seen.code, size, interpolation=how)
    line = (line_px - seen.origin_px + 0.5) * [size[0] / width, size[1] / height] - 0.5
    return Example(plant, np.asarray(code, dtype=np.uint8), line.astype(np.float32))


def drawing_examples(seed: int, count: int = 8) -> list[Example]:
    """A drawn individual at times drawn from its life."""
    world = make_world(seed, hours=HOURS)
    finder = PlantFinder(from_background(_decoded(world.background())), world.section, PathSettings())
    times_s = np.random.default_rng(seed).uniform(0, HOURS * 3600.0, count)
    found = (photographed(finder, world.section, world.frame(float(time_s))) for time_s in times_s)
    return [example for example in found if example is not None]


def twin_examples(seed: int) -> list[Example]:
    """An individual of the virtual box every few hours."""
    rng = np.random.default_rng(seed)
    hours, every_s = rng.uniform(60, HOURS), rng.uniform(5, 8) * 3600.0
    run = twin_run(seed, hours=float(hours), every_s=float(every_s), schedule=f"{rng.integers(2, 13)}h")
    finder = PlantFinder(from_background(_decoded(run.background)), run.camera, PathSettings())
    found = (photographed(finder, run.camera, frame) for frame in run.frames())
    return [example for example in found if example is not None]


def _decoded(jpegs: Sequence[bytes]) -> Iterator[ByteArray]:
    for jpeg in jpegs:
        yield np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR), dtype=np.uint8)
