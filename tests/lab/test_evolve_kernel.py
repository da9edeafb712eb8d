"""Whole generations in one compiled loop: the plain reference's episodes, to the bit, and no plant simulated twice."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evolve_genomes import INPUTS, genome_config, overflowing, random_genomes
from evolve_reference import OUTCOMES, controller_of, run_episodes, same
from evolve_simulators import SHOWN, learned, mechanistic
from neat.nn import FeedForwardNetwork
from simulator_fakes import StraightPlant

from flora_common.errors import BadInput
from flora_common.runs import LampsSection
from flora_lab.evolve.controllers import FromFile
from flora_lab.evolve.episode import COLLISION, NO_ANSWER, TIME, Outcomes
from flora_lab.evolve.evaluate import TYPICAL, evaluate
from flora_lab.evolve.genome_arrays import pack
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.task import LEFT, MIDDLE, Task
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.growing import GrowingSimulator
from flora_lab.simulator.individual import Prior
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.tropism_traits import prior_mean, prior_spread

HOURS = 12.0


def reference(
    genomes: list[Any], config: Any, simulator: GrowingSimulator, task: Task, individuals: Individuals = TYPICAL
) -> Outcomes:
    networks = [FeedForwardNetwork.create(genome, config) for genome in genomes]
    controllers = [FromFile(controller_of(network, task)) for network in networks]
    return run_episodes(controllers, simulator, task, individuals.seeds())


@pytest.mark.parametrize("make", [mechanistic, learned])
@pytest.mark.parametrize(("task", "calm", "steering"), [(LEFT, True, True), (MIDDLE, False, False)])
def test_episodes_are_those_of_the_plain_reference(make: Any, task: Task, calm: bool, steering: bool) -> None:
    # an obstacle that some meet within these hours, and that costs them
    low = tuple(replace(one, obstacle=replace(one.obstacle, y_cm=8.3)) for one in task.scenarios)
    short, config = replace(task, scenarios=low, hours=HOURS, collision_at_most=-0.5), genome_config(calm=calm)
    genomes = random_genomes(12, 5, config, steering=steering)
    simulator = make()
    wanted = reference(genomes, config, simulator, short)
    found = evaluate(pack(genomes, INPUTS), simulator, short)
    assert same(found.outcomes, wanted)
    alone = evaluate(pack(genomes, INPUTS), simulator, short, share=False)
    assert same(alone.outcomes, wanted)
    assert (wanted.reason == COLLISION).any()
    assert found.steps_run < alone.steps_run == found.episode_steps == int(wanted.steps.sum())
    if steering:
        assert 0.02 < wanted.is_right.mean() < 0.98


def test_no_plant_is_simulated_twice() -> None:
    config = genome_config(calm=True)
    genomes = random_genomes(20, 8, config, steering=True)
    short = replace(LEFT, hours=HOURS)
    found = evaluate(pack(genomes, INPUTS), mechanistic(), short)
    right, steps = found.outcomes.is_right.reshape(-1, short.most_steps), found.outcomes.steps.ravel()
    prefixes = {right[i, : k + 1].tobytes() for i in range(len(right)) for k in range(steps[i])}
    assert found.steps_run == len(prefixes)


def test_results_do_not_depend_on_the_company() -> None:
    config = genome_config(calm=True)
    genomes = random_genomes(9, 2, config, steering=True)
    short, simulator = replace(MIDDLE, hours=HOURS), mechanistic()
    whole = evaluate(pack(genomes, INPUTS), simulator, short).outcomes
    for i in (0, 4, 8):
        alone = evaluate(pack([genomes[i]], INPUTS), simulator, short).outcomes
        assert same(alone, Outcomes(*(part[i : i + 1] for part in parts(whole))))


def parts(outcomes: Outcomes) -> tuple[Any, ...]:
    return tuple(getattr(outcomes, name) for name in OUTCOMES)


@pytest.mark.parametrize("make", [mechanistic, learned])
def test_drawn_plants_are_those_of_the_plain_reference(make: Any) -> None:
    config, simulator, short = genome_config(calm=True), make(), replace(LEFT, hours=HOURS)
    genomes, plants = random_genomes(6, 7, config, steering=True), Individuals(3, seed=5)
    wanted = reference(genomes, config, simulator, short, plants)
    found = evaluate(pack(genomes, INPUTS), simulator, short, plants)
    assert same(found.outcomes, wanted)
    assert found.steps_run < found.episode_steps
    assert same(evaluate(pack(genomes, INPUTS), simulator, short, plants, share=False).outcomes, wanted)
    assert len(np.unique(wanted.tip_cm[0, 0], axis=0)) == 3
    assert plants.judged(found.outcomes.fitness).shape == (6, 4)


def test_more_plants_of_a_seed_are_the_same_ones_and_some_more() -> None:
    genomes, short = pack(random_genomes(3, 4, genome_config()), INPUTS), replace(MIDDLE, hours=HOURS)
    two, three = (evaluate(genomes, mechanistic(), short, Individuals(count)).outcomes for count in (2, 3))
    assert same(two, Outcomes(*(part[:, :, :2] for part in parts(three))))


@pytest.mark.parametrize("threads", [2, 3, 40])
def test_results_do_not_depend_on_threads(threads: int) -> None:
    genomes = pack(random_genomes(17, 3, genome_config(calm=True), steering=True), INPUTS)
    short = replace(LEFT, hours=HOURS)
    for plants in (Individuals(), Individuals(2)):
        one = evaluate(genomes, mechanistic(), short, plants)
        several = evaluate(genomes, mechanistic(), short, plants, threads=threads)
        assert same(several.outcomes, one.outcomes)
        assert several.steps_run == one.steps_run
        each = evaluate(genomes, mechanistic(), short, plants, share=False, threads=threads)
        assert each.steps_run == one.episode_steps > one.steps_run
    with pytest.raises(ValueError, match="0 threads"):
        evaluate(genomes, mechanistic(), short, threads=0)


def test_scenarios_beyond_those_that_are_decided_side_by_side_count_as_well() -> None:
    genomes = random_genomes(5, 6, genome_config(calm=True), steering=True)
    short = replace(LEFT, hours=HOURS)
    many = replace(short, scenarios=tuple(replace(s, name=f"{n}") for n, s in enumerate(3 * LEFT.scenarios)))
    found = evaluate(pack(genomes, INPUTS), mechanistic(), many)
    few = evaluate(pack(genomes, INPUTS), mechanistic(), short)
    assert same(found.outcomes, Outcomes(*(np.concatenate([part] * 3, axis=1) for part in parts(few.outcomes))))
    assert found.steps_run == few.steps_run


def test_a_generation_of_nobody_is_no_trouble() -> None:
    found = evaluate(pack([], INPUTS), mechanistic(), LEFT)
    assert found.outcomes.fitness.shape == (0, 4, 1)
    assert found.steps_run == found.episode_steps == 0


def test_a_second_process_compiles_nothing() -> None:
    """Methods of plants are found in numba's cache too: what an evolution's processes would otherwise wait for."""
    program = """
