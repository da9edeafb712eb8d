"""The fast classes come to what neat-python's own come to, bit for bit."""

from __future__ import annotations

import pickle
import random
from pathlib import Path
from typing import Any

import neat
import numpy as np
import pytest
from evolve_neat_toys import everything_of, settings_with, toy_fitness
from neat.reporting import ReporterSet
from neat.species import Species

from flora_lab.evolve.neat_engine import Counter, Evaluate, Generation, NeatEngine
from flora_lab.evolve.neat_fast import FAST
from flora_lab.evolve.neat_genes import SortedGenes, distances
from flora_lab.evolve.neat_settings import STOCK, NeatSettings, NeatTypes, load_settings


def assert_same_evolution(
    settings: NeatSettings, seed: int, generations: int, fitness: Evaluate = toy_fitness
) -> tuple[NeatEngine, list[Generation]]:
    stock, fast = NeatEngine(settings, seed, STOCK), NeatEngine(settings, seed, FAST)
    courses = []
    for _ in range(generations):
        courses.append(fast.generation(fitness))
        assert stock.generation(fitness) == courses[-1]
        assert everything_of(stock) == everything_of(fast)
    return fast, courses


@pytest.mark.parametrize(("population", "generations"), [(60, 60), pytest.param(150, 35, marks=pytest.mark.slow)])
def test_same_genomes_species_and_random_numbers(population: int, generations: int) -> None:
    for seed in (1, 2):
        engine, _ = assert_same_evolution(load_settings(population=population), seed, generations)

    # A test of networks that never grew, or of one species, would show little.
    assert max(len(genome.nodes) for genome in engine.genomes) > 2
    assert len(engine.species.species) > 1


CHANGES: dict[str, dict[str, Any]] = {
    "all functions, all rates": {
        "Genome__activation_default": "random",
        "Genome__activation_options": "sigmoid tanh relu",
        "Genome__activation_mutate_rate": 0.2,
        "Genome__aggregation_options": "sum max mean",
        "Genome__aggregation_mutate_rate": 0.2,
        "Genome__response_init_stdev": 0.3,
        "Genome__response_mutate_rate": 0.3,
        "Genome__response_replace_rate": 0.1,
        "Genome__response_mutate_power": 0.2,
    },
    "structure comes and goes": {
        "Genome__node_add_prob": 0.5,
        "Genome__node_delete_prob": 0.3,
        "Genome__conn_add_prob": 0.6,
        "Genome__conn_delete_prob": 0.5,
        "Genome__num_hidden": 2,
        "Genome__num_inputs": 5,
        "Genome__initial_connection": "partial_direct 0.5",
    },
    "one structural mutation, toggling": {
        "Genome__single_structural_mutation": True,
        "Genome__structural_mutation_surer": "true",
        "Genome__node_add_prob": 0.4,
        "Genome__conn_add_prob": 0.4,
        "Genome__enabled_mutate_rate": 0.1,
        "Genome__enabled_rate_to_true_add": 0.2,
        "Genome__enabled_rate_to_false_add": 0.05,
    },
    "several outputs, uniform, no links at first": {
        "Genome__num_outputs": 3,
        "Genome__initial_connection": "unconnected",
        "Genome__conn_add_prob": 0.9,
        "Genome__weight_init_type": "uniform",
        "Genome__weight_max_value": 1.5,
        "Genome__weight_min_value": -0.5,
        "Genome__bias_init_type": "uniform",
    },
    "weights that do not halve exactly, many species": {
        "Genome__compatibility_weight_coefficient": 0.37,
        "Genome__compatibility_disjoint_coefficient": 1.13,
        "SpeciesSet__compatibility_threshold": 1.1,
    },
    "large elites, extinctions": {
        "Reproduction__elitism": 4,
        "Reproduction__min_species_size": 3,
        "Stagnation__max_stagnation": 2,
        "Stagnation__species_elitism": 0,
    },
}


@pytest.mark.parametrize("name", CHANGES)
def test_same_with_other_settings(name: str, tmp_path: Path) -> None:
    assert_same_evolution(settings_with(tmp_path, population=50, **CHANGES[name]), seed=11, generations=30)


def test_same_through_extinctions(tmp_path: Path) -> None:
    settings = settings_with(tmp_path, population=50, **CHANGES["large elites, extinctions"])

    # A fitness that never improves: all species stagnate.
    _, courses = assert_same_evolution(settings, 11, 10, lambda genomes: [0.0] * len(genomes))

    assert sum(course.is_extinct for course in courses) > 1


