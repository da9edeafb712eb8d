"""A run in numbers: the paper's fitness, collisions, coverage, all from the files of the run folder."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from flora_common.errors import BadRunFolder
from flora_common.geometry import FloatArray, clearance_cm, collides, fitness
from flora_common.runs import FrameRow, RunFile, RunFolder
from flora_common.tracks import Track, read_track

STOP_HEIGHT_CM = 21.0
"""The paper's stop rule: the run is over when the tip is this high."""


@dataclass(frozen=True, slots=True)
class RunSummary:
    """What a run came to. Fitness and collision are None where run.toml states no target or obstacle.

    Attributes:
        frames: photographs of the run.
        readings: those in which a stem was found.
        hours: from the first photograph to the last.
        fitness_over_time: the paper's F of the tip, shape (readings,).
        stop_row: first reading at which a stop rule holds, or the last one.
        stop_reason: that rule, or why there is none.
        fitness_at_stop: F at ``stop_row``.
        best_fitness: the largest F up to ``stop_row``.
        fitness_at_target: F when the tip first lay in the target's circle: what the paper reports of its real plants.
        reached_h: hour at which the tip first lay in the target's circle.
        collided_h: hour at which the stem first touched the obstacle.
        clearance_cm: smallest distance between stem and obstacle.
        switches: changes of the lamp.
    """

    run: RunFile
    frames: list[FrameRow]
    track: Track
    readings: int
    hours: float
    fitness_over_time: FloatArray | None
    stop_row: int
    stop_reason: str
    fitness_at_stop: float | None
    best_fitness: float | None
    fitness_at_target: float | None
    reached_h: float | None
    collided_h: float | None
    clearance_cm: float | None
    switches: int


def summarise(folder: RunFolder) -> RunSummary:
    """Read and judge a run folder.

    Raises:
        BadRunFolder: run.toml, frames.csv or track.csv is missing or unusable.
    """
    run = folder.read_run_file()
    frames = folder.read_frames()
    if not frames:
        raise BadRunFolder(f"{folder.frames_csv}: holds no frames")
    track = read_track(folder.track_csv)
    target, obstacle = run.target_or_none(), run.obstacle_or_none()
    hours = track.time_s / 3600
    tips = track.points_cm[:, -1]
    touches = np.array([obstacle is not None and collides(points, obstacle) for points in track.points_cm])
    stop_row, stop_reason = _stop(tips, touches)
    over_time = np.array([fitness(x, y, target) for x, y in tips]) if target else None
    inside = np.array([target.contains(x, y) for x, y in tips]) if target else np.zeros(len(tips), dtype=bool)
    return RunSummary(
        run=run,
        frames=frames,
        track=track,
        readings=len(hours),
        hours=(frames[-1].time_s - frames[0].time_s) / 3600,
        fitness_over_time=over_time,
        stop_row=stop_row,
        stop_reason=stop_reason,
        fitness_at_stop=float(over_time[stop_row]) if over_time is not None else None,
        best_fitness=float(over_time[: stop_row + 1].max()) if over_time is not None else None,
        fitness_at_target=float(over_time[int(inside.argmax())]) if over_time is not None and inside.any() else None,
        reached_h=float(hours[int(inside.argmax())]) if inside.any() else None,
        collided_h=float(hours[int(touches.argmax())]) if touches.any() else None,
        clearance_cm=min(clearance_cm(points, obstacle) for points in track.points_cm) if obstacle else None,
        switches=sum(a.light != b.light for a, b in itertools.pairwise(frames)),
    )


def _stop(tips: FloatArray, touches: np.ndarray) -> tuple[int, str]:
    high = tips[:, 1] >= STOP_HEIGHT_CM
    first_high = int(high.argmax()) if high.any() else len(tips)
    first_touch = int(touches.argmax()) if touches.any() else len(tips)
    if first_touch < first_high:
        return first_touch, "the stem touched the obstacle"
    if first_high < len(tips):
        return first_high, f"the tip was {STOP_HEIGHT_CM:g} cm high"
    return len(tips) - 1, "the run ended"
