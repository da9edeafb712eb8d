"""Where it counts: controllers evolved in the base and in the extended simulator, run on the plant with the effect.

Two kinds are compared. Feedback controllers see the stem and correct what a simulator gets wrong, so they lose less and
gain less; light plans see nothing. Both are evolved on plants that differ and to which things happen by chance: without
it, evolution makes use of whatever one typical plant does, and comes too near to the obstacle. All are judged on the
same plants, one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose import light_plans
from flora_lab.diagnose.diagnosis import SURE_ERRORS
from flora_lab.evolve.controllers import INPUTS
from flora_lab.evolve.episode import COLLISION
from flora_lab.evolve.evaluate import evaluate
from flora_lab.evolve.genome_arrays import GenomeArrays, pack
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.neat_engine import NeatEngine
from flora_lab.evolve.neat_settings import load_settings
from flora_lab.evolve.task import Task
from flora_lab.simulator.interface import Simulator

Kind = Literal["feedback", "plan"]

SHORT_LIST: Final = 10
"""Controllers of the last generation that are tried on further plants of their own simulator; the best one is taken."""
_TRAINED, _CHOSEN, _JUDGED = 101, 202, 303
"""Seeds of plants: those of evolution, of the choice, and those that judge."""
_OnPlants = Callable[[Simulator[Any], Individuals], tuple[Array, Array]]
"""A simulator's plants to fitness and collisions, each of shape (plants,)."""


@dataclass(frozen=True, slots=True)
class Effort:
    """How much evolution is to do.

    Attributes:
        seeds: independent evolutions.
        generations, population: of each.
        individuals: plants that each controller is tried on.
        judges: plants that decide, the same ones for all.
        threads: to work in; what comes of it is the same.
    """

    seeds: int = 5
    generations: int = 40
    population: int = 100
    individuals: int = 6
    judges: int = 24
    threads: int = 1


@dataclass(frozen=True, slots=True)
class Judged:
    """Controllers of one simulator, on some plants.

    Attributes:
        fitness: mean over scenarios, shape (seeds, plants).
        collides: share of scenarios that ended at the obstacle, shape (seeds, plants).
    """

    fitness: Array
    collides: Array

    def told(self) -> dict[str, Any]:
        """In numbers: mean over all, how seeds and plants scatter, collisions; and the mean of each seed and plant."""
        return {
            "mean": round(float(self.fitness.mean()), 4),
            "sd_of_seeds": round(float(self.fitness.mean(axis=1).std(ddof=1)) if len(self.fitness) > 1 else 0.0, 4),
            "sd_of_plants": round(float(self.fitness.std(axis=1, ddof=1).mean()), 4),
            "worst_plant": round(float(self.fitness.mean(axis=0).min()), 4),
            "collisions": round(float(self.collides.mean()), 4),
            "of_seeds": np.round(self.fitness.mean(axis=1), 4).tolist(),
            "of_plants": np.round(self.fitness.mean(axis=0), 4).tolist(),
        }


@dataclass(frozen=True, slots=True)
class Bred:
    """The best controller of each of several evolutions in one simulator.

    Attributes:
        simulator: that they were evolved in.
        task, kind: what they are to do, and what they are.
        controllers: in the order of the seeds.
        judges: plants that decide.
    """

    simulator: Simulator[Any]
    task: Task
    kind: Kind
    controllers: tuple[_OnPlants, ...]
    judges: Individuals

    def on(self, plant: Simulator[Any]) -> Judged:
        """All of them on the same plants of a simulator."""
        rows = [found(plant, self.judges) for found in self.controllers]
        return Judged(np.stack([fitness for fitness, _ in rows]), np.stack([hit for _, hit in rows]))


def bred(
    task: Task, simulator: Simulator[Any], kind: Kind, effort: Effort, on_evolved: Callable[[], None] = lambda: None
) -> Bred:
    """Evolve controllers in a simulator; ``on_evolved`` is called after each evolution."""
    found = []
    for number in range(effort.seeds):
        found.append(_evolved(kind, task, simulator, effort, number))
        on_evolved()
    return Bred(simulator, task, kind, tuple(found), Individuals(effort.judges, _JUDGED))


