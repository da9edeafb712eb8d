"""One controller with one plant in one scenario, wherever that was, and what it came to: judged alike everywhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.experiment_file import ExperimentFile
from flora_common.runs import Light
from flora_common.tracks import read_track
from flora_lab.evolve.episode import Course, Reason
from flora_lab.evolve.task import Scenario, Task
from flora_lab.judging import judge
from flora_lab.simulator.measured import STEP_S

TWIN: Final = "twin"
"""The place that is the virtual rig; all other places are simulators, by name."""
TYPICAL: Final = "typical"
"""The plant of a simulator to which nothing happens by chance."""


@dataclass(frozen=True, slots=True)
class Trial:
    """A run from its start to its end.

    Attributes:
        place: a simulator's name, or :data:`TWIN`.
        controller: its name.
        scenario: that it was in.
        plant: which plant it was, in words.
        seed: of the plant; None for the typical one.
        ended: why.
        hours: when.
        fitness_at_target: when the tip first lay in the target's circle; None where it never did.
        fitness_at_end: of the tip at the end.
        best_fitness: on the way.
        reached_h: when the tip first lay in the target's circle.
        clearance_cm: the least distance of the stem, as the controller was told it, and the obstacle.
        true_clearance_cm: of the true stem; None where the controller was told the truth.
        time_s: shape (n,).
        light: the lamp that shone before each stem, n of them.
        stems_cm: shape (n, 10, 2).
        folder: where the run is kept; None for a simulated one.
    """

    place: str
    controller: str
    scenario: Scenario
    plant: str
    seed: int | None
    ended: Reason
    hours: float
    fitness_at_target: float | None
    fitness_at_end: float
    best_fitness: float
    reached_h: float | None
    clearance_cm: float
    true_clearance_cm: float | None
    time_s: FloatArray
    light: Sequence[Light]
    stems_cm: FloatArray
    folder: Path | None = None

    @property
    def fitness(self) -> float:
        """What the paper tells of its real plants: when the target was reached. Where it never was, at the end."""
        return self.fitness_at_end if self.fitness_at_target is None else self.fitness_at_target

    @property
    def is_typical(self) -> bool:
        return self.plant == TYPICAL

    def numbers(self) -> dict[str, Any]:
        """All figures, for scripts."""
        return {
            "place": self.place,
            "controller": self.controller,
            "scenario": self.scenario.name,
            "plant": self.plant,
            "seed": self.seed,
            "ended": self.ended,
            "hours": self.hours,
            "fitness": self.fitness,
            "fitness_at_target": self.fitness_at_target,
            "fitness_at_end": self.fitness_at_end,
            "best_fitness": self.best_fitness,
            "target_reached_h": self.reached_h,
            "clearance_cm": self.clearance_cm,
            "true_clearance_cm": self.true_clearance_cm,
            "tip_at_start_cm": self.stems_cm[0, -1].tolist(),
            "tip_at_end_cm": self.stems_cm[-1, -1].tolist(),
        }


def simulated(place: str, controller: str, plant: str, seed: int | None, course: Course, task: Task) -> Trial:
    """A trial from an episode."""
    scenario = course.scenario
    time_s = STEP_S * np.arange(len(course.stems_cm), dtype=np.float64)
    judged = judge(time_s, course.stems_cm, scenario.target, scenario.obstacle, stop_height_cm=task.stop_height_cm)
    assert judged.best_fitness is not None  # there are a target and an obstacle
    assert judged.clearance_cm is not None
    return Trial(
        place=place,
        controller=controller,
        scenario=scenario,
        plant=plant,
        seed=seed,
        ended=course.reason,
        hours=course.hours,
        fitness_at_target=judged.fitness_at_target,
        fitness_at_end=course.fitness,
        best_fitness=judged.best_fitness,
        reached_h=judged.reached_h,
        clearance_cm=judged.clearance_cm,
        true_clearance_cm=None,
        time_s=time_s,
        light=course.lamps,
        stems_cm=course.stems_cm,
    )


def measured(controller: str, scenario: Scenario, folder: Path, outcome: ExperimentFile) -> Trial:
    """A trial from what `flora-twin experiment` wrote.

    Args:
        controller: its name here.
        scenario: that it was in.
        folder: of the experiment.
        outcome: its ``outcome.json``.

    Raises:
        BadInput: the run's track cannot be read.
    """
    track = read_track(folder / outcome.run / "track.csv")
    said = outcome.measured
    return Trial(
        place=TWIN,
        controller=controller,
        scenario=scenario,
        plant=f"plant {outcome.seed}",
        seed=outcome.seed,
        ended=said.ended,
        hours=said.ended_h,
        fitness_at_target=said.fitness_at_target,
        fitness_at_end=said.fitness_at_end,
        best_fitness=said.best_fitness,
        reached_h=said.target_reached_h,
        clearance_cm=said.clearance_cm,
        true_clearance_cm=outcome.true.clearance_cm if outcome.true else None,
        time_s=track.time_s,
        light=track.light,
        stems_cm=track.points_cm,
        folder=folder,
    )
