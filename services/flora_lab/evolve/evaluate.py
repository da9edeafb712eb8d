"""Fitness of a whole generation: genomes as arrays, a simulator, a task."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np

from flora_common.errors import BadInput
from flora_lab.evolve.episode import Outcomes, scored
from flora_lab.evolve.genome_activate import networks_of
from flora_lab.evolve.genome_arrays import GenomeArrays
from flora_lab.evolve.genome_decide import LANES
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.plant_looks import NOT_FINITE, scenarios_of
from flora_lab.evolve.plants_kinds import plants_of
from flora_lab.evolve.shared_kernel import Episodes, run_shared
from flora_lab.evolve.shared_steps import shared_steps
from flora_lab.evolve.task import Task
from flora_lab.simulator.interface import Simulator

TYPICAL: Final = Individuals()
"""No plant is drawn."""


@dataclass(frozen=True, slots=True)
class Evaluated:
    """A generation's episodes.

    Attributes:
        outcomes: shapes (genomes, scenarios, plants).
        steps_run: of plants, those that several episodes share counted once, as one thread takes them.
    """

    outcomes: Outcomes
    steps_run: int

    @property
    def episode_steps(self) -> int:
        """Of all episodes, as if each had its own plant."""
        return int(self.outcomes.steps.sum())


def evaluate(
    genomes: GenomeArrays,
    simulator: Simulator[Any],
    task: Task,
    individuals: Individuals = TYPICAL,
    *,
    share: bool = True,
    threads: int = 1,
) -> Evaluated:
    """Every genome in every scenario on every plant, as :func:`flora_lab.evolve.episode.run_episode` does each.

    Growing simulators give the same to the last bit; the paper's the same but for rounding.

    Args:
        genomes: with the 26 inputs of :data:`flora_lab.evolve.controllers.INPUTS` and one output.
        simulator: of any kind of :mod:`flora_lab.evolve.plants_kinds`.
        task: scenarios, start and end.
        individuals: the plants; the typical one where nothing is said.
        share: simulate a plant that several episodes have in common once; the results are the same without it.
        threads: how many to use. Each takes some of the genomes, and only those share plants; the results are the same,
            with the steps that one thread takes.

    Raises:
        BadInput: a simulator of a kind that has no compiled form or no individuals, or that gives a stem that is not
            finite.
        ValueError: no thread.
    """
    if threads < 1:
        raise ValueError(f"{threads} threads")
    seeds: Sequence[int | None] = individuals.seeds() or [None]
    episodes = _room(len(seeds), len(genomes), task)
    scenarios = scenarios_of(task)
    ends = np.linspace(0, len(genomes), min(threads, max(len(genomes), 1)) + 1).astype(int).tolist()
    parts = [(first, end) for first, end in pairwise(ends) if end > first]

    def run(plant: int, first: int, end: int) -> int:
        plants = plants_of(simulator, task, seeds[plant], (end - first) * len(task.scenarios))
        part = Episodes(*(array[plant, first:end] for array in episodes))
        slots = np.zeros((LANES, genomes.slots))
        return int(run_shared(networks_of(genomes, first, end), scenarios, plants, part, slots, share))

    jobs = [(plant, *part) for plant in range(len(seeds)) for part in parts]
    if threads == 1:
        steps_run = sum(run(*job) for job in jobs)
    else:
        with ThreadPoolExecutor(threads) as pool:
            steps_run = sum(pool.map(lambda job: run(*job), jobs))
    if (episodes.reason == NOT_FINITE).any():
        raise BadInput(f"the simulator gives a stem that is not finite, task {task.name}; train it again")
    episodes.fitness[:] = scored(task, episodes.fitness, episodes.reason)
    outcomes = Outcomes(*(np.moveaxis(array, 0, 2) for array in episodes))
    return Evaluated(outcomes, shared_steps(outcomes) if share and len(parts) > 1 else steps_run)


def _room(plants: int, genomes: int, task: Task) -> Episodes:
    """For the outcomes of all, the plant first: what one pass of the loop writes is in one piece."""
    shape = (plants, genomes, len(task.scenarios))
    return Episodes(
        np.full(shape, np.nan),
        np.full(shape, -1, dtype=np.int8),
        np.zeros(shape, dtype=np.int64),
        np.empty((*shape, 2)),
        np.zeros((*shape, task.most_steps), dtype=np.bool_),
    )
