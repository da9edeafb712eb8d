"""Controllers in simulated plants: the typical one, and others that the simulator draws."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from flora_common.errors import BadInput
from flora_lab.evaluate.plan import Plan
from flora_lab.evaluate.trial import TYPICAL, Trial, simulated
from flora_lab.evolve.controllers import FromFile
from flora_lab.evolve.episode import run_episode
from flora_lab.evolve.individuals import Individuals
from flora_lab.simulator.interface import Simulator


def count(plan: Plan) -> int:
    """Episodes of a plan in one simulator."""
    return len(plan.controllers) * len(plan.task.scenarios) * (1 + plan.repeat)


def trials_in(place: str, simulator: Simulator[Any], plan: Plan, done: Callable[[], None]) -> list[Trial]:
    """Every controller in every scenario: on the typical plant, then on each that is drawn.

    Args:
        place: the simulator's name.
        simulator: of the plant.
        plan: what is asked.
        done: called after each episode.

    Raises:
        BadInput: the simulator gives a stem that is not finite, or knows no steps of five minutes.
    """
    drawn = Individuals(plan.repeat, plan.seed).seeds() or []
    plants: list[tuple[str, int | None]] = [(TYPICAL, None)]
    plants += [(f"drawn {k}", seed) for k, seed in enumerate(drawn, start=1)]
    trials = []
    for named in plan.controllers:
        controller = FromFile(named.loaded)
        for scenario in plan.task.scenarios:
            for plant, seed in plants:
                try:
                    course = run_episode(controller, simulator, plan.task, scenario, seed)
                except BadInput as problem:
                    raise BadInput(f"{place}: {problem}") from problem
                trials.append(simulated(place, named.name, plant, seed, course, plan.task))
                done()
    return trials