import sys
sys.path.insert(0, sys.argv[1])
from evolve_genomes import genome_config, random_genomes
from evolve_simulators import learned, mechanistic, paper
from flora_lab.evolve.evaluate import TYPICAL, evaluate
from flora_lab.evolve.genome_arrays import pack
from flora_lab.evolve.shared_kernel import run_shared
from flora_lab.evolve.task import MIDDLE
for simulator in (mechanistic(), learned(), paper(), paper(stateful=True)):
    evaluate(pack(random_genomes(1, 1, genome_config()), 26), simulator, MIDDLE)
print(sum(run_shared.stats.cache_misses.values()), sum(run_shared.stats.cache_hits.values()))
"""
    here = str(Path(__file__).parent)
    told = [
        subprocess.run([sys.executable, "-c", program, here], capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    ]
    assert told[1].split() == ["0", "4"]


def test_each_way_to_end_is_met() -> None:
    config = genome_config()
    genomes = [*random_genomes(20, 1, config), overflowing(config)]
    found = evaluate(pack(genomes, INPUTS), mechanistic(), replace(LEFT, hours=40.0))
    met = set(found.outcomes.reason.ravel().tolist())
    assert {COLLISION, TIME, NO_ANSWER} <= met
    lost = found.outcomes.reason == NO_ANSWER
    assert lost[-1].all()
    assert (found.outcomes.fitness[lost] <= 0.0).all()


def test_a_simulator_that_leaves_the_numbers_is_told() -> None:
    simulator = RodSimulator(
        LampsSection(), Prior(np.full_like(prior_mean(), np.nan), prior_spread()), DriveNoise(), SHOWN
    )
    with pytest.raises(BadInput, match="a stem that is not finite, task left"):
        evaluate(pack(random_genomes(2, 1, genome_config()), INPUTS), simulator, LEFT)


def test_a_simulator_without_compiled_plants_is_refused() -> None:
    with pytest.raises(BadInput, match="a simulator of kind `straight` has no compiled plants; choose another one"):
        evaluate(pack(random_genomes(2, 1, genome_config()), INPUTS), StraightPlant(), LEFT)
