"""The paper's simulator mended: its clock set right, and a memory fitted beside it.

The memory is a ridge regression of what the plant does beside the network's step, over an hour at a time: measured
stems have errors as large as what a plant moves in five minutes. Every run counts twice, once mirrored, so that no side
is preferred. How strongly it is shrunk is chosen by how far the simulator is off when it runs free in runs that the fit
has not seen (in the one that it has, where there is no other); where no memory makes that better, it stays without.
Beside it stands the same regression without the traces of light: what it gains over that is memory.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from flora_common.arrays import BoolArray, FloatArray
from flora_common.counted import counted
from flora_lab.diagnose.diagnosis import AROUND_H, END, HORIZONS_H, NamedCause
from flora_lab.rollout.free_running import free_run
from flora_lab.rollout.time_scale import best_time_scale
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.measured import MeasuredRun, by_step
from flora_lab.simulator.paper import COORDINATES, PaperSimulator
from flora_lab.simulator.remembering import FEATURES, RememberingSimulator, features, remembered, sides

RIDGES: Final = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Penalties beside a mean square of 1 of each feature."""
MEAN: Final = "mean"
BASE, CLOCK, NO_MEMORY, MEMORY, STILL = "base", "clock", "clock and rest", "clock and memory", "still"
"""As it is; its clock set right; beside that a linear rest without traces; with them; and a stem that stays."""
Maker = Callable[[Sequence[MeasuredRun]], Simulator[Any]]
"""Makes a simulator of what some runs tell."""
_WINDOW_H: Final = 1.0
_EVERY: Final = 3
_SEED: Final = 1
_TRACES: Final = slice(1 + COORDINATES, FEATURES)


@dataclass(frozen=True, slots=True)
class Mended:
    """What came of it.

    Attributes:
        simulator: with all that was found missing.
        errors_mm: time ("1h", ..., "end", "mean" of the whole run) to name of a simulator to the median over runs of
            its tip error, running free from the first stem.
        judged_on: on which runs, in words.
        ridge: the penalty of the memory.
        runs: that it was judged on.
        stems_cm: name of a simulator to its stems in each of ``runs``, shape (n, 10, 2).
    """

    simulator: RememberingSimulator
    errors_mm: dict[str, dict[str, float]]
    judged_on: str
    ridge: float
    runs: tuple[MeasuredRun, ...]
    stems_cm: dict[str, list[FloatArray]]

    def told(self) -> dict[str, Any]:
        """For ``diagnosis.json``."""
        return {"tip_error_mm": self.errors_mm, "judged_on": self.judged_on, "ridge": self.ridge}


def mended(
    learned: PaperSimulator,
    faults: Sequence[NamedCause],
    runs: Sequence[MeasuredRun],
    holdout: Sequence[MeasuredRun] = (),
) -> Mended | None:
    """The simulator without its faults; None where nothing was found, or where it has a state of its own.

    Args:
        learned: the simulator.
        faults: of :func:`flora_lab.diagnose.learned_simulator.faults_of`.
        runs: that tell what it lacks.
        holdout: to judge by; without them each run is judged by what the others tell, a single one by itself.
    """
    if not faults or learned.stateful:
        return None
    by_name = {fault.effect: fault for fault in faults}
    factor = by_name["time_scale"].parameters["factor"] if "time_scale" in by_name else 1.0
    clocked = RememberingSimulator(learned, factor, np.zeros((COORDINATES, FEATURES)))
    clocks: dict[tuple[int, ...], RememberingSimulator] = {tuple(id(run) for run in runs): clocked}

    def clock_of(rest: Sequence[MeasuredRun]) -> RememberingSimulator:
        """The clock as these runs tell it."""
        which = tuple(id(run) for run in rest)
        if which not in clocks:
            own = best_time_scale(learned, rest, _SEED).factor.value if "time_scale" in by_name else 1.0
            clocks[which] = RememberingSimulator(learned, own, clocked.memory)
        return clocks[which]

    makers: dict[str, Maker] = {BASE: lambda _: learned, CLOCK: clock_of}
    ridge, simulator = 0.0, clocked
    best = _best_ridge(clocked, runs) if "memory" in by_name else None
    if best is not None:
        ridge = best
        simulator = with_memory(clocked, runs, ridge)
        makers[NO_MEMORY] = lambda rest: with_memory(clock_of(rest), rest, ridge, without_traces=True)
        makers[MEMORY] = lambda rest: with_memory(clock_of(rest), rest, ridge)
    judged = tuple(holdout or runs)
    stems = {name: _simulated(make, runs, holdout) for name, make in makers.items()}
    stems[STILL] = still_stems(judged)
    if holdout:
        judged_on = f"{counted(len(holdout), 'run')} held out"
    elif len(runs) > 1:
        judged_on = f"each of {len(runs)} runs, by what the others tell"
    else:
        judged_on = "the very run that it was mended by, which makes the figures too good"
    return Mended(simulator, error_table_mm(stems, judged), judged_on, ridge, judged, stems)


def with_memory(
    clocked: RememberingSimulator, runs: Sequence[MeasuredRun], ridge: float, *, without_traces: bool = False
) -> RememberingSimulator:
    """A simulator at the right clock with a memory fitted to runs, or with the linear rest alone."""
    hours = [_hours(clocked, either) for run in runs for either in (run, run.mirrored())]
    x, y = (np.concatenate([one[i] for one in hours]) for i in range(2))
    if without_traces:
        x[:, _TRACES] = 0.0
    size = np.sqrt((x**2).mean(axis=0))
    size[size == 0.0] = 1.0
    scaled = x / size
    penalty = np.full(FEATURES, ridge * len(x))
    penalty[0] = 0.0  # a plant's mean growth is no exaggeration
    found = np.linalg.solve(scaled.T @ scaled + np.diag(np.maximum(penalty, 1e-9)), scaled.T @ y)
    return RememberingSimulator(clocked.learned, clocked.factor, np.ascontiguousarray((found / size[:, None]).T))


