"""Pieces of measured runs as the sequence recipe learns from them: a stem, and lamps and stems after it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_common.errors import BadInput
from flora_common.geometry import arc_length
from flora_lab.simulator.measured import MeasuredRun, side_by_side
from flora_lab.simulator.neural_law import STEP_H
from flora_lab.simulator.shape import smooth_line

SEGMENTS: Final = 24
FINER_AT_TIP: Final = 1.5
"""Power by which segments are shorter towards the tip, where stems bend and grow."""
PLACES: Final = 33
"""Places along a measured stem, at equal arcs, that simulated ones are compared with."""
TELL_EVERY: Final = 6
"""Steps from one comparison to the next."""
REFRESH: Final = 6
"""Steps between new weights of a window's segments at the nodes."""


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
        arc = arc_length(fine)
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


@dataclass(frozen=True, slots=True)
class Windows:
    """Windows to run.

    Attributes:
        length, angle: stems to start from, shape (windows, SEGMENTS), cm and rad, float32.
        light: levels, shape (steps, windows, 2), float32.
        line_cm: measured stems at equal arcs, shape (windows, tellings, PLACES, 2), float32.
        line_length_cm: their lengths, shape (windows, tellings), float32.
        known: which of them there are, shape (windows, tellings), bool.
        near_cm: errors of places count as squares up to it, shape (tellings,), float32.
        near_length_cm: the same for errors of the length.
        length_weight: of the loss of lengths beside that of places.
        every: steps from one telling to the next.
    """

    length: Array
    angle: Array
    light: Array
    line_cm: Array
    line_length_cm: Array
    known: Array
    near_cm: Array
    near_length_cm: Array
    length_weight: float
    every: int


@dataclass(frozen=True, slots=True)
class Scale:
    """How errors are weighed.

    Attributes:
        near_cm, per_h_cm: errors count as squares up to this size, which grows with the horizon, and as such beyond it:
            chance swings a plant about, and must not pull the law about.
        length_share: what is near for the length of a stem, as a share of that.
        length_weight: how much the length counts beside the places. Circumnutation hides growth from the tip, and
            hardly from the length.
    """

    near_cm: float = 0.05
    per_h_cm: float = 0.05
    length_share: float = 0.4
    length_weight: float = 1.0


def windows_at(tracks: Tracks, run: Array, row: Array, steps: int, scale: Scale) -> Windows:
    """Windows that start at given rows of given runs, each of shape (windows,).

    What lies beyond a run's end is not known, and not compared.
    """
    every = min(TELL_EVERY, steps)
    last = tracks.light.shape[1] - 1
    light = tracks.light[run[None], np.minimum(row[None] + np.arange(steps)[:, None], last)]
    ahead = every * (1 + np.arange(steps // every))
    told = row[:, None] + ahead
    at = run[:, None], np.minimum(told, last + 1)
    known = (told < tracks.rows[run][:, None]) & np.isfinite(tracks.line_cm[:, :, 0, 0])[at]
    near = (scale.near_cm + scale.per_h_cm * ahead * STEP_H).astype(np.float32)
    return Windows(
        tracks.length[run, row],
        tracks.angle[run, row],
        light,
        tracks.line_cm[at],
        tracks.length.sum(-1)[at],
        known,
        near,
        np.float32(scale.length_share) * near,
        scale.length_weight,
        every,
    )


class Starts:
    """Rows that windows can start at: those with a stem, and as much as possible of a window before the run's end.

    Args:
        tracks: where from.
        steps: of a window.
    """

    def __init__(self, tracks: Tracks, steps: int) -> None:
        last = np.maximum(1, tracks.rows - steps)
        able = [np.nonzero(tracks.can_start[run, : last[run]])[0] for run in range(len(tracks))]
        self._count = np.array([len(rows) for rows in able])
        self._first = np.concatenate([[0], np.cumsum(self._count)[:-1]])
        self._row = np.concatenate(able)

    def draw(self, count: int, random: np.random.Generator, *, first_share: float) -> tuple[Array, Array]:
        """Runs and rows, each of shape (count,); ``first_share`` of them start at a run's first row."""
        run = random.integers(0, len(self._count), count)
        at_first = random.random(count) < first_share
        where = random.random(count)
        place = np.where(at_first, 0, (where * self._count[run]).astype(np.int64))
        return run, self._row[self._first[run] + place]

    def spread(self, per_run: int) -> tuple[Array, Array]:
        """Runs and rows, so many of each run, spread evenly over it."""
        runs, rows = [], []
        for run, count in enumerate(self._count):
            chosen = np.unique(np.linspace(0, count - 1, per_run).round().astype(np.int64))
            runs.append(np.full(len(chosen), run))
            rows.append(self._row[self._first[run] + chosen])
        return np.concatenate(runs), np.concatenate(rows)
