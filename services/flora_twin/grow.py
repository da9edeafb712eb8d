"""Plants without pictures: light schedule in, measured track out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.errors import BadInput
from flora_common.geometry import resample_by_height
from flora_common.light_schedule import MOST_HOURS, LightSchedule, parse_schedule
from flora_common.runs import LEVELS, Light
from flora_common.shapes import STEM_POINTS
from flora_common.tracks import Track
from flora_twin.box import CAMERA
from flora_twin.parameters import PlantParameters
from flora_twin.plant import STEP_S, Plants

FRAME_S: Final = 300.0


def stem_points_cm(centreline_cm: FloatArray) -> FloatArray:
    """Ten points, shape (10, 2), of a centreline (n, 3) as the box's camera sees it, at the scale of the plant's plane.

    The part of a stem that leans away from the camera looks shorter, as it does in a photograph.
    """
    return resample_by_height(CAMERA.to_picture_plane_cm(CAMERA.project(centreline_cm)), STEM_POINTS)


def grow_many(
    seeds: Sequence[int],
    light_schedule: LightSchedule | str,
    hours: float,
    *,
    parameters: Sequence[PlantParameters] | None = None,
    every_s: float = FRAME_S,
) -> list[Track]:
    """Grow several plants under one schedule, without pictures and without measuring error.

    Args:
        seeds: one per plant.
        light_schedule: from time to light, or text for :func:`flora_common.light_schedule.parse_schedule`.
        hours: length of the run.
        parameters: constants per plant; drawn from the seeds where missing.
        every_s: seconds between rows of the track; a multiple of the step of 100 s.

    Returns:
        One track per plant with rows at 0, ``every_s``, ...; ``light`` shone over the interval before.

    Raises:
        BadInput: hours or ``every_s`` out of range, or a schedule that cannot be read.
    """
    if not 0.0 < hours <= MOST_HOURS:
        raise BadInput(f"hours is {hours:g}; it must lie in (0, {MOST_HOURS:g}]")
    per_row = round(every_s / STEP_S)
    if per_row < 1 or abs(per_row * STEP_S - every_s) > 1e-6:
        raise BadInput(f"every_s is {every_s:g}; it must be a multiple of {STEP_S:g} s")
    schedule = parse_schedule(light_schedule) if isinstance(light_schedule, str) else light_schedule
    plants = Plants(seeds, parameters)
    rows = int(hours * 3600.0 // every_s) + 1
    points = np.empty((plants.batch, rows, STEM_POINTS, 2))
    lights: list[Light] = []
    for row in range(rows):
        if row:
            for _ in range(per_row):
                plants.step(*LEVELS[schedule(plants.time_s)], STEP_S)
        lights.append(schedule(max(0.0, plants.time_s - STEP_S)))
        lines = plants.centreline_cm()
        used = plants.segments
        for i in range(plants.batch):
            points[i, row] = stem_points_cm(lines[i, : used[i] + 1])
    time_s = np.arange(rows, dtype=np.float64) * float(every_s)
    return [Track(time_s, tuple(lights), points[i], {}) for i in range(plants.batch)]


def grow(
    seed: int,
    light_schedule: LightSchedule | str,
    hours: float,
    *,
    parameters: PlantParameters | None = None,
    every_s: float = FRAME_S,
) -> Track:
    """Grow one plant; see :func:`grow_many`."""
    chosen = None if parameters is None else [parameters]
    return grow_many([seed], light_schedule, hours, parameters=chosen, every_s=every_s)[0]
