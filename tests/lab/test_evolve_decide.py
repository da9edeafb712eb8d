"""What networks decide side by side is what they say one by one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from evolve_genomes import genome_config, overflowing, random_genomes
from evolve_reference import activate

from flora_lab.evolve.genome_activate import networks_of
from flora_lab.evolve.genome_arrays import GenomeArrays, pack
from flora_lab.evolve.genome_decide import LANES, NO_DECISION, decide
from flora_lab.evolve.plant_looks import STEM, TOLD

INPUTS = STEM + TOLD


def decisions(arrays: GenomeArrays, stems: Any, told: Any, plant: Any) -> Any:
    decision = np.full(plant.shape, 7, dtype=np.int8)
    slots, going = np.zeros((LANES, arrays.slots)), np.arange(len(arrays))
    decide(networks_of(arrays), going, len(going), plant, stems, told, slots, decision)
    return decision


def expected(arrays: GenomeArrays, stems: Any, told: Any, plant: Any) -> Any:
    decision = np.full(plant.shape, 7, dtype=np.int8)
    for s in range(plant.shape[1]):
        inputs = np.concatenate([stems[np.maximum(plant[:, s], 0)], np.repeat(told[s : s + 1], len(arrays), 0)], axis=1)
        said = activate(arrays, inputs)[:, 0]
        decided = np.where(np.isnan(said), NO_DECISION, said > 0.5)
        decision[:, s] = np.where(plant[:, s] >= 0, decided, 7)
    return decision


@pytest.mark.parametrize("calm", [True, False])
@pytest.mark.parametrize("scenarios", [1, 2, 4, 7])
def test_decisions_are_what_the_networks_say(calm: bool, scenarios: int) -> None:
    rng = np.random.default_rng(scenarios)
    config = genome_config(calm=calm)
    arrays = pack([*random_genomes(150, scenarios, config), overflowing(config)], INPUTS)
    stems, told = rng.normal(size=(30, STEM)), rng.normal(size=(scenarios, TOLD))
    plant = rng.integers(-1, 30, (len(arrays), scenarios))
    found, wanted = decisions(arrays, stems, told, plant), expected(arrays, stems, told, plant)
    assert np.array_equal(found, wanted)
    assert {0, 1, NO_DECISION} <= set(wanted.ravel().tolist())


def test_close_to_the_middle_rounding_decides_as_in_the_sigmoid() -> None:
    """C is 0.5 exactly, and so left, for all that is positive but too small to tell."""
    config = genome_config(calm=True)
    (genome,) = random_genomes(1, 1, config, mutations=0)
    genome.connections.clear()
    arrays = pack([genome], INPUTS)
    stems, told, plant = np.zeros((1, STEM)), np.zeros((1, TOLD)), np.zeros((1, 1), dtype=np.int64)
    seen = set()
    for exponent in range(-24, 1):
        for sign in (-1.0, 1.0):
            near = replace(arrays, bias=np.full_like(arrays.bias, sign * 10.0**exponent))
            found = decisions(near, stems, told, plant)
            assert np.array_equal(found, expected(near, stems, told, plant))
            seen.add((sign, int(found[0, 0])))
    assert seen == {(-1.0, 0), (1.0, 0), (1.0, 1)}
