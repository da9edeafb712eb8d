"""A population in parts comes to what it comes to in one piece."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from evolution_examples import TASK, write_rod
from evolve_genomes import INPUTS, genome_config, random_genomes

from flora_lab.evolve.evaluate import Evaluated, evaluate
from flora_lab.evolve.genome_arrays import GenomeArrays, pack
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.shards import divided, from_bytes, joined, shard_count, to_bytes
from flora_lab.evolve.shared_steps import shared_steps
from flora_lab.simulator.load import load


@pytest.fixture(scope="module")
def genomes() -> GenomeArrays:
    return pack(random_genomes(23, 5, genome_config(calm=True), steering=True), INPUTS)


@pytest.fixture(scope="module")
def simulator(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return load(write_rod(tmp_path_factory.mktemp("simulator") / "rod.simulator"))


def same(one: Evaluated, other: Evaluated) -> bool:
    names = ("fitness", "reason", "steps", "tip_cm", "is_right")
    pairs = [(getattr(one.outcomes, name), getattr(other.outcomes, name)) for name in names]
    return one.steps_run == other.steps_run and all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)


@pytest.mark.parametrize("count", [1, 2, 3, 23, 50])
@pytest.mark.parametrize("individuals", [Individuals(), Individuals(2)], ids=["typical", "drawn"])
def test_parts_come_to_what_the_whole_comes_to(
    genomes: GenomeArrays, simulator: Any, count: int, individuals: Individuals
) -> None:
    whole = evaluate(genomes, simulator, TASK, individuals)
    parts = divided(genomes, count)
    assert np.concatenate([part.keys for part in parts]).tolist() == genomes.keys.tolist()
    done = [evaluate(part, simulator, TASK, individuals) for part in parts]
    assert same(joined([from_bytes(to_bytes(part)) for part in done]), whole)
    assert 0.02 < whole.outcomes.is_right.mean() < 0.98
    if count in {2, 3}:
        assert sum(part.steps_run for part in done) > whole.steps_run


def test_steps_are_counted_as_the_kernel_shares_them(genomes: GenomeArrays, simulator: Any) -> None:
    for hours in (1 / 12, 2.0, 14.0):
        whole = evaluate(genomes, simulator, replace(TASK, hours=hours))
        assert shared_steps(whole.outcomes) == whole.steps_run


def test_histories_that_begin_alike_are_counted_once(genomes: GenomeArrays, simulator: Any) -> None:
    outcomes = evaluate(genomes, simulator, replace(TASK, hours=0.5)).outcomes
    rng = np.random.default_rng(1)
    is_right = rng.random((40, 3, 2, 12)) < 0.3
    steps = rng.integers(1, 13, size=(40, 3, 2))
    is_right &= np.arange(12) < steps[..., None]
    drawn = replace(outcomes, is_right=is_right, steps=steps)
    beginnings = {
        (plant, tuple(is_right[g, s, plant, : k + 1].tolist()))
        for g in range(40)
        for s in range(3)
        for plant in range(2)
        for k in range(steps[g, s, plant])
    }
    assert shared_steps(drawn) == len(beginnings)


@pytest.mark.parametrize(
    ("population", "processors", "parts"),
    [(150, 64, 1), (999, 64, 1), (1000, 64, 2), (10_000, 8, 8), (10_000, 64, 20), (10_000, 1, 1), (10_000, 0, 1)],
)
def test_only_large_populations_are_divided(population: int, processors: int, parts: int) -> None:
    assert shard_count(population, processors) == parts