def controller_gain(base: Bred, extended: Bred, plant: Simulator[Any], oracle: Bred | None = None) -> dict[str, Any]:
    """Fitness and collisions on the plant with the effect, by the simulator that controllers were evolved in.

    Args:
        base, extended: evolved without and with the causes that were found.
        plant: stands for the plant as it is: a simulator with the effect.
        oracle: evolved in ``plant`` itself: as good as it gets.

    Returns:
        ``base`` and ``extended`` (and ``oracle``), each a table of numbers; ``without_effect``, what the base's
        controllers come to on the base's own plants; ``cost``, mean and standard error over seeds of what the effect
        costs these; ``difference``, the same of extended minus base, plant by plant; ``recovered``, the share of the
        cost that the extension brings back, or None where the cost is lost in the scatter of evolution.
    """
    by_whom = {"base": base, "extended": extended} | ({} if oracle is None else {"oracle": oracle})
    judged = {name: one.on(plant) for name, one in by_whom.items()}
    home = base.on(base.simulator)
    apart = judged["extended"].fitness.mean(axis=1) - judged["base"].fitness.mean(axis=1)
    cost = home.fitness.mean(axis=1) - judged["base"].fitness.mean(axis=1)
    is_sure = cost.mean() > SURE_ERRORS * _standard_error(cost)
    return {
        "task": base.task.name,
        "kind": base.kind,
        **{name: own.told() for name, own in judged.items()},
        "without_effect": home.told(),
        "cost": _with_error(cost),
        "difference": _with_error(apart),
        "recovered": round(float(apart.mean() / cost.mean()), 3) if is_sure else None,
    }


def _with_error(values: Array) -> dict[str, float]:
    return {"mean": round(float(values.mean()), 4), "standard_error": round(_standard_error(values), 4)}


def _standard_error(values: Array) -> float:
    """Of the mean over seeds; 0 where there is one."""
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0


def _evolved(kind: Kind, task: Task, simulator: Simulator[Any], effort: Effort, number: int) -> _OnPlants:
    """The best controller of one evolution: the plants of evolution and of the choice differ from seed to seed."""
    trained = Individuals(effort.individuals, _TRAINED + 1000 * number)
    choice = Individuals(effort.judges, _CHOSEN + 1000 * number)
    if kind == "plan":
        return _evolved_plan(task, simulator, effort, number, trained, choice)
    return _evolved_network(task, simulator, effort, number, trained, choice)


def _evolved_network(
    task: Task, simulator: Simulator[Any], effort: Effort, number: int, trained: Individuals, choice: Individuals
) -> _OnPlants:
    engine = NeatEngine(load_settings(population=effort.population), number)
    last: list[tuple[float, Any]] = []

    def networks(arrays: GenomeArrays, plants: Simulator[Any], individuals: Individuals) -> tuple[Array, Array]:
        outcomes = evaluate(arrays, plants, task, individuals, threads=effort.threads).outcomes
        return outcomes.fitness.mean(axis=1), (outcomes.reason == COLLISION).mean(axis=1)

    def fitness(genomes: list[Any]) -> list[float]:
        told = networks(pack(genomes, len(INPUTS)), simulator, trained)[0].mean(axis=1).tolist()
        last[:] = sorted(zip(told, genomes, strict=True), key=lambda pair: -pair[0])[:SHORT_LIST]
        return [float(value) for value in told]

    for _ in range(effort.generations):
        engine.generation(fitness)
    listed = [genome for _, genome in last]
    again = networks(pack(listed, len(INPUTS)), simulator, choice)[0].mean(axis=1)
    best = pack([listed[int(np.argmax(again))]], len(INPUTS))

    def on_plants(plants: Simulator[Any], individuals: Individuals) -> tuple[Array, Array]:
        own, hit = networks(best, plants, individuals)
        return own[0], hit[0]

    return on_plants


def _evolved_plan(
    task: Task, simulator: Simulator[Any], effort: Effort, number: int, trained: Individuals, choice: Individuals
) -> _OnPlants:
    def run(genes: Array, plants: Simulator[Any], individuals: Individuals) -> tuple[Array, Array]:
        seeds: Sequence[int | None] = individuals.seeds() or [None]
        is_right = light_plans.lamps(genes, task.most_steps)
        with ThreadPoolExecutor(effort.threads) as pool:
            told = list(pool.map(lambda seed: light_plans.run_plans(plants, task, [seed], is_right), seeds))
        own, hit = (np.concatenate(arrays, axis=2) for arrays in zip(*told, strict=True))
        return own.mean(axis=1), hit.mean(axis=1)

    def judge(genes: Array) -> Array:
        return np.asarray(run(genes, simulator, trained)[0].mean(axis=1))

    listed = light_plans.evolved(judge, effort.generations, effort.population, number)[:SHORT_LIST]
    best = listed[[int(np.argmax(run(listed, simulator, choice)[0].mean(axis=1)))]]

    def on_plants(plants: Simulator[Any], individuals: Individuals) -> tuple[Array, Array]:
        own, hit = run(best, plants, individuals)
        return own[0], hit[0]

    return on_plants
