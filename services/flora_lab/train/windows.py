"""Pieces of measured runs as the sequence recipe learns from them: a stem, and lamps and stems after it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from flora_common.errors import BadInput
from flora_lab.simulator.measured import MeasuredRun, side_by_side
from flora_lab.simulator.shape import smooth_line

Array = npt.NDArray[Any]

SEGMENTS: Final = 24
FINER_AT_TIP: Final = 1.5
"""Power by which segments are shorter towards the tip, where stems bend and grow."""
PLACES: Final = 33
"""Places along a measured stem, at equal arcs, that simulated ones are compared with."""


@dataclass(frozen=True, slots=True)
class Tracks:
    """Runs and their mirror images, side by side; shorter ones end in NaN.

    Attributes:
        length, angle: of the segments of each measured stem, shape (runs, rows, SEGMENTS), cm and rad.
        line_cm: points of each measured stem at equal arcs, shape (runs, rows, PLACES, 2).
        light: levels from each row to the next, shape (runs, rows - 1, 2).
        plant: index of each run's plant, shape (runs,).
        rows: length of each run, shape (runs,).
        can_start: rows that a stem was measured in, shape (runs, rows), bool.
    """

    length: Array
    angle: Array
    line_cm: Array
    light: Array
    plant: Array
    rows: Array
    can_start: Array

    def __len__(self) -> int:
        return len(self.plant)

    @property
    def plants(self) -> int:
        return int(self.plant.max()) + 1

    @property
    def vectors(self) -> int:
        """Steps from one measured stem to the next, mirrored ones included."""
        return int((self.can_start[:, :-1] & self.can_start[:, 1:]).sum())


def tracks_of(runs: Sequence[MeasuredRun], *, mirror: bool) -> Tracks:
    """Prepare runs.

    Args:
        runs: of one step.
        mirror: add each with left and right exchanged: the recipe then cannot learn what sets the sides apart.

    Raises:
        BadInput: fewer than two rows in all.
    """
    batch = side_by_side(runs)
    points = batch.points_cm.transpose(1, 0, 2, 3)
    told = np.isfinite(points[:, :, -1, 0])
    if told.sum() < 2:
        raise BadInput("the runs hold fewer than two stems")
    count, rows = told.shape
    line = np.full((count, rows, PLACES, 2), np.nan, dtype=np.float32)
    length = np.full((count, rows, SEGMENTS), np.nan, dtype=np.float32)
    angle = np.full((count, rows, SEGMENTS), np.nan, dtype=np.float32)
    joints = 1.0 - (1.0 - np.arange(SEGMENTS + 1) / SEGMENTS) ** FINER_AT_TIP
    places = np.linspace(0.0, 1.0, PLACES)
    for run, row in np.argwhere(told):
        fine = smooth_line(points[run, row])
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(fine, axis=0).T))])
        for axis in range(2):
            line[run, row, :, axis] = np.interp(places * arc[-1], arc, fine[:, axis])
        chord = np.diff([np.interp(joints * arc[-1], arc, fine[:, axis]) for axis in range(2)], axis=1)
        length[run, row] = np.hypot(chord[0], chord[1])
        angle[run, row] = np.unwrap(np.arctan2(chord[0], chord[1]))
    names = sorted({run.plant for run in runs})
    plant = np.array([names.index(run.plant) for run in runs])
    light = batch.light.transpose(1, 0, 2).astype(np.float32)
    if mirror:
        length, told = np.concatenate([length, length]), np.concatenate([told, told])
        angle = np.concatenate([angle, -angle])
        line = np.concatenate([line, line * np.array([-1.0, 1.0], dtype=np.float32)])
        light, plant = np.concatenate([light, light[..., ::-1]]), np.concatenate([plant, plant])
    lengths = np.concatenate([batch.rows, batch.rows]) if mirror else batch.rows
    return Tracks(length, angle, line, light, plant, lengths, told)


def draw_windows(
    tracks: Tracks, steps: int, count: int, random: np.random.Generator, *, first_share: float
) -> tuple[Array, Array]:
    """Starts of windows, each at a measured stem with at least one later row within the run.

    Args:
        tracks: where from.
        steps: of a window; what goes beyond a run's end is not compared.
        count: how many.
        random: the source of chance.
        first_share: share of windows that start at a run's first row.

    Returns:
        Index of the run, and the row, each of shape (count,).
    """
    run = random.integers(0, len(tracks), count)
    row = np.empty(count, dtype=np.int64)
    at_first = random.random(count) < first_share
    where = random.random(count)
    for i in range(count):
        last = max(1, int(tracks.rows[run[i]]) - steps)
        able = np.nonzero(tracks.can_start[run[i], :last])[0]
        row[i] = able[0] if at_first[i] else able[int(where[i] * len(able))]
    return run, row
