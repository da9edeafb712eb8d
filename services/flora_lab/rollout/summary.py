"""From the errors of several simulators on the same runs to medians over plants, paired differences, and intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np

from flora_common.arrays import FloatArray, IntArray
from flora_lab.rollout.free_running import NO_START, Errors, FreeRun, Judged, Plan
from flora_lab.rollout.intervals import Estimate, by_plant, median, ratio_of_medians
from flora_lab.rollout.time_scale import TimeScale
from flora_lab.simulator.measured import MeasuredRun

Start = Literal["one_step", "unseen", "watched", "often"]
Measure = Literal["tip_mm", "stem_mm", "growth"]
STARTS: Final[tuple[Start, ...]] = ("one_step", "unseen", "watched", "often")
MEASURES: Final[tuple[Measure, ...]] = ("tip_mm", "stem_mm", "growth")
COMPARED: Final[tuple[Measure, ...]] = ("tip_mm", "stem_mm")
"""Of these the less the better; growth can be too much or too little."""
END: Final = 0
"""The horizon "to the run's end", among those that are counts of steps."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One simulator on all runs.

    Attributes:
        name: as tables have it.
        judged: its errors.
    """

    name: str
    judged: Judged


@dataclass(frozen=True, slots=True)
class Place:
    """Which errors: from which start, after how many steps (or :data:`END`), and what of them."""

    start: Start
    horizon: int
    measure: Measure


@dataclass(frozen=True, slots=True)
class Difference:
    """The first simulator against another one.

    Attributes:
        other: the other's name.
        difference: median over plants of (first minus other), paired by start: below 0 the first is better.
        times_better: median of the other over median of the first: above 1 the first is better.
    """

    other: str
    difference: Estimate
    times_better: Estimate


@dataclass(frozen=True, slots=True)
class Summary:
    """All that is told of some simulators on some runs.

    Attributes:
        names: of the simulators, the judged one first.
        runs: what they are judged by.
        plan: from where they ran.
        seed: of the resampling.
        estimates: place and simulator to median over plants.
        differences: place to the first simulator against each other one.
        per_run: place (tip errors) and simulator to one number per run, shape (runs,).
        beyond: simulator to hours after which each run was beyond its data, from the first stem; NaN for never.
        time_scales: simulator to its best time scale, where it was searched.
        parting_mm: simulator to how far its members part by each run's end, shape (runs,); NaN where it has none.
    """

    names: tuple[str, ...]
    runs: tuple[MeasuredRun, ...]
    plan: Plan
    seed: int
    estimates: dict[tuple[Place, str], Estimate]
    differences: dict[Place, list[Difference]]
    per_run: dict[tuple[Place, str], FloatArray]
    beyond: dict[str, FloatArray]
    time_scales: dict[str, TimeScale]
    parting_mm: dict[str, FloatArray] = field(default_factory=dict)

    @property
    def step_s(self) -> float:
        """From one row to the next."""
        return self.runs[0].step_s

    @property
    def plants(self) -> int:
        """How many plants the runs are of."""
        return len({run.plant for run in self.runs})

    def horizons(self, start: Start) -> tuple[int, ...]:
        """Steps after which errors from a start are told."""
        return horizons(start, self.plan)


def horizons(start: Start, plan: Plan) -> tuple[int, ...]:
    """Steps after which errors from a start are told: one step first, the end last.

    ``often`` has no end: its starts but the first go as far as the longest horizon.
    """
    if start == "one_step":
        return (1,)
    middle = tuple(sorted({1, *plan.horizons}))
    return middle if start == "often" else (*middle, END)


def summarise(
    entries: Sequence[Entry],
    runs: Sequence[MeasuredRun],
    plan: Plan,
    seed: int,
    time_scales: dict[str, TimeScale],
) -> Summary:
    """Medians over plants and differences; the first entry is the one that is judged."""
    plants = [run.plant for run in runs]
    labels = [str(i) for i in range(len(runs))]
    estimates: dict[tuple[Place, str], Estimate] = {}
    differences: dict[Place, list[Difference]] = {}
    per_run: dict[tuple[Place, str], FloatArray] = {}
    for place in _places(plan):
        values: dict[str, FloatArray] = {}
        for entry in entries:
            errors, run = errors_at(entry.judged, place)
            own = [plants[i] for i in run]
            values[entry.name] = errors
            estimates[place, entry.name] = median(by_plant(errors, own), seed)
            if place.measure == "tip_mm":
                every = np.concatenate([np.full(len(runs), np.nan), errors])
                per_run[place, entry.name] = by_plant(every, [*labels, *(labels[i] for i in run)])
        if place.measure not in COMPARED:
            continue
        first = values[entries[0].name]
        differences[place] = [
            Difference(
                entry.name,
                median(by_plant(first - values[entry.name], own), seed),
                ratio_of_medians(by_plant(values[entry.name], own), by_plant(first, own), seed),
            )
            for entry in entries[1:]
        ]
    return Summary(
        tuple(entry.name for entry in entries),
        tuple(runs),
        plan,
        seed,
        estimates,
        differences,
        per_run,
        {entry.name: _beyond_h(entry.judged.unseen, runs[0].step_s) for entry in entries},
        time_scales,
    )


def errors_at(judged: Judged, place: Place) -> tuple[FloatArray, IntArray]:
    """All errors at a place and the run that each is from, both of shape (n,); NaN where nothing was measured."""
    if place.start == "one_step":
        return getattr(judged.one_step.errors, place.measure), judged.one_step.run
    if place.start == "often":
        free_runs: tuple[FreeRun, ...] = judged.often
    else:
        one = judged.unseen if place.start == "unseen" else judged.watched
        free_runs = () if one is None else (one,)
    count = len(judged.unseen.last)
    found = [_at_horizon(run.errors, run.last, place) for run in free_runs]
    values = np.concatenate(found) if found else np.full(count, np.nan)
    return values, np.tile(np.arange(count), max(len(found), 1))


def _at_horizon(errors: Errors, last: IntArray, place: Place) -> FloatArray:
    table: FloatArray = getattr(errors, place.measure)
    row = last if place.horizon == END else np.full(len(last), place.horizon)
    there = (last != NO_START) & (row < len(table))
    values = np.full(len(last), np.nan)
    values[there] = table[row[there], np.flatnonzero(there)]
    return values


def _places(plan: Plan) -> list[Place]:
    """All that are told."""
    return [
        Place(start, horizon, measure)
        for start in STARTS
        for horizon in horizons(start, plan)
        for measure in MEASURES
        if horizon != 1 or measure != "growth"  # what a stem gains in a step is lost in how it leans
    ]


def _beyond_h(run: FreeRun, step_s: float) -> FloatArray:
    """Hours after which each run was first beyond the data, NaN for never; shape (runs,)."""
    hours = np.argmax(run.beyond_data, axis=0) * step_s / 3600.0
    return np.where(run.beyond_data.any(axis=0), hours, np.nan)
