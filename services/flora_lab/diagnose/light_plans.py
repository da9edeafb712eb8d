"""Light plans: lamps by the clock alone, decided before a run. Evolved, and run on simulated plants.

A plan cannot see. It is the purest use of a simulator: whatever this gets wrong, nothing corrects.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from flora_common.arrays import Array
from flora_common.shapes import STEM_POINTS
from flora_lab.evolve import scenario_batch
from flora_lab.evolve.episode import COLLISION, HEIGHT, TIME, scored
from flora_lab.evolve.plants import Plants
from flora_lab.evolve.plants_kinds import plants_of
from flora_lab.evolve.task import Task
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.measured import STEP_S
from flora_lab.simulator.rod import jit

TURNS: Final = 14
"""Of a plan; the last one lasts for ever."""
_FIRST: Final = TURNS
"""Gene that says which lamp begins: the left one below 0."""
_DWELL_H: Final = (0.5, 12.0)
_PARENTS: Final = 0.25
_ELITE: Final = 2
_CHANGED: Final = 0.35
_STEP: Final = 0.4
"""Share of the genes that a child has changed, and by how much: in the logarithm of hours."""


def evolved(judge: Callable[[Array], Array], generations: int, population: int, seed: int) -> Array:
    """The best plans of the last generation, best first, genes of shape (n, 15).

    Args:
        judge: genes (plans, 15) to fitness (plans,).
        generations, population: how many.
        seed: of all chance.
    """
    rng = np.random.default_rng(seed)
    low, high = np.log(_DWELL_H)
    genes = rng.uniform(low, high, (population, TURNS + 1))
    genes[:, _FIRST] = rng.standard_normal(population)
    fitness = judge(genes)
    for _ in range(generations - 1):
        order = np.argsort(-fitness, kind="stable")
        parents = genes[order[: max(2, round(_PARENTS * population))]]
        pairs = rng.integers(len(parents), size=(population - _ELITE, 2))
        mixed = rng.random((len(pairs), TURNS + 1)) < 0.5
        children = np.where(mixed, parents[pairs[:, 0]], parents[pairs[:, 1]])
        changed = rng.random(children.shape) < _CHANGED
        children = children + changed * _STEP * rng.standard_normal(children.shape)
        children[:, :_FIRST] = np.clip(children[:, :_FIRST], low, high)
        genes = np.concatenate([genes[order[:_ELITE]], children])
        fitness = judge(genes)
    return np.asarray(genes[np.argsort(-fitness, kind="stable")])


def lamps(genes: Array, steps: int) -> Array:
    """Which lamp shines in each step of five minutes, shape (steps, plans), bool: the right one where true."""
    ends = np.cumsum(np.exp(genes[:, :_FIRST]), axis=1)[:, :-1]
    at_h = (np.arange(steps) + 0.5) * STEP_S / 3600.0
    turn = (at_h[:, None, None] >= ends[None]).sum(axis=2)
    return np.asarray((turn + (genes[None, :, _FIRST] >= 0.0)) % 2 == 1)


def run_plans(
    simulator: Simulator[Any], task: Task, seeds: Sequence[int | None], is_right: Array
) -> tuple[Array, Array]:
    """Fitness, and whether the stem touched the obstacle; both of shape (plans, scenarios, plants).

    Args:
        simulator: of the plants.
        task: scenarios, start and end.
        seeds: one for each plant that is drawn; None for the typical one.
        is_right: see :func:`lamps`.
    """
    steps, plans = is_right.shape
    arrays = scenario_batch.arrays_of(task)
    fitness = np.empty((plans, len(task.scenarios), len(seeds)))
    hit = np.empty(fitness.shape, dtype=np.bool_)
    stems = np.empty((steps + 1, plans, STEM_POINTS, 2))
    for p, seed in enumerate(seeds):
        _grow(plants_of(simulator, task, seed, plans), np.ascontiguousarray(is_right), stems)
        high = stems[:, :, -1, 1] >= task.stop_height_cm
        flat = stems.reshape(-1, STEM_POINTS, 2)
        for s in range(len(task.scenarios)):
            touches = scenario_batch.collide(flat, np.repeat(arrays.edges[s][None], len(flat), axis=0))
            touches = touches.reshape(high.shape)
            over = touches | high
            over[-1] = True
            end, plan = over.argmax(axis=0), np.arange(plans)
            reason = np.where(touches[end, plan], COLLISION, np.where(high[end, plan], HEIGHT, TIME))
            target = np.repeat(arrays.targets[s][None], plans, axis=0)
            fitness[:, s, p] = scored(task, scenario_batch.fitness(stems[end, plan, -1], target), reason)
            hit[:, s, p] = reason == COLLISION
    return fitness, hit


@jit
def _grow(plants: Plants, is_right: Array, stems: Array) -> None:
    """Stems of all plans, shape (steps + 1, plans, 10, 2), written."""
    steps, plans = is_right.shape
    plants.copy_rows(np.zeros(plans, dtype=np.int64), np.arange(plans), plans)
    plants.points(plans, stems[0])
    for k in range(steps):
        plants.advance(plans, is_right[k], k)
        plants.points(plans, stems[k + 1])
