"""A drawn plant of a simulator of several members follows one of them, or their mean; so does the compiled one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evolution_examples import TASK, contents, write_rod
from evolve_genomes import INPUTS, genome_config, random_genomes
from evolve_reference import OUTCOMES, controller_of, run_episodes
from evolve_simulators import learned
from neat.nn import FeedForwardNetwork

from flora_common.arrays import FloatArray
from flora_common.controller_file import load_controller
from flora_lab.evolve.controllers import FromFile
from flora_lab.evolve.evaluate import evaluate
from flora_lab.evolve.evolution_folder import read_evolution
from flora_lab.evolve.evolution_writing import write_evolution
from flora_lab.evolve.genome_arrays import pack
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.neat_settings import load_settings
from flora_lab.evolve.one_run import RunState, advance, first_state
from flora_lab.evolve.plan import Plan, parcel_of
from flora_lab.evolve.plants_kinds import plants_of
from flora_lab.evolve.plants_neural import NeuralPlants
from flora_lab.evolve.task import LEFT
from flora_lab.simulator import sequence
from flora_lab.simulator.growing import GrowingState
from flora_lab.simulator.interface import Chance, run
from flora_lab.simulator.neural_law import NeuralLaw, weight_shapes
from flora_lab.simulator.sequence import MEAN, SequenceSimulator
from flora_lab.simulator.store import Provenance, write_simulator

MEMBERS = 4
SHORT = replace(LEFT, hours=12.0)
LIGHT = np.array([(1.0, 0.0), (0.0, 1.0), (0.0, 1.0), (1.0, 0.0)] * 9)


def of_members(count: int) -> SequenceSimulator:
    """Random weights."""
    rng = np.random.default_rng(8)
    weights = {name: 0.4 * rng.normal(size=shape) for name, shape in weight_shapes(count, 8).items()}
    like = learned()
    return SequenceSimulator(NeuralLaw(weights, 5.0), like.prior, like.noise, like.shown)


def started(simulator: SequenceSimulator, seeds: list[int]) -> GrowingState:
    stems = np.repeat(SHORT.start_stem_cm[None], len(seeds), axis=0)
    return simulator.start(stems, Chance(np.array(seeds)))


def grown(simulator: SequenceSimulator, state: GrowingState) -> FloatArray:
    """Shape (steps, batch, 10, 2)."""
    return run(simulator, state, np.repeat(LIGHT[:, None], len(state.traits), axis=1), 300.0)


def test_a_drawn_plant_is_that_of_the_member_that_it_follows() -> None:
    simulator, seeds = of_members(MEMBERS), list(range(30))
    state = started(simulator, seeds)
    assert state.member is not None
    assert set(state.member.tolist()) == {MEAN, *range(MEMBERS)}
    stems = grown(simulator, state)
    mean = grown(simulator, replace(state, member=None))
    alone = [grown(member, started(member, seeds)) for member in simulator.members()]
    for plant, member in enumerate(state.member.tolist()):
        wanted = mean if member == MEAN else alone[member]
        assert stems[:, plant].tobytes() == wanted[:, plant].tobytes()
    assert np.abs(stems[-1] - mean[-1]).max(axis=(1, 2))[state.member != MEAN].min() > 1e-3


def test_each_is_drawn_as_often() -> None:
    drawn = started(of_members(MEMBERS), list(range(2000))).member
    assert drawn is not None
    counts = np.bincount(drawn - MEAN)
    assert len(counts) == MEMBERS + 1
    assert np.abs(counts - 400).max() < 4 * np.sqrt(400)


def test_a_single_member_is_followed_as_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    single = of_members(1)
    state = started(single, [3, 4])
    assert state.member is None
    monkeypatch.setattr(sequence, "_MEMBER", 99)
    assert grown(single, started(single, [3, 4])).tobytes() == grown(single, state).tobytes()
    assert single.members() == []


def test_the_typical_plant_is_the_mean_of_all() -> None:
    assert of_members(MEMBERS).start(SHORT.start_stem_cm[None]).member is None


@pytest.mark.parametrize("members", [1, MEMBERS])
def test_compiled_plants_follow_the_same_members(members: int) -> None:
    simulator, individuals = of_members(members), Individuals(8, seed=0)
    seeds = individuals.seeds()
    assert seeds is not None
    drawn = [None if (m := started(simulator, [seed]).member) is None else int(m[0]) for seed in seeds]
    assert set(drawn) == ({None} if members == 1 else {MEAN, *range(MEMBERS)})
    config = genome_config(calm=True)
    genomes = random_genomes(4, 7, config, steering=True)
    controllers = [FromFile(controller_of(FeedForwardNetwork.create(one, config), SHORT)) for one in genomes]
    wanted = run_episodes(controllers, simulator, SHORT, seeds)
    for options in ({}, {"share": False}):
        found = evaluate(pack(genomes, INPUTS), simulator, SHORT, individuals, **options).outcomes
        for name in OUTCOMES:
            assert np.array_equal(getattr(found, name), getattr(wanted, name), equal_nan=True), name
    for seed, member in zip(seeds, drawn, strict=True):
        plants = plants_of(simulator, SHORT, seed, 1)
        assert isinstance(plants, NeuralPlants)
        assert len(plants.weights.gates) == (members if member in (None, MEAN) else 1)


@pytest.mark.parametrize(("count", "members"), [(0, 0), (3, MEMBERS)])
def test_an_evolution_says_of_how_many_members_its_plants_are(count: int, members: int, tmp_path: Path) -> None:
    simulator = of_members(MEMBERS)
    write_simulator(
        tmp_path / "learned.simulator",
        kind=simulator.kind,
        step_s=simulator.step_s,
        weights=simulator.weights(),
        scales=simulator.scales(),
        provenance=Provenance("sequence", 1, "flora test", dataset_sha256="d" * 64),
    )
    settings, individuals = load_settings(population=6), Individuals(count)
    plan = Plan(parcel_of(tmp_path / "learned.simulator"), TASK, settings, individuals, 1, 1, 1)
    write_evolution(tmp_path / "e", plan, [straight(plan)], wall_s=1.0, force=False)
    assert read_evolution(tmp_path / "e").info.individuals.members == members
    provenance = load_controller(tmp_path / "e" / "best.controller.json").file.provenance
    assert (
        provenance.get("individuals_members", 0) == plan.members == plan.work.get("individuals' members", 0) == members
    )
    if count:
        other = replace(plan, parcel=parcel_of(write_rod(tmp_path / "rod.simulator")))
        write_evolution(tmp_path / "f", other, [straight(other)], wall_s=1.0, force=False)
        assert b"individuals_members" not in contents(tmp_path / "f")["best.controller.json"]
        assert "individuals' members" not in other.work


def straight(plan: Plan) -> RunState:
    return advance(plan, first_state(plan, 1), seconds=1e9, clock=lambda: 0.0)
