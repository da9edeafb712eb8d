"""A run in numbers: the paper's fitness, collisions, coverage, all from the files of the run folder."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

from flora_common.arrays import FloatArray
from flora_common.errors import BadRunFolder
from flora_common.experiment_file import Ended
from flora_common.paper_experiment import STOP_HEIGHT_CM
from flora_common.runs import FrameRow, RunFile, RunFolder
from flora_common.tracks import Track, read_track
from flora_lab.asides import aside
from flora_lab.judging import judge, reason


@dataclass(frozen=True, slots=True)
class RunSummary:
    """What a run came to. Fitness and collision are None where run.toml states no target or obstacle.

    Attributes:
        run: ``run.toml``.
        frames: photographs of the run.
        track: ``track.csv``.
        readings: those in which a stem was found.
        hours: from the first photograph to the last.
        stop_row, ended, fitness_over_time, fitness_at_stop, best_fitness, fitness_at_target, reached_h, collided_h,
            clearance_cm: see :class:`flora_lab.judging.Judged`.
        stop_reason: why the run was over, in words.
        switches: changes of the lamp.
    """

    run: RunFile
    frames: list[FrameRow]
    track: Track
    readings: int
    hours: float
    fitness_over_time: FloatArray | None
    stop_row: int
    ended: Ended
    stop_reason: str
    fitness_at_stop: float | None
    best_fitness: float | None
    fitness_at_target: float | None
    reached_h: float | None
    collided_h: float | None
    clearance_cm: float | None
    switches: int


def summarise(folder: RunFolder, *, stop_height_cm: float = STOP_HEIGHT_CM, longest_h: float = math.inf) -> RunSummary:
    """Read and judge a run folder.

    Args:
        folder: of the run.
        stop_height_cm: height of the tip at which the run was over.
        longest_h: time at which it was over at the latest.

    Raises:
        BadRunFolder: run.toml, frames.csv or track.csv is missing or unusable.
    """
    run = folder.read_run_file(unknown=aside)
    frames = folder.read_frames()
    if not frames:
        raise BadRunFolder(f"{folder.frames_csv}: holds no frames")
    track = read_track(folder.track_csv)
    judged = judge(
        track.time_s,
        track.points_cm,
        run.target_or_none(),
        run.obstacle_or_none(),
        stop_height_cm=stop_height_cm,
        hours=longest_h,
    )
    return RunSummary(
        run=run,
        frames=frames,
        track=track,
        readings=len(track.time_s),
        hours=(frames[-1].time_s - frames[0].time_s) / 3600,
        fitness_over_time=judged.fitness_over_time,
        stop_row=judged.stop_row,
        ended=judged.ended,
        stop_reason=reason(judged.ended, stop_height_cm),
        fitness_at_stop=judged.fitness_at_stop,
        best_fitness=judged.best_fitness,
        fitness_at_target=judged.fitness_at_target,
        reached_h=judged.reached_h,
        collided_h=judged.collided_h,
        clearance_cm=judged.clearance_cm,
        switches=sum(a.light != b.light for a, b in itertools.pairwise(frames)),
    )
