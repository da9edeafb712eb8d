"""Trials in sums: means over plants, averages over scenarios, and the reality gap.

The gap is a controller's fitness in a simulator minus its fitness on the virtual plants, in the same scenario, both
judged alike. A simulator tells two: on its typical plant, which is the one that controllers are evolved on, and in the
mean over plants that it draws.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from flora_lab.evaluate.plan import Plan
from flora_lab.evaluate.trial import TWIN, Trial
from flora_lab.evolve.task import Scenario

REAL_PLANTS: Final = (0.924, 0.920, 0.877)
"""The paper's three real plants, when their tips reached the target (section "Performance of controllers in reality").
"""

Measure = Literal["fitness", "fitness_at_end", "best_fitness"]
MEASURES: Final[dict[Measure, Callable[[Trial], float]]] = {
    "fitness": lambda trial: trial.fitness,
    "fitness_at_end": lambda trial: trial.fitness_at_end,
    "best_fitness": lambda trial: trial.best_fitness,
}
"""As the paper tells it of its real plants, as it judges controllers that it evolves, and how near the tip came."""


@dataclass(frozen=True, slots=True)
class Row:
    """One controller in one scenario at one place.

    Attributes:
        place, controller, scenario: which.
        typical: the trial on the simulator's typical plant; None on the virtual rig.
        plants: trials on plants that differ; none where only the typical one was asked for, or all runs failed.
    """

    place: str
    controller: str
    scenario: Scenario
    typical: Trial | None
    plants: tuple[Trial, ...]

    @property
    def trials(self) -> tuple[Trial, ...]:
        """All of them."""
        return (*([self.typical] if self.typical else []), *self.plants)

    def of_typical(self, measure: Measure) -> float | None:
        return MEASURES[measure](self.typical) if self.typical else None

    def mean(self, measure: Measure) -> float | None:
        """Over plants that differ."""
        return float(np.mean([MEASURES[measure](trial) for trial in self.plants])) if self.plants else None

    def worst(self, measure: Measure) -> float | None:
        return min(MEASURES[measure](trial) for trial in self.plants) if self.plants else None


@dataclass(frozen=True, slots=True)
class Average:
    """A controller over all scenarios at one place; None where there is nothing to average.

    Attributes:
        place, controller: which.
        possible_only: without the scenarios that no plant can do.
        typical, mean: by measure.
    """

    place: str
    controller: str
    possible_only: bool
    typical: dict[Measure, float | None]
    mean: dict[Measure, float | None]


@dataclass(frozen=True, slots=True)
class Gap:
    """A simulator minus the virtual plants, for one controller in one scenario.

    Attributes:
        simulator, controller, scenario: which.
        of_typical, of_drawn: by measure; None where there is no such plant.
    """

    simulator: str
    controller: str
    scenario: str
    of_typical: dict[Measure, float | None]
    of_drawn: dict[Measure, float | None]


def rows(plan: Plan, places: Sequence[str], trials: Sequence[Trial]) -> list[Row]:
    """Trials by place, controller and scenario, in the order in which they were asked for; none where all failed."""
    found = []
    for place in places:
        for controller in plan.controllers:
            for scenario in plan.task.scenarios:
                own = [t for t in trials if (t.place, t.controller) == (place, controller.name) and _in(t, scenario)]
                typical = next((trial for trial in own if trial.is_typical), None)
                if own:
                    plants = tuple(trial for trial in own if not trial.is_typical)
                    found.append(Row(place, controller.name, scenario, typical, plants))
    return found


def averages(plan: Plan, all_rows: Sequence[Row]) -> list[Average]:
    """Over scenarios: with all, and without the impossible ones where there are any. Nothing for one scenario alone,
    nor where the runs of a scenario failed."""
    found = []
    parts = [False, True] if 0 < plan.task.is_possible.sum() < len(plan.task.scenarios) else [False]
    for place, controller in dict.fromkeys((row.place, row.controller) for row in all_rows):
        own = [row for row in all_rows if (row.place, row.controller) == (place, controller)]
        if len(own) < len(plan.task.scenarios) or len(own) == 1:
            continue
        for possible_only in parts:
            counted = [row for row in own if row.scenario.is_possible or not possible_only]
            typical = {measure: _mean([row.of_typical(measure) for row in counted]) for measure in MEASURES}
            mean = {measure: _mean([row.mean(measure) for row in counted]) for measure in MEASURES}
            found.append(Average(place, controller, possible_only, typical, mean))
    return found


def gaps(all_rows: Sequence[Row]) -> list[Gap]:
    """Every simulator against the virtual plants, wherever there are both."""
    found = []
    for real in (row for row in all_rows if row.place == TWIN):
        for row in all_rows:
            if row.place != TWIN and (row.controller, row.scenario) == (real.controller, real.scenario):
                typical = {m: _minus(row.of_typical(m), real.mean(m)) for m in MEASURES}
                drawn = {m: _minus(row.mean(m), real.mean(m)) for m in MEASURES}
                found.append(Gap(row.place, row.controller, row.scenario.name, typical, drawn))
    return found


def _in(trial: Trial, scenario: Scenario) -> bool:
    return trial.scenario.name == scenario.name


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known and len(known) == len(values) else None


def _minus(one: float | None, other: float | None) -> float | None:
    return None if one is None or other is None else one - other
