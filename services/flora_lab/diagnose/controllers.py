"""What a diagnosis is worth to controllers: evolved in the simulator as it is and as it is extended, run on one plant.

Nobody knows the plant better than the extended simulator does, so its plants stand for the plant with the causes.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import msgspec

from flora_lab.diagnose.controller_gain import Effort, Kind, bred, controller_gain
from flora_lab.diagnose.controllers_told import for_plans, judged_on
from flora_lab.diagnose.work import OnStage, Result
from flora_lab.evolve.task import Task

EFFORT: Final = Effort(seeds=5, generations=30, population=40, individuals=12, judges=24)
"""Fewer than five evolutions cannot be told from their scatter, and fewer than twenty plants not from luck with them;
plans that are tried on five plants fit those five."""
_STAGES: Final[dict[Kind, str]] = {"feedback": "evolving controllers", "plan": "evolving light plans"}
_ONLY_IF_TOLD: Final = "temperature_growth"
"""Plants follow it where somebody tells how warm it is; evolution is told nothing."""


def compared(
    result: Result, task: Task, stage: OnStage, note: Callable[[str], None], effort: Effort | None = None
) -> Result:
    """A diagnosis with ``gain.controller_fitness``, for both kinds of controllers.

    Args:
        result: a diagnosis.
        task: what controllers are to do.
        stage: begins a stage of so many steps.
        note: is told why nothing was compared: no cause acts on simulated plants.
        effort: how much is done; :data:`EFFORT` on all cores where None.
    """
    base, extended = result.start.simulator, result.extended
    if extended is None or all(extension.effect == _ONLY_IF_TOLD for extension in result.extensions):
        found = "but an answer to the temperature, which no task tells," if result.extensions else "that acts on plants"
        note(f"nothing {found} was found: both simulators are the same to controllers, and none were evolved")
        return result
    effort = effort or replace(EFFORT, threads=len(os.sched_getaffinity(0)))
    tasks = {"feedback": task, "plan": for_plans(task)}
    words = judged_on(task, effort.seeds, effort.judges, is_beside_another=result.start.judged is not None)
    fitness = {}
    for kind, name in _STAGES.items():
        step = stage(name, 2 * effort.seeds)
        in_base, in_extended = (bred(tasks[kind], one, kind, effort, step) for one in (base, extended))
        told = controller_gain(in_base, in_extended, extended)
        fitness[kind] = told | {"judged_on": words}
    gain = msgspec.structs.replace(result.diagnosis.gain, controller_fitness=fitness)
    return replace(result, diagnosis=msgspec.structs.replace(result.diagnosis, gain=gain))
