"""Measured runs in equal steps: what simulators are fitted to and judged by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from flora_common.arrays import BoolArray, FloatArray, IntArray
from flora_common.errors import BadInput
from flora_common.geometry import polyline_length
from flora_common.runs import LEVELS, LampsSection
from flora_common.shapes import STEM_POINTS
from flora_common.tracks import Track
from flora_lab.run_tracks import RunTrack

STEP_S: Final = 300.0
NEAR_SHARE: Final = 0.35
"""How far from its place in the grid a row may lie, as a share of the step, to be taken for it."""
LEAST_CM: Final = 0.1
"""What is shorter is no stem to start from."""
_SLOWER: Final = 1.2
"""Rows that are told more seldom than every so many steps of five minutes make longer steps."""
_MINUTE_S: Final = 60.0
_LONGEST_STEP_S: Final = 1800.0


@dataclass(frozen=True, slots=True)
class UnseenLight:
    """Steps in a gap, of which no row tells what shone.

    Attributes:
        start, stop: the first of them, and the one after the last.
        before, after: levels of the lamps that the rows on both sides tell, shape (2,).
    """

    start: int
    stop: int
    before: FloatArray
    after: FloatArray

    @property
    def changes(self) -> bool:
        """Whether another lamp shone after the gap than before it."""
        return bool((self.before != self.after).any())


@dataclass(frozen=True, slots=True)
class MeasuredRun:
    """One run, every ``step_s`` from its first stem to its last.

    Attributes:
        name, plant: of the run; one plant may have several.
        sha256: of the track.
        points_cm: shape (n, 10, 2); NaN where no stem was measured, never in the first and last row.
        light: shape (n - 1, 2): levels of the left and right lamp from each row to the next.
        time_s: shape (n,), as in the track, equally spaced.
        step_s: from one row to the next.
        covariates: name to shape (n - 1,), from each row to the next.
        lamps: where they hang, or None.
        unseen: where ``light`` is not told by any row, in order of time.
    """

    name: str
    plant: str
    sha256: str
    points_cm: FloatArray
    light: FloatArray
    time_s: FloatArray
    step_s: float
    covariates: Mapping[str, FloatArray]
    lamps: LampsSection | None = None
    unseen: tuple[UnseenLight, ...] = ()

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def hours(self) -> float:
        return float(self.time_s[-1] - self.time_s[0]) / 3600.0

    @property
    def is_measured(self) -> BoolArray:
        """Which rows hold a stem, shape (n,)."""
        return np.isfinite(self.points_cm[:, -1, 0])

    def mirrored(self) -> MeasuredRun:
        """Left and right exchanged."""
        return replace(
            self,
            points_cm=self.points_cm * np.array([-1.0, 1.0]),
            light=self.light[:, ::-1].copy(),
            unseen=tuple(replace(gap, before=gap.before[::-1], after=gap.after[::-1]) for gap in self.unseen),
        )


def step_of(time_s: FloatArray) -> float:
    """The step in s that suits rows at these times, shape (n,): five minutes, or what lies between them where longer.

    Longer ones are whole minutes, half an hour at most.
    """
    between_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else STEP_S
    if between_s <= _SLOWER * STEP_S:
        return STEP_S
    return min(_LONGEST_STEP_S, _MINUTE_S * round(between_s / _MINUTE_S))


def in_steps(run: RunTrack, step_s: float = STEP_S) -> MeasuredRun:
    """A run's track on a grid of equal steps from its first row.

    ``light`` of a track's row shone before it. Over a gap the row after it tells what shone last; where that is
    another lamp than before the gap, it is taken to have changed in the middle. What the first row tells shone before
    the run, and is used nowhere. Rows that lie near no place of the grid are left out; of rows without a stem, or whose
    points are all in one place, the lamp alone is used.

    Raises:
        BadInput: fewer than two stems, points that no stem has, stems upside down, a first stem without length, or no
            two rows ``step_s`` apart.
    """
    run.check_points()
    run.check_upright()
    track = run.track
    if len(track.time_s) < 2:
        raise BadInput(f"{run.file}: holds one stem; at least two are needed")
    place = (track.time_s - track.time_s[0]) / step_s
    index = np.rint(place).astype(np.int64)
    is_stem = polyline_length(track.points_cm) >= LEAST_CM
    if not is_stem[0]:
        raise BadInput(f"{run.where(0)}: the first stem is shorter than {10 * LEAST_CM:g} mm; leave such rows out")
    off = np.abs(place - index)
    rows = np.nonzero((off <= NEAR_SHARE) & is_stem)[0]
    rows = rows[np.argsort(off[rows], kind="stable")]  # of several in one step the nearest
    at, first = np.unique(index[rows], return_index=True)
    rows = rows[first]
    if not (np.diff(at) == 1).any():
        between_s = float(np.median(np.diff(track.time_s)))
        raise BadInput(f"{run.file}: no two rows are {step_s:g} s apart, most {between_s:g} s; time_s is in seconds")
    count = int(at[-1]) + 1
    points = np.full((count, STEM_POINTS, 2), np.nan)
    points[at] = track.points_cm[rows]
    told, own = _lamps_told(track, step_s, dict(zip(at.tolist(), rows.tolist(), strict=True)))
    own[0] = own[1]  # what shone before the run says nothing of a gap after its first row
    next_row = np.searchsorted(told, np.arange(1, count))  # the row at or after each step's end
    light = own[next_row]
    gaps = np.flatnonzero(np.diff(told) > 1)
    unseen = tuple(UnseenLight(int(told[k]), int(told[k + 1]) - 1, own[k], own[k + 1]) for k in gaps)
    for gap in unseen:
        light[gap.start : (gap.start + gap.stop + 1) // 2] = gap.before
    covariates = {}
    for name, values in track.covariates.items():
        known = np.isfinite(values[rows])
        if known.any():
            covariates[name] = np.interp(np.arange(count - 1) + 0.5, at[known], values[rows][known])
    return MeasuredRun(
        run.name,
        run.plant,
        run.sha256,
        points,
        light,
        track.time_s[0] + np.arange(count) * step_s,
        step_s,
        covariates,
        run.lamps,
        unseen,
    )


def _lamps_told(track: Track, step_s: float, rows: Mapping[int, int]) -> tuple[IntArray, FloatArray]:
    """Of which places of the grid it is told what shone before them, from the first stem used to the last.

    Args:
        track: the run.
        step_s: from one place to the next.
        rows: place to the row of the track that is used there for its stem, in order.

    Returns:
        The places, shape (n,), and the lamps' levels, shape (n, 2).
    """
    course_s, lamps = track.lamp_course()
    place = (course_s - track.time_s[0]) / step_s
    index = np.rint(place).astype(np.int64)
    nearest: dict[int, int] = {}
    for k in np.argsort(np.abs(place - index), kind="stable").tolist():
        if abs(place[k] - index[k]) <= NEAR_SHARE:
            nearest.setdefault(int(index[k]), k)
    last = max(rows)
    levels = {at: LEVELS[lamps[k]] for at, k in nearest.items() if 0 <= at <= last}
    levels |= {at: LEVELS[track.light[row]] for at, row in rows.items()}  # its own row tells what a stem stands in
    told = sorted(levels)
    return np.array(told), np.array([levels[at] for at in told])


@dataclass(frozen=True, slots=True)
class Batch:
    """Several runs side by side, all as long as the longest.

    Attributes:
        points_cm: shape (n, batch, 10, 2); NaN where nothing was measured and after a run's end.
        light: shape (n - 1, batch, 2); after a run's end its last lamp stays on.
        rows: shape (batch,): length of each run.
        covariates: those that all runs have, name to shape (n - 1, batch).
        step_s: from one row to the next.
    """

    points_cm: FloatArray
    light: FloatArray
    rows: IntArray
    covariates: Mapping[str, FloatArray]
    step_s: float


def by_step(runs: Sequence[MeasuredRun]) -> list[IntArray]:
    """Places of the runs of each step, in the order in which steps first come."""
    steps_s = np.array([run.step_s for run in runs])
    return [np.flatnonzero(steps_s == step_s) for step_s in dict.fromkeys(steps_s.tolist())]


def side_by_side(runs: Sequence[MeasuredRun]) -> Batch:
    """Several runs as one batch.

    Raises:
        ValueError: runs of different steps, see :func:`by_step`.
    """
    if len(by_step(runs)) > 1:
        raise ValueError("runs of different steps do not go side by side")
    count = max(len(run) for run in runs)
    points = np.full((count, len(runs), STEM_POINTS, 2), np.nan)
    light = np.empty((count - 1, len(runs), 2))
    shared = set.intersection(*(set(run.covariates) for run in runs))
    covariates = {name: np.empty((count - 1, len(runs))) for name in sorted(shared)}
    for i, run in enumerate(runs):
        points[: len(run), i] = run.points_cm
        light[: len(run) - 1, i], light[len(run) - 1 :, i] = run.light, run.light[-1]
        for name, values in covariates.items():
            values[: len(run) - 1, i], values[len(run) - 1 :, i] = run.covariates[name], run.covariates[name][-1]
    return Batch(points, light, np.array([len(run) for run in runs]), covariates, runs[0].step_s)
