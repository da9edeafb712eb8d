"""One run of an evolution, as data: what it has come to, and how it goes on.

A run is advanced in slices, anywhere. A slice begins from the data of the one before and comes to what a run without
interruption would have come to, to the last bit, so it does not matter who does it, how long it is, and whether it is
done twice because the first one was lost.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Final

import msgspec
import numpy as np

from flora_lab.evolve.controllers import INPUTS
from flora_lab.evolve.evaluate import Evaluated, evaluate
from flora_lab.evolve.genome_arrays import GenomeArrays, pack
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.neat_checkpoint import EngineState, engine_from, state_of
from flora_lab.evolve.neat_engine import NeatEngine
from flora_lab.evolve.plan import Plan
from flora_lab.evolve.sealed import opened, sealed
from flora_lab.evolve.task import Task
from flora_lab.simulator.interface import Simulator

FORMAT: Final = "flora-evolution-run-1"

Clock = Callable[[], float]
Evaluate = Callable[[GenomeArrays, Simulator[Any], Task, Individuals], Evaluated]
"""As :func:`flora_lab.evolve.evaluate.evaluate`, and with its results, wherever it is done."""
Count = Annotated[int, msgspec.Meta(ge=0)]


class GenerationRow(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What a generation came to.

    Attributes:
        best_fitness, median_fitness: over the population, as the task averages over its scenarios.
        species: how many.
        is_extinct: a new population came after it.
        nodes: hidden ones of the best genome.
        links: enabled ones of the best genome.
        plant_steps: that were simulated.
        episode_steps: of all episodes; many share a plant.
        by_scenario: fitness of the best genome.
    """

    best_fitness: float
    median_fitness: float
    species: Count
    is_extinct: bool
    nodes: Count
    links: Count
    plant_steps: Count
    episode_steps: Count
    by_scenario: list[float]


class Took(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Seconds that a run has taken so far.

    Attributes:
        evaluation_s: simulated episodes.
        neat_s: reproduction and speciation.
        other_s: genomes to arrays, reading and writing the run's data.
    """

    evaluation_s: float = 0.0
    neat_s: float = 0.0
    other_s: float = 0.0

    def __add__(self, other: Took) -> Took:
        return Took(self.evaluation_s + other.evaluation_s, self.neat_s + other.neat_s, self.other_s + other.other_s)


class RunState(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A run between two generations.

    Attributes:
        number: of the run, from 1.
        engine: its population and all that its future depends on.
        history: one row per generation.
        took: so far.
    """

    number: Annotated[int, msgspec.Meta(ge=1)]
    engine: EngineState
    history: list[GenerationRow]
    took: Took = Took()


def first_state(plan: Plan, number: int) -> RunState:
    """Run ``number`` before its first generation.

    Raises:
        BadInput: settings that make no population.
    """
    return RunState(number, state_of(NeatEngine(plan.settings, plan.run_seed(number))), [])


def advance(plan: Plan, state: RunState, *, seconds: float, clock: Clock, evaluate: Evaluate = evaluate) -> RunState:
    """Go on with a run: one generation at least, and until the time is over or the run is.

    Args:
        plan: what the evolution is.
        state: where the run stands.
        seconds: after which no further generation begins.
        clock: seconds that only go forward.
        evaluate: finds the fitness of a generation.

    Raises:
        BadInput: the state is not of this plan, or the simulator leaves the numbers.
    """
    began = clock()
    spent = _Stopwatch(clock)
    engine = engine_from(state.engine, plan.settings)
    history = list(state.history)
    while engine.generation_number < plan.generations:
        tried = _Tried(plan, spent, evaluate)
        with_neat = clock()
        before = spent.evaluation_s + spent.packing_s
        told = engine.generation(tried)
        spent.neat_s += clock() - with_neat - (spent.evaluation_s + spent.packing_s - before)
        history.append(tried.row(told.best_fitness, told.median_fitness, told.species, told.is_extinct))
        if clock() - began >= seconds:
            break
    engine_state = state_of(engine)
    known = spent.evaluation_s + spent.neat_s
    took = state.took + Took(spent.evaluation_s, spent.neat_s, max(0.0, clock() - began - known))
    return RunState(state.number, engine_state, history, took)


def is_over(plan: Plan, state: RunState) -> bool:
    """Whether all its generations are done."""
    return len(state.history) >= plan.generations


def encode(state: RunState) -> bytes:
    """A run as a file's content."""
    return sealed(state, FORMAT)


def decode(data: bytes) -> RunState:
    """The run in a file's content.

    Raises:
        BadInput: not such a file, or damaged.
    """
    return opened(data, FORMAT, RunState, "run of an evolution")


class _Stopwatch:
    """Where a slice's time goes."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.evaluation_s = self.packing_s = self.neat_s = 0.0


class _Tried:
    """One generation's fitness; knows afterwards how the best one did."""

    def __init__(self, plan: Plan, spent: _Stopwatch, evaluate: Evaluate) -> None:
        self._plan, self._spent, self._evaluate = plan, spent, evaluate

    def __call__(self, genomes: list[Any]) -> list[float]:
        clock = self._spent.clock
        began = clock()
        arrays = pack(genomes, len(INPUTS))
        packed = clock()
        tried = self._evaluate(arrays, self._plan.parcel.simulator, self._plan.task, self._plan.individuals)
        by_scenario = self._plan.individuals.judged(tried.outcomes.fitness)
        fitness = by_scenario.mean(axis=1)
        self._spent.packing_s += packed - began
        self._spent.evaluation_s += clock() - packed
        best = int(np.argmax(fitness))
        self._best, self._by_scenario = genomes[best], by_scenario[best]
        self._plant_steps, self._episode_steps = tried.steps_run, tried.episode_steps
        return [float(value) for value in fitness]

    def row(self, best_fitness: float, median_fitness: float, species: int, is_extinct: bool) -> GenerationRow:
        links = sum(1 for gene in self._best.connections.values() if gene.enabled)
        return GenerationRow(
            best_fitness,
            median_fitness,
            species,
            is_extinct,
            len(self._best.nodes) - 1,
            links,
            self._plant_steps,
            self._episode_steps,
            self._by_scenario.tolist(),
        )
