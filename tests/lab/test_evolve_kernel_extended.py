"""Extended simulators in the compiled loop: the plain reference's episodes, to the bit, with every term at work."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from evolve_genomes import INPUTS, genome_config, random_genomes
from evolve_reference import controller_of, run_episodes, same
from evolve_simulators import extended, mechanistic
from neat.nn import FeedForwardNetwork

from flora_lab.evolve.controllers import FromFile
from flora_lab.evolve.episode import COLLISION
from flora_lab.evolve.evaluate import TYPICAL, evaluate
from flora_lab.evolve.genome_arrays import pack
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.plants_extended import ExtendedPlants
from flora_lab.evolve.plants_kinds import plants_of
from flora_lab.evolve.plants_tropism import TropismPlants
from flora_lab.evolve.task import LEFT, MIDDLE, Task
from flora_lab.simulator.store import Extension
from flora_lab.simulator.terms import NEUTRAL, ExtendedLaw

HOURS = 12.0


@pytest.mark.parametrize("individuals", [TYPICAL, Individuals(3, seed=5)])
@pytest.mark.parametrize(("task", "calm", "steering"), [(LEFT, True, True), (MIDDLE, False, False)])
def test_episodes_are_those_of_the_plain_reference(
    task: Task, calm: bool, steering: bool, individuals: Individuals
) -> None:
    # an obstacle that some meet within these hours
    low = tuple(replace(one, obstacle=replace(one.obstacle, y_cm=8.3)) for one in task.scenarios)
    short, config = replace(task, scenarios=low, hours=HOURS, collision_at_most=-0.5), genome_config(calm=calm)
    genomes, simulator = random_genomes(8, 5, config, steering=steering), extended()
    controllers = [FromFile(controller_of(FeedForwardNetwork.create(one, config), short)) for one in genomes]
    wanted = run_episodes(controllers, simulator, short, individuals.seeds())
    for options in ({}, {"share": False}, {"threads": 2}):
        found = evaluate(pack(genomes, INPUTS), simulator, short, individuals, **options)
        assert same(found.outcomes, wanted)
    assert (wanted.reason == COLLISION).any()
    plain = evaluate(pack(genomes, INPUTS), mechanistic(), short, individuals).outcomes
    assert np.abs(plain.tip_cm - wanted.tip_cm).max(axis=(0, 1, 3)).min() > 0.3  # every plant is another one


def test_neutral_terms_cost_no_bit() -> None:
    simulator = mechanistic()
    simulator.law = ExtendedLaw(simulator.lamps, NEUTRAL)
    genomes, short = pack(random_genomes(6, 5, genome_config(), steering=True), INPUTS), replace(LEFT, hours=HOURS)
    assert isinstance(plants_of(simulator, short, None, 1), ExtendedPlants)
    assert same(evaluate(genomes, simulator, short).outcomes, evaluate(genomes, mechanistic(), short).outcomes)


def test_what_only_changes_constants_takes_the_plain_plants() -> None:
    stronger = mechanistic().extended([Extension("gravitropism", {"factor": 1.5})])
    assert isinstance(plants_of(stronger, LEFT, None, 1), TropismPlants)
    assert isinstance(plants_of(extended(), LEFT, 3, 1), ExtendedPlants)
