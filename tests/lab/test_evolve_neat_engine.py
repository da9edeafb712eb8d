"""An engine's evolution depends on its settings and seed alone, and a fitness that is none ends it clearly."""

from __future__ import annotations

import random
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import neat
import pytest
from evolve_neat_toys import everything_of, genes_of, settings_with, toy_fitness

from flora_common.errors import BadInput
from flora_lab.evolve.neat_engine import Counter, NeatEngine
from flora_lab.evolve.neat_settings import STOCK, load_settings

SETTINGS = load_settings(population=30)


def evolved(seed: int, generations: int = 12) -> NeatEngine:
    engine = NeatEngine(SETTINGS, seed)
    for _ in range(generations):
        engine.generation(toy_fitness)
    return engine


def test_the_same_as_neat_pythons_own_loop() -> None:
    """``neat.Population`` with the library's own counters and its own use of ``random``."""

    def evaluate(genomes: Sequence[tuple[int, Any]], _: Any) -> None:
        for (_, genome), value in zip(genomes, toy_fitness([genome for _, genome in genomes]), strict=True):
            genome.fitness = value

    state = random.getstate()
    try:
        population = neat.Population(SETTINGS.config(STOCK), seed=4)
        population.run(evaluate, 12)
    finally:
        random.setstate(state)

    assert [genes_of(g) for g in population.population.values()] == [genes_of(g) for g in evolved(4).genomes]
    assert genes_of(population.best_genome) == genes_of(evolved(4).best)


def test_another_seed_is_another_evolution() -> None:
    assert everything_of(evolved(1)) == everything_of(evolved(1))
    assert everything_of(evolved(1)) != everything_of(evolved(2))


def test_what_else_draws_random_numbers_changes_nothing() -> None:
    def careless(genomes: Sequence[Any]) -> list[float]:
        random.seed(99)
        random.gauss(0.0, 1.0)
        return toy_fitness(genomes)

    engine = NeatEngine(SETTINGS, 1)
    for _ in range(12):
        engine.generation(careless)

    assert everything_of(engine) == everything_of(evolved(1))


def test_an_engine_leaves_the_shared_generator_as_it_was() -> None:
    random.gauss(0.0, 1.0)  # half of a pair is kept for the next call: that is part of the state
    before = random.getstate()

    evolved(1, 2)

    assert random.getstate() == before


def test_several_engines_by_turns_are_as_each_alone() -> None:
    engines = [NeatEngine(SETTINGS, seed) for seed in (1, 2, 3)]
    for _ in range(12):
        for engine in engines:
            engine.generation(toy_fitness)

    assert [everything_of(e) for e in engines] == [everything_of(evolved(seed)) for seed in (1, 2, 3)]


def test_several_engines_in_threads_are_as_each_alone() -> None:
    engines: dict[int, NeatEngine] = {}

    def work(seed: int) -> None:
        engines[seed] = evolved(seed)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in (1, 2, 3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    assert [everything_of(engines[seed]) for seed in (1, 2, 3)] == [everything_of(evolved(seed)) for seed in (1, 2, 3)]


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_a_fitness_that_is_no_number_is_refused_and_changes_nothing(value: float) -> None:
    engine = evolved(1)
    before = everything_of(engine)
    keys = list(engine.population)

    with pytest.raises(ValueError, match=f"fitness of genome {keys[3]} is {value}"):
        engine.generation(lambda genomes: [0.0] * 3 + [value] + [0.0] * (len(genomes) - 4))

    assert everything_of(engine) == before
    engine.generation(toy_fitness)
    assert everything_of(engine) == everything_of(evolved(1, 13))


def test_too_few_fitness_values_are_refused() -> None:
    with pytest.raises(ValueError, match="29 fitness values for 30 genomes"):
        evolved(1, 0).generation(lambda genomes: [0.0] * (len(genomes) - 1))


def test_what_a_generation_tells() -> None:
    engine = NeatEngine(SETTINGS, 1)
    keys = list(engine.population)

    told = engine.generation(lambda genomes: [0.25, 1.5, 1.5] + [0.5] * (len(genomes) - 3))

    assert (told.number, told.best_key, told.best_fitness, told.median_fitness) == (0, keys[1], 1.5, 0.5)
    assert told.species >= 1
    assert engine.generation_number == 1


def test_the_best_keeps_the_fitness_that_it_had() -> None:
    """Where fitness depends on chance, an elite is given another one in each generation."""
    engine = NeatEngine(SETTINGS, 1)

    engine.generation(lambda genomes: [7.0] + [0.0] * (len(genomes) - 1))
    best = genes_of(engine.best)
    assert engine.best.key in engine.population
    engine.generation(lambda genomes: [1.0] * len(genomes))

    assert engine.best.fitness == 7.0
    assert genes_of(engine.best) == best


def test_extinction_without_a_new_beginning_is_told(tmp_path: Path) -> None:
    changes: dict[str, Any] = {"Stagnation__max_stagnation": 2, "Stagnation__species_elitism": 0}
    engine = NeatEngine(settings_with(tmp_path, NEAT__reset_on_extinction=False, **changes), 1)

    for _ in range(2):
        engine.generation(lambda genomes: [0.0] * len(genomes))

    with pytest.raises(BadInput, match="generation 2: all species stagnated; set reset_on_extinction"):
        engine.generation(lambda genomes: [0.0] * len(genomes))


def test_more_species_than_the_population_has_room_for(tmp_path: Path) -> None:
    changes: dict[str, Any] = {"SpeciesSet__compatibility_threshold": 0.01, "Reproduction__min_species_size": 3}
    engine = NeatEngine(settings_with(tmp_path, population=12, **changes), 1)

    with pytest.raises(BadInput, match="population of 12 has no room for 12 species"):
        engine.generation(toy_fitness)


def test_a_counter_counts_as_itertools_does() -> None:
    counter = Counter(5)

    assert [next(counter), next(counter), counter.following, next(counter)] == [5, 6, 7, 7]


def test_a_population_that_comes_no_further_is_left_for_a_new_one_and_its_best_stays_known(tmp_path: Path) -> None:
    settings = settings_with(
        tmp_path, Restart__restart_after=2, Restart__restart_after_best=4, Restart__restart_gain=0.1
    )
    engine = NeatEngine(settings, 3)
    course = iter([5.0, 5.05, 5.1, 5.1, 5.1, 3.0, 4.0, 4.0, 4.1, 6.0, 6.0])
    begun_anew = []
    for level in course:
        before = {genome.key for genome in engine.genomes}
        told = engine.generation(lambda genomes, level=level: [level] * len(genomes))
        if told.is_extinct:
            begun_anew.append(told.number)
            assert not before & {genome.key for genome in engine.genomes}
            assert len(engine.genomes) == settings.population

    # The first holds the run's best, and 5.1 is not more than 0.1 above 5.0: four generations from the first on. The
    # second has two from its 4.0 on; the third is ahead from its first generation.
    assert begun_anew == [4, 8]
    assert (engine.best.fitness, engine.level, engine.level_since) == (6.0, 6.0, 9)


def test_without_restarts_nothing_is_left(tmp_path: Path) -> None:
    engine = NeatEngine(settings_with(tmp_path, Stagnation__max_stagnation=1000), 3)

    assert not any(engine.generation(lambda genomes: [1.0] * len(genomes)).is_extinct for _ in range(60))