def _hours(clocked: RememberingSimulator, run: MeasuredRun) -> tuple[FloatArray, FloatArray]:
    """Features and what the plant does beside the network's steps, cm per such step, both means over an hour."""
    stems = run.points_cm[:, 1:].reshape(len(run), COORDINATES)
    steps = clocked.learned.steps_in(run.step_s)
    traces = np.zeros((len(run) - 1, (FEATURES - 1 - COORDINATES) // 2))
    now = traces[:1]
    for row, side in enumerate(sides(run.light)):
        for _ in range(steps):
            now = remembered(now, np.array([side]), clocked.step_s)
            traces[row] += now[0] / steps
    whole: BoolArray = np.asarray(np.isfinite(stems[:-1] + stems[1:]).all(axis=1))
    x = np.full((len(run) - 1, FEATURES), np.nan)
    y = np.full((len(run) - 1, COORDINATES), np.nan)
    x[whole] = features(stems[:-1][whole], traces[whole])
    before, moved = stems[:-1][whole], np.zeros((int(whole.sum()), COORDINATES))
    for _ in range(steps):
        moved += clocked.learned_step_cm(before + moved, run.light[whole])
    y[whole] = (stems[1:][whole] - before - moved) / steps
    rows = round(_WINDOW_H * 3600.0 / run.step_s)
    starts = [at for at in range(0, len(x) - rows + 1, _EVERY) if whole[at : at + rows].all()]
    hours = [
        np.array([values[at : at + rows].mean(axis=0) for at in starts]).reshape(len(starts), values.shape[1])
        for values in (x, y)
    ]
    return hours[0], hours[1]


def _best_ridge(clocked: RememberingSimulator, runs: Sequence[MeasuredRun]) -> float | None:
    """The penalty with which runs are followed best, see :func:`_simulated`; None where all are worse than none."""

    def off_mm(make: Maker) -> float:
        off = _errors_mm(_simulated(make, runs, ()), runs)[MEAN]
        return off if np.isfinite(off) else np.inf

    def off_with(ridge: float) -> float:
        with np.errstate(over="ignore", invalid="ignore"):  # what feeds back too strongly runs away
            return off_mm(lambda rest: with_memory(clocked, rest, ridge))

    best = min(RIDGES, key=off_with)
    return best if off_with(best) < off_mm(lambda _: clocked) else None


def _simulated(make: Maker, runs: Sequence[MeasuredRun], holdout: Sequence[MeasuredRun]) -> list[FloatArray]:
    """Stems of each run from its first one on, shape (n, 10, 2), by what other runs tell, or itself where none do."""
    if holdout:
        return free_stems(make(runs), holdout)
    simulated: list[FloatArray] = []
    for i, run in enumerate(runs):
        others = [other for j, other in enumerate(runs) if j != i] or [run]
        simulated += free_stems(make(others), [run])
    return simulated


def free_stems(simulator: Simulator[Any], runs: Sequence[MeasuredRun]) -> list[FloatArray]:
    """Stems of a simulator that runs free from the first stem of each run, shape (n, 10, 2)."""
    stems: list[FloatArray] = [np.empty(0)] * len(runs)
    for places in by_step(runs):
        own = [runs[i] for i in places]
        simulated_cm = free_run(simulator, own, np.zeros(len(own), dtype=np.int64), watched=False).simulated_cm
        for column, i in enumerate(places):
            stems[i] = simulated_cm[: len(runs[i]), column]
    return stems


def still_stems(runs: Sequence[MeasuredRun]) -> list[FloatArray]:
    """The first stem of each run, which stays, shape (n, 10, 2)."""
    return [np.repeat(run.points_cm[:1], len(run), axis=0) for run in runs]


def error_table_mm(
    stems: Mapping[str, Sequence[FloatArray]], runs: Sequence[MeasuredRun]
) -> dict[str, dict[str, float]]:
    """Time ("1h", ..., "end", "mean") to name of a simulator to the median over runs of its tip error.

    Args:
        stems: by name of a simulator, of each run, shape (n, 10, 2).
        runs: measured.
    """
    errors = {name: _errors_mm(own, runs) for name, own in stems.items()}
    times = [*(f"{hours:g}h" for hours in HORIZONS_H), END, MEAN]
    table = {when: {name: own[when] for name, own in errors.items() if when in own} for when in times}
    return {when: row for when, row in table.items() if row}


def _errors_mm(simulated: Sequence[FloatArray], runs: Sequence[MeasuredRun]) -> dict[str, float]:
    """Median over runs of the tip error about each time, mm."""
    at: dict[str, list[float]] = {}
    for stems, run in zip(simulated, runs, strict=True):
        off_mm = 10.0 * np.linalg.norm(stems[:, -1] - run.points_cm[:, -1], axis=-1)
        hours = np.arange(len(run)) * run.step_s / 3600.0
        for name, when in (*((f"{h:g}h", h) for h in HORIZONS_H), (END, run.hours)):
            about = (np.abs(hours - when) <= AROUND_H + 1e-9) & np.isfinite(off_mm)
            if when <= run.hours and about.any():
                at.setdefault(name, []).append(float(off_mm[about].mean()))
        at.setdefault(MEAN, []).append(float(np.nanmean(off_mm[1:])))
    return {name: round(float(np.median(values)), 2) for name, values in at.items()}
