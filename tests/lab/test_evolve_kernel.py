"""Whole generations in one compiled loop: the plain reference's episodes, to the bit, and no plant simulated twice."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from evolve_genomes import INPUTS, genome_config, random_genomes
from neat.nn import FeedForwardNetwork

from flora_common.errors import BadInput
from flora_common.runs import LampsSection
from flora_lab.evolve.controllers import FromFile, controller_of
from flora_lab.evolve.episode import COLLISION, NO_ANSWER, TIME, Outcomes, run_episodes
from flora_lab.evolve.evaluate import evaluate
from flora_lab.evolve.genome_arrays import pack
from flora_lab.evolve.task import LEFT, MIDDLE, Task
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.growing import DataRange, GrowingSimulator
from flora_lab.simulator.individual import Prior
from flora_lab.simulator.neural_law import TRAITS, NeuralLaw, weight_shapes
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.sequence import SequenceSimulator
from flora_lab.simulator.tropism_traits import prior_mean, prior_spread

SHOWN = DataRange(30.0, 10.0)
HOURS = 12.0


def rod() -> GrowingSimulator:
    return RodSimulator(LampsSection(), Prior(prior_mean(), prior_spread()), DriveNoise(), SHOWN)


def learned() -> GrowingSimulator:
    """Random weights: no plant, but one that answers the lamps."""
    rng = np.random.default_rng(3)
    weights = {name: 0.4 * rng.normal(size=shape) for name, shape in weight_shapes(2, 8).items()}
    prior = Prior(np.full(len(TRAITS), 0.3), np.eye(len(TRAITS)))
    return SequenceSimulator(NeuralLaw(weights, 5.0), prior, DriveNoise(), SHOWN)


def same(one: Outcomes, other: Outcomes) -> bool:
    names = ("fitness", "reason", "steps", "tip_cm", "is_right")
    return all(np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True) for name in names)


def reference(genomes: list[Any], config: Any, simulator: GrowingSimulator, task: Task) -> Outcomes:
    networks = [FeedForwardNetwork.create(genome, config) for genome in genomes]
    return run_episodes([FromFile(controller_of(network, task)) for network in networks], simulator, task)


@pytest.mark.parametrize("make", [rod, learned], ids=["mechanistic", "learned"])
@pytest.mark.parametrize(("task", "calm", "steering"), [(LEFT, True, True), (MIDDLE, False, False)])
def test_episodes_are_those_of_the_plain_reference(make: Any, task: Task, calm: bool, steering: bool) -> None:
    short, config = replace(task, hours=HOURS), genome_config(calm=calm)
    genomes = random_genomes(12, 5, config, steering=steering)
    simulator = make()
    wanted = reference(genomes, config, simulator, short)
    found = evaluate(pack(genomes, INPUTS), simulator, short)
    assert same(found.outcomes, wanted)
    alone = evaluate(pack(genomes, INPUTS), simulator, short, share=False)
    assert same(alone.outcomes, wanted)
    assert found.steps_run < alone.steps_run == int(wanted.steps.sum())
    if steering:
        assert 0.02 < wanted.is_right.mean() < 0.98


def test_no_plant_is_simulated_twice() -> None:
    config = genome_config(calm=True)
    genomes = random_genomes(20, 8, config, steering=True)
    short = replace(LEFT, hours=HOURS)
    found = evaluate(pack(genomes, INPUTS), rod(), short)
    right, steps = found.outcomes.is_right.reshape(-1, short.most_steps), found.outcomes.steps.ravel()
    prefixes = {right[i, : k + 1].tobytes() for i in range(len(right)) for k in range(steps[i])}
    assert found.steps_run == len(prefixes)


def test_results_do_not_depend_on_the_company() -> None:
    config = genome_config(calm=True)
    genomes = random_genomes(9, 2, config, steering=True)
    short, simulator = replace(MIDDLE, hours=HOURS), rod()
    whole = evaluate(pack(genomes, INPUTS), simulator, short).outcomes
    for i in (0, 4, 8):
        alone = evaluate(pack([genomes[i]], INPUTS), simulator, short).outcomes
        assert same(alone, Outcomes(*(part[i : i + 1] for part in parts(whole))))


def parts(outcomes: Outcomes) -> tuple[Any, ...]:
    return (outcomes.fitness, outcomes.reason, outcomes.steps, outcomes.tip_cm, outcomes.is_right)


def test_each_way_to_end_is_met() -> None:
    config = genome_config()
    genomes = [*random_genomes(20, 1, config), overflowing(config)]
    found = evaluate(pack(genomes, INPUTS), rod(), replace(LEFT, hours=40.0))
    met = set(found.outcomes.reason.ravel().tolist())
    assert {COLLISION, TIME, NO_ANSWER} <= met
    lost = found.outcomes.reason == NO_ANSWER
    assert lost[-1].all()
    assert (found.outcomes.fitness[lost] <= 0.0).all()


def overflowing(config: Any) -> Any:
    """Five nodes in a row, each the cube of the one before: beyond all numbers."""
    (genome,) = random_genomes(1, 1, config, mutations=0)
    genome.connections.clear()
    keys = [-1, 101, 102, 103, 104, 105, 0]
    for number, (source, target) in enumerate(pairwise(keys)):
        if target:
            genome.nodes[target] = genome.create_node(config.genome_config, target)
        genome.nodes[target].activation, genome.nodes[target].aggregation = "cube", "sum"
        genome.nodes[target].bias = genome.nodes[target].response = 30.0
        gene = genome.create_connection(config.genome_config, source, target, 20_000 + number)
        gene.weight, gene.enabled = 30.0, True
        genome.connections[source, target] = gene
    return genome


def test_a_simulator_that_leaves_the_numbers_is_told() -> None:
    simulator = RodSimulator(
        LampsSection(), Prior(np.full_like(prior_mean(), np.nan), prior_spread()), DriveNoise(), SHOWN
    )
    with pytest.raises(BadInput, match="a stem that is not finite, task left"):
        evaluate(pack(random_genomes(2, 1, genome_config()), INPUTS), simulator, LEFT)
