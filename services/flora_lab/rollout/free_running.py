"""How far a simulated plant is from a measured one: one step ahead, and running free.

Running free, the simulator is given a start and the lamps, and never the stem again. The start is one stem, of a plant
of which nothing else is known, or a history that it may watch, in which it can see what individual this is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from flora_common.arrays import BoolArray, FloatArray, IntArray
from flora_common.geometry import polyline_length
from flora_lab.simulator.interface import History, Simulator
from flora_lab.simulator.measured import Batch, MeasuredRun, side_by_side

MM_PER_CM: Final = 10.0
LEAST_GAIN_CM: Final = 0.1
"""A measured stem that has gained less has not grown for certain: a photograph is good to about that."""
AT_ONCE: Final = 4096
"""Plants in one batch, to keep memory small; what comes out does not depend on it."""
NO_START: Final = -1


@dataclass(frozen=True, slots=True)
class Errors:
    """Simulated minus measured, NaN where nothing was measured; all arrays of one shape.

    Attributes:
        tip_mm: distance of the two tips.
        stem_mm: mean distance of points 2 to 10; point 1 is the anchor and always right.
        growth: length that the stem has gained since the start, simulated over measured, minus 1; NaN also where the
            measured stem has gained less than :data:`LEAST_GAIN_CM`.
    """

    tip_mm: FloatArray
    stem_mm: FloatArray
    growth: FloatArray


@dataclass(frozen=True, slots=True)
class FreeRun:
    """Several runs simulated from one start each, by the steps that have passed since.

    Attributes:
        start_rows: shape (runs,): where in the run, or :data:`NO_START`.
        simulated_cm: shape (steps + 1, runs, 10, 2); NaN where there was no start and after the run's end.
        measured_cm: the same of the measured plant; NaN also where no stem was measured.
        beyond_data: shape (steps + 1, runs): the simulator says that it was never shown any plant like this.
        errors: shape (steps + 1, runs).
        last: shape (runs,): steps from the start to the run's last row; :data:`NO_START` where there was no start.
    """

    start_rows: IntArray
    simulated_cm: FloatArray
    measured_cm: FloatArray
    beyond_data: BoolArray
    errors: Errors
    last: IntArray


@dataclass(frozen=True, slots=True)
class OneStep:
    """Every row with a stem after it, started from its own stem, one step ahead.

    Attributes:
        run: shape (n,): which run each is from.
        errors: shape (n,); growth is left out, a step's is too little.
    """

    run: IntArray
    errors: Errors


def errors_between(simulated_cm: FloatArray, measured_cm: FloatArray, start_cm: FloatArray) -> Errors:
    """Errors of stems of shape (..., 10, 2), all from starts that broadcast to that shape."""
    distance = np.hypot(*np.moveaxis(simulated_cm - measured_cm, -1, 0)) * MM_PER_CM
    before = polyline_length(start_cm)
    gained, wanted = polyline_length(simulated_cm) - before, polyline_length(measured_cm) - before
    grown = wanted >= LEAST_GAIN_CM  # False for NaN
    growth = np.full(wanted.shape, np.nan)
    growth[grown] = gained[grown] / wanted[grown] - 1.0
    return Errors(distance[..., -1], distance[..., 1:].mean(axis=-1), growth)


def start_rows(runs: Sequence[MeasuredRun], after_h: float) -> IntArray:
    """The first row of each run that holds a stem and lies ``after_h`` hours or more after its first.

    Returns:
        Shape (runs,); :data:`NO_START` where no stem was measured after that one.
    """
    rows = np.full(len(runs), NO_START, dtype=np.int64)
    for i, run in enumerate(runs):
        found = np.flatnonzero(run.is_measured[:-1])
        found = found[found * run.step_s >= after_h * 3600.0 - 1e-6]
        if len(found):
            rows[i] = found[0]
    return rows


def free_run(
    simulator: Simulator[Any],
    runs: Sequence[MeasuredRun],
    rows: IntArray,
    *,
    watched: bool,
    steps: int | None = None,
) -> FreeRun:
    """Simulate each run from its start.

    Args:
        simulator: whom; nothing happens by chance.
        runs: of one step.
        rows: shape (runs,): where each starts, see :func:`start_rows`.
        watched: whether the simulator sees the run up to its start, or only the stem there.
        steps: how many at most; to the run's end where None.
    """
    batch = side_by_side(runs)
    started = rows != NO_START
    last = np.where(started, batch.rows - 1 - rows, NO_START)
    count = max(0, int(last.max()))
    count = count if steps is None else min(count, steps)
    shape = (count + 1, len(runs))
    simulated = np.full((*shape, *batch.points_cm.shape[2:]), np.nan)
    measured = simulated.copy()
    beyond = np.zeros(shape, dtype=np.bool_)
    for row in np.unique(rows[started]):
        chosen = np.flatnonzero(rows == row)
        ahead = min(count, int(last[chosen].max()))
        measured[: ahead + 1, chosen] = batch.points_cm[row : row + ahead + 1, chosen]
        simulated[: ahead + 1, chosen], beyond[: ahead + 1, chosen] = _simulate(
            simulator, batch, chosen, int(row), ahead, watched=watched
        )
    over = np.arange(count + 1)[:, None] > last
    simulated[over], beyond[over] = np.nan, False
    errors = errors_between(simulated, measured, measured[0])
    return FreeRun(rows, simulated, measured, beyond, errors, last)


def _simulate(
    simulator: Simulator[Any], batch: Batch, chosen: IntArray, row: int, ahead: int, *, watched: bool
) -> tuple[FloatArray, BoolArray]:
    """Stems and whether they are beyond the data, from one row of some runs; shape (ahead + 1, chosen, ...)."""
    if watched:
        covariates = {name: values[:row, chosen] for name, values in batch.covariates.items()}
        past = History(batch.points_cm[: row + 1, chosen], batch.light[:row, chosen], batch.step_s, covariates)
        state = simulator.watch(past)
    else:
        lit_before = batch.light[row - 1, chosen] if row else None
        state = simulator.start(batch.points_cm[row, chosen], before=lit_before)
    stems, beyond = [simulator.stems_cm(state)], [simulator.is_beyond_data(state)]
    for k in range(row, row + ahead):
        now = {name: values[k, chosen] for name, values in batch.covariates.items()}
        state, points = simulator.step(state, batch.light[k, chosen], batch.step_s, now)
        stems.append(points)
        beyond.append(simulator.is_beyond_data(state))
    return np.stack(stems), np.stack(beyond)


def one_step(simulator: Simulator[Any], runs: Sequence[MeasuredRun]) -> OneStep:
    """Every row that holds a stem and has one after it, as a plant of its own of which the lamps before are known."""
    batch = side_by_side(runs)
    stem = np.isfinite(batch.points_cm[..., -1, 0])
    run, row = np.nonzero((stem[:-1] & stem[1:]).T)
    before, after = batch.points_cm[row, run], batch.points_cm[row + 1, run]
    light = batch.light[row, run]
    lit_before = np.where(row[:, None] > 0, batch.light[row - 1, run], 0.0)
    simulated = np.empty_like(before)
    for first in range(0, len(run), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        now = {name: values[row[part], run[part]] for name, values in batch.covariates.items()}
        state = simulator.start(before[part], before=lit_before[part])
        _, simulated[part] = simulator.step(state, light[part], batch.step_s, now)
    return OneStep(run, errors_between(simulated, after, before))


def parting_mm(simulator: Simulator[Any], runs: Sequence[MeasuredRun]) -> FloatArray:
    """How far a simulator's members are from one another at each run's end, from its first stem.

    Returns:
        Root mean square distance of their tips from the tips' mean, shape (runs,); NaN where there are no members.
    """
    first = np.zeros(len(runs), dtype=np.int64)
    tips = []
    for member in simulator.members():
        free = free_run(member, runs, first, watched=False)
        tips.append(free.simulated_cm[free.last, np.arange(len(runs)), -1])
    if not tips:
        return np.full(len(runs), np.nan)
    away = np.stack(tips) - np.mean(tips, axis=0)
    return np.asarray(MM_PER_CM * np.sqrt((away**2).sum(axis=-1).mean(axis=0)), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Plan:
    """From where simulators are to run free.

    Attributes:
        watch_h: hours watched before the longest run; later starts follow every ``every_h``.
        every_h: hours.
        horizons: steps after which errors are told.
    """

    watch_h: float
    every_h: float
    horizons: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Judged:
    """All errors of one simulator.

    Attributes:
        one_step: from each measured stem.
        unseen: from each run's first stem to its end.
        watched: from after ``watch_h`` to the end; None where every run is shorter.
        often: from ``watch_h`` and every ``every_h`` after it, as far as the longest horizon.
    """

    one_step: OneStep
    unseen: FreeRun
    watched: FreeRun | None
    often: tuple[FreeRun, ...]


def starts_of(runs: Sequence[MeasuredRun], plan: Plan) -> list[IntArray]:
    """Start rows after ``watch_h`` and every ``every_h``, as long as any run goes on for the shortest horizon.

    A gap that holds several starts gives one, after it.
    """
    starts: list[IntArray] = []
    lengths = np.array([len(run) for run in runs])
    for after_h in np.arange(plan.watch_h, max(run.hours for run in runs) + plan.every_h, plan.every_h):
        rows = start_rows(runs, float(after_h))
        used = lengths - 1 - rows >= min(plan.horizons)
        if starts:
            used &= rows > np.max(starts, axis=0)
        rows = np.where(used, rows, NO_START)
        if (rows != NO_START).any():
            starts.append(rows)
    return starts


def judge(
    simulator: Simulator[Any], runs: Sequence[MeasuredRun], plan: Plan, on_run: Callable[[], None] = lambda: None
) -> Judged:
    """One step ahead, and running free from every start of the plan.

    Args:
        simulator: whom.
        runs: of one step; in one batch.
        plan: from where.
        on_run: called after each free run.

    Raises:
        BadInput: a light or a step that the simulator does not know.
    """
    ahead = one_step(simulator, runs)
    unseen = free_run(simulator, runs, np.zeros(len(runs), dtype=np.int64), watched=False)
    on_run()
    watched: FreeRun | None = None
    often = []
    for rows in starts_of(runs, plan):
        first = watched is None
        run = free_run(simulator, runs, rows, watched=True, steps=None if first else max(plan.horizons))
        watched = run if first else watched
        often.append(run)
        on_run()
    return Judged(ahead, unseen, watched, tuple(often))
