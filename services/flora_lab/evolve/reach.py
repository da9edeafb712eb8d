"""How far the plants of an evolution can reach at all, for the rig to know when its own plant has gone elsewhere.

Any controller does something between lighting one lamp for ever and lighting the other, and evolution tries both, for
most of its first networks never change their minds. So the reach is that of the same plants, from the same start to the
same end, under the left lamp alone, under the right one alone, and under both in turn as in the paper's dataset
experiments. No obstacle is in their way: where one stands, a stem can be led past it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from flora_common.arrays import BoolArray, FloatArray
from flora_common.errors import BadInput
from flora_common.open_loop import PAPERS_TURNS, open_loop_side
from flora_common.runs import LEVELS
from flora_common.shapes import FARTHEST_CM
from flora_common.stem_range import StemRange, range_of
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.task import Task
from flora_lab.simulator.interface import Chance, Simulator
from flora_lab.simulator.measured import STEP_S

MOST_PLANTS: Final = 32
"""Of drawn plants, the first so many are simulated: more would widen the range by less than any margin."""


def reach(simulator: Simulator[Any], task: Task, individuals: Individuals) -> StemRange:
    """The range of stems that evolution can have met.

    Args:
        simulator: of the plant.
        task: start and end; its scenarios do not matter.
        individuals: the plants.
    """
    met = [task.start_stem_cm[None]]
    for _, stems, is_plant in _led(simulator, task, individuals):
        met.append(stems[is_plant])
    return range_of(np.concatenate(met))


def check_stems(simulator: Simulator[Any], task: Task) -> None:
    """Look at the typical plant under such lamps before much is evolved in it.

    Raises:
        BadInput: it has a stem that no plant has.
    """
    with np.errstate(all="ignore"):
        for hours, stems, is_plant in _led(simulator, task, Individuals()):
            if is_plant.all():
                continue
            stem = stems[int(np.argmin(is_plant))]
            what = f"reaches {np.abs(stem).max():.3g} cm" if np.isfinite(stem).all() else "is not finite"
            raise BadInput(
                f"the simulator gives a stem that {what}, task {task.name}, after {hours:.1f} h; train it again or "
                "take another one"
            )


def _led(
    simulator: Simulator[Any], task: Task, individuals: Individuals
) -> Iterator[tuple[float, FloatArray, BoolArray]]:
    """Plants under such lamps, until each has ended: hours, stems (n, 10, 2) that have not, and which are a plant's.

    A stem that is none ends, too.
    """
    seeds = individuals.seeds()
    plants = [None] if seeds is None else seeds[:MOST_PLANTS]
    chance = None if seeds is None else Chance(np.repeat(np.array(plants), 3))
    state = simulator.start(np.repeat(task.start_stem_cm[None], 3 * len(plants), axis=0), chance)
    running = np.ones(3 * len(plants), dtype=np.bool_)
    for k in range(task.most_steps):
        lights = [LEVELS["left"], LEVELS["right"], LEVELS[open_loop_side(k * STEP_S, PAPERS_TURNS)]]
        state, stems = simulator.step(state, np.tile(np.array(lights), (len(plants), 1)), STEP_S)
        # a stem that goes farther is no plant any more, and told of no more; written so that NaN fails it too
        is_plant = np.asarray((np.abs(stems) <= FARTHEST_CM).all(axis=(1, 2)), dtype=np.bool_)
        yield (k + 1) * STEP_S / 3600.0, stems[running], is_plant[running]
        running &= is_plant & (stems[:, -1, 1] < task.stop_height_cm)
        if not running.any():
            break
