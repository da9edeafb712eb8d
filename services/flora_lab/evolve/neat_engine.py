"""One evolution by NEAT, a generation at a time: whoever calls it decides how fitness is found.

neat-python draws from the one random generator that all of Python's ``random`` shares. An engine has a state of its own
and lends it to that generator for the time of its own work, so what else draws random numbers in the process, other
engines included, changes nothing, and is not changed either. Engines in several threads wait for each other; a thread
that draws from ``random`` itself while an engine works would disturb it, and must use a ``random.Random`` of its own.
"""

from __future__ import annotations

import math
import random
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median
from typing import Any, Final

from neat.reporting import ReporterSet

from flora_common.errors import BadInput
from flora_lab.evolve.neat_fast import FAST
from flora_lab.evolve.neat_settings import NeatSettings, NeatTypes

Evaluate = Callable[[list[Any]], Sequence[float]]
"""Genomes to one fitness each, in the same order; more is better. The genomes are not to be changed."""

_LENT: Final = threading.RLock()


class OwnRandomness:
    """A state for Python's shared random generator.

    Args:
        seed: any whole number.

    Attributes:
        state: as of ``random.getstate()``.
    """

    def __init__(self, seed: int) -> None:
        self.state: tuple[Any, ...] = random.Random(seed).getstate()

    @contextmanager
    def lent(self) -> Iterator[None]:
        """Within the block ``random`` goes on from here; after it, from where it was before."""
        with _LENT:
            outside = random.getstate()
            random.setstate(self.state)
            try:
                yield
            finally:
                self.state = random.getstate()
                random.setstate(outside)


class Counter:
    """Counts as ``itertools.count`` does, and can be looked at without counting on."""

    def __init__(self, following: int) -> None:
        self.following = following

    def __iter__(self) -> Counter:
        return self

    def __next__(self) -> int:
        self.following += 1
        return self.following - 1


@dataclass(frozen=True, slots=True)
class Generation:
    """What a generation came to.

    Attributes:
        number: from 0.
        best_key: the fittest genome; the first of them.
        best_fitness, median_fitness: of this generation.
        species: how many it had.
        is_extinct: a new population comes after it: all species stagnated, or none came further (``[Restart]``).
    """

    number: int
    best_key: int
    best_fitness: float
    median_fitness: float
    species: int
    is_extinct: bool