def test_distances_are_neat_pythons_to_the_bit(tmp_path: Path) -> None:
    for name in ("all functions, all rates", "structure comes and goes", "several outputs, uniform, no links at first"):
        changes = CHANGES[name] | CHANGES["weights that do not halve exactly, many species"]
        engine = NeatEngine(settings_with(tmp_path, **changes), 5)
        for _ in range(12):
            engine.generation(toy_fitness)
        genomes, config = engine.genomes, engine.config.genome_config
        genes = SortedGenes.of(genomes)

        for place in range(0, len(genomes), 7):
            row = distances(genes, place, genes, 1.13, 0.37)

            assert row.tolist() == [genomes[place].distance(other, config) for other in genomes]
        assert len(np.unique(row)) > 10


def with_key(genome: Any, key: int) -> Any:
    copied = type(genome)(key)
    copied.nodes, copied.connections = genome.nodes, genome.connections
    return copied


def reordered(genome: Any, key: int, draw: random.Random) -> Any:
    """The same genes in another order, in which their differences add up to another last bit."""
    copied = with_key(genome, key)
    copied.connections = dict(draw.sample(list(genome.connections.items()), len(genome.connections)))
    return copied


def speciated(settings: NeatSettings, types: NeatTypes, old: list[Any], population: dict[int, Any]) -> list[Any]:
    config = settings.config(types)
    species = types.species_set(config.species_set_config, ReporterSet())
    species.indexer = Counter(1)
    for genome in old:
        sid = next(species.indexer)
        species.species[sid] = Species(sid, 0)
        species.species[sid].update(genome, {})
    species.speciate(config, population, 1)
    return [(sid, s.representative.key, list(s.members)) for sid, s in sorted(species.species.items())]


def test_a_distance_is_the_one_that_neat_python_would_remember(tmp_path: Path) -> None:
    # neat-python answers for a pair with the distance that was computed first, there or back. Here T is asked about S
    # first. Then S, whose place is taken by its twin's species, must choose between T and another copy of T: from S
    # both are as far, but the remembered distance to T can be larger in the last bit.
    settings = settings_with(tmp_path, population=40, **CHANGES["weights that do not halve exactly, many species"])
    engine = NeatEngine(settings, 3)
    for _ in range(15):
        engine.generation(toy_fitness)
    config, draw = engine.config.genome_config, random.Random(1)
    farther = 0
    for _ in range(60):
        s, t = (reordered(genome, 0, draw) for genome in draw.sample(engine.genomes, 2))
        first_twin, living_s, living_t, copy = with_key(t, 1), with_key(s, 2), with_key(t, 3), with_key(t, 4)
        population = {genome.key: genome for genome in (first_twin, living_s, living_t, copy)}
        old = [living_t, with_key(s, 99), living_s]

        expected = speciated(settings, STOCK, old, population)

        assert speciated(settings, FAST, old, population) == expected
        is_farther = t.distance(s, config) > s.distance(t, config)
        assert expected[2][1] == (copy.key if is_farther else living_t.key)
        farther += is_farther
    assert farther > 5


def test_distance_of_genomes_without_genes() -> None:
    empty = neat.DefaultGenome(1)
    config = load_settings().config().genome_config

    assert distances(SortedGenes.of([empty]), 0, SortedGenes.of([empty]), 1.0, 0.5).tolist() == [
        empty.distance(empty, config)
    ]


def test_the_library_itself_is_left_as_it_is() -> None:
    before = {name: dict(vars(cls)) for name, cls in vars(neat).items() if isinstance(cls, type)}

    NeatEngine(load_settings(population=10), 1).generation(toy_fitness)

    assert {name: dict(vars(cls)) for name, cls in vars(neat).items() if isinstance(cls, type)} == before


def test_pickling_uses_up_no_number() -> None:
    engine = NeatEngine(load_settings(population=10), 1)
    engine.config.genome_config.node_indexer = Counter(41)
    engine.species.indexer = Counter(7)

    config, species = pickle.loads(pickle.dumps((engine.config.genome_config, engine.species)))

    assert next(config.node_indexer) == next(engine.config.genome_config.node_indexer) == 41
    assert next(species.indexer) == next(engine.species.indexer) == 7


def test_ancestors_do_not_grow_without_end() -> None:
    engine = NeatEngine(load_settings(population=20), 1)

    for _ in range(10):
        engine.generation(toy_fitness)

    assert set(engine.reproduction.ancestors) == set(engine.population)
