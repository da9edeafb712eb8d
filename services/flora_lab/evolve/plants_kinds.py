"""Which compiled plants belong to which simulator."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from flora_common.errors import BadInput
from flora_lab.evolve import (
    plants_corrected,
    plants_extended,
    plants_neural,
    plants_paper,
    plants_remembering,
    plants_tropism,
)
from flora_lab.evolve.plants import Plants
from flora_lab.evolve.task import Task
from flora_lab.simulator.interface import Simulator

_KINDS: Final[tuple[Callable[[Simulator[Any], Task, int | None, int], Plants | None], ...]] = (
    plants_tropism.plants_of,
    plants_extended.plants_of,
    plants_neural.plants_of,
    plants_paper.plants_of,
    plants_remembering.plants_of,
)


def plants_of(simulator: Simulator[Any], task: Task, seed: int | None, rows: int) -> Plants:
    """Plants at the start of a task, with room for so many.

    Args:
        simulator: of which plants.
        task: the stem that they start from, and for how long they are needed.
        seed: of the plant that is drawn, and of all that happens to it; the typical plant where None.
        rows: how many there may be at a time; only the first is there.

    Raises:
        BadInput: a simulator of a kind that has no compiled plants, or none but the typical one.
    """
    if seed is not None and not simulator.has_individuals:
        raise BadInput(f"a simulator of kind `{simulator.kind}` has no individuals; leave --individuals out")
    corrected = plants_corrected.plants_of(simulator, task, seed, rows, plants_of)
    if corrected is not None:
        return corrected
    for make in _KINDS:
        plants = make(simulator, task, seed, rows)
        if plants is not None:
            return plants
    raise BadInput(f"a simulator of kind `{simulator.kind}` has no compiled plants; choose another one")