class NeatEngine:
    """A population and its species.

    Args:
        settings: of :func:`flora_lab.evolve.neat_settings.load_settings`.
        seed: with the settings it decides all.
        types: neat-python's classes, or those that do the same faster.
        is_empty: leave the first population out, for a state that is read from a file.

    Attributes:
        settings, seed, types: as given.
        config: the ``neat.Config``, this engine's alone.
        population: key to genome, in the order in which they came to be.
        reproduction, species: objects of neat-python's classes.
        generation_number: of the population that waits for its fitness.
        best: the fittest genome ever, with its fitness, or None before the first generation.
        level, level_since: the best fitness of this population that was worth counting, and of which generation.
    """

    def __init__(self, settings: NeatSettings, seed: int, types: NeatTypes = FAST, *, is_empty: bool = False) -> None:
        self.settings, self.seed, self.types = settings, seed, types
        self.config = settings.config(types)
        self.randomness = OwnRandomness(seed)
        reporters = ReporterSet()
        stagnation = types.stagnation(self.config.stagnation_config, reporters)
        self.reproduction = types.reproduction(self.config.reproduction_config, reporters, stagnation)
        self.species = types.species_set(self.config.species_set_config, reporters)
        # Counters that can be saved; from the numbers that neat-python begins with.
        self.reproduction.genome_indexer = Counter(1)
        self.species.indexer = Counter(1)
        self.config.genome_config.node_indexer = Counter(self.config.genome_config.num_outputs)
        self.config.genome_config.innovation_tracker = self.reproduction.innovation_tracker
        self.generation_number = 0
        self.level, self.level_since = -math.inf, 0
        self.best: Any = None
        self.population: dict[int, Any] = {}
        if not is_empty:
            with self.randomness.lent():
                self.population = self._new_population()
                self.species.speciate(self.config, self.population, self.generation_number)

    @property
    def genomes(self) -> list[Any]:
        """Those that wait for their fitness."""
        return list(self.population.values())

    def generation(self, evaluate: Evaluate) -> Generation:
        """Find the fitness of all genomes, and make the next generation of them.

        Nothing has changed when ``evaluate`` or the check of what it returns ends with an error.

        Raises:
            ValueError: a fitness that is not a finite number, or another number of them than genomes.
            BadInput: there are more species than the population has room for.
        """
        genomes = self.genomes
        fitnesses = _checked([float(value) for value in evaluate(genomes)], genomes)
        for genome, fitness in zip(genomes, fitnesses, strict=True):
            genome.fitness = fitness
        champion = max(genomes, key=lambda genome: float(genome.fitness))
        if self.best is None or champion.fitness > self.best.fitness:
            self.best = self._kept(champion)
        species = len(self.species.species)
        with self.randomness.lent():
            is_extinct = self._begin_anew() if self._has_stalled(champion.fitness) else self._breed()
        number = self.generation_number
        self.generation_number += 1
        return Generation(number, champion.key, champion.fitness, median(fitnesses), species, is_extinct)

    def _kept(self, genome: Any) -> Any:
        """The genome as it is now: an elite is given a new fitness in every generation. Its genes never change."""
        kept = self.types.genome(genome.key)
        kept.nodes, kept.connections, kept.fitness = genome.nodes, genome.connections, genome.fitness
        return kept

    def _has_stalled(self, best_fitness: float) -> bool:
        """Whether this population has had its time; see ``[Restart]`` in ``neat.cfg``."""
        restart = self.settings.restart
        if best_fitness > self.level + restart.gain:
            self.level, self.level_since = best_fitness, self.generation_number
        is_best = self.best.fitness <= self.level + restart.gain
        patience = restart.after_best if is_best else restart.after
        return restart.after > 0 and self.generation_number - self.level_since >= patience

    def _begin_anew(self) -> bool:
        """Leave this population for a new one; the fittest genome so far stays known."""
        self.population = self._new_population()
        self.species.species, self.species.genome_to_species = {}, {}
        self.level, self.level_since = -math.inf, self.generation_number + 1
        self.species.speciate(self.config, self.population, self.generation_number)
        return True

    def _breed(self) -> bool:
        try:
            self.population = self.reproduction.reproduce(
                self.config, self.species, self.config.pop_size, self.generation_number
            )
        except RuntimeError as problem:
            raise BadInput(
                f"a population of {self.config.pop_size} has no room for {len(self.species.species)} species: "
                "raise compatibility_threshold or pop_size, or lower elitism and min_species_size"
            ) from problem
        is_extinct = not self.species.species
        if is_extinct:
            if not self.config.reset_on_extinction:
                raise BadInput(
                    f"generation {self.generation_number}: all species stagnated; set reset_on_extinction = True, "
                    "or raise max_stagnation or species_elitism"
                )
            self.population = self._new_population()
        self.species.speciate(self.config, self.population, self.generation_number)
        return is_extinct

    def _new_population(self) -> dict[int, Any]:
        new: dict[int, Any] = self.reproduction.create_new(
            self.config.genome_type, self.config.genome_config, self.config.pop_size
        )
        return new


def _checked(fitnesses: list[float], genomes: list[Any]) -> list[float]:
    if len(fitnesses) != len(genomes):
        raise ValueError(f"{len(fitnesses)} fitness values for {len(genomes)} genomes")
    for fitness, genome in zip(fitnesses, genomes, strict=True):
        if not math.isfinite(fitness):
            raise ValueError(f"the fitness of genome {genome.key} is {fitness}; it must be a finite number")
    return fitnesses
