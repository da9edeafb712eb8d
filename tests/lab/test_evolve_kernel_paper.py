"""The paper's simulator in the compiled loop: steps against torch and numpy, whole episodes against the reference."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from evolve_courses import courses
from evolve_genomes import INPUTS, genome_config, random_genomes
from evolve_reference import OUTCOMES, controller_of, run_episodes
from evolve_simulators import paper
from neat.nn import FeedForwardNetwork

from flora_common.errors import BadInput
from flora_lab.evolve import lstm_tiles
from flora_lab.evolve.controllers import FromFile
from flora_lab.evolve.episode import Course, Outcomes, run_episode
from flora_lab.evolve.evaluate import evaluate
from flora_lab.evolve.genome_arrays import pack
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.plants_kinds import plants_of
from flora_lab.evolve.task import LEFT, MIDDLE, straight_stem
from flora_lab.simulator.fast_product import LANES
from flora_lab.simulator.paper import CELLS
from flora_lab.simulator.rod import jit

torch.set_num_threads(1)

STEP_TOLERANCE_CM = 1e-4
"""Rounding of float32 in one step; the simulator's unit is 65 cm, of which float32 tells 4e-6 cm."""
COURSE_TOLERANCE_CM = 1e-3
"""And in a course, in which errors of earlier steps live on."""
DOUBT = 1e-3
"""How near to 0.5 C is where rounding of the stem may decide."""


def light_of(is_right: Any) -> Any:
    return np.stack([~is_right, is_right], axis=-1).astype(np.float64)


@pytest.mark.parametrize("stateful", [False, True])
@pytest.mark.parametrize("step_s", [300.0, 150.0])
def test_a_course_is_that_of_the_simulator(stateful: bool, step_s: float) -> None:
    simulator = paper(stateful=stateful, step_s=step_s)
    is_right = np.random.default_rng(1).random((40, LANES + 5)) < 0.5
    found = courses(simulator, is_right)
    state = simulator.start(np.repeat(LEFT.start_stem_cm[None], is_right.shape[1], axis=0))
    for k, now in enumerate(is_right):
        state, stems = simulator.step(state, light_of(now), 300.0)
        assert np.abs(found[k] - stems).max() < (STEP_TOLERANCE_CM if k == 0 else COURSE_TOLERANCE_CM)
    assert np.ptp(found[-1], axis=0).max() > 0.1  # lamps matter


@pytest.mark.parametrize("stateful", [False, True])
def test_a_course_is_that_of_torchs_lstm(stateful: bool) -> None:
    simulator = paper(stateful=stateful)
    cell, dense = simulator.network.cell, simulator.network.dense
    lstm = torch.nn.LSTM(cell.inputs, CELLS)
    values = {"weight_ih_l0": cell.w_ih, "weight_hh_l0": cell.w_hh, "bias_ih_l0": cell.b, "bias_hh_l0": 0.0 * cell.b}
    lstm.load_state_dict({name: torch.from_numpy(value) for name, value in values.items()})
    is_right = np.random.default_rng(2).random((30, 7)) < 0.5
    found = courses(simulator, is_right)
    points = torch.from_numpy(np.repeat(simulator.start(LEFT.start_stem_cm[None]).points, 7, axis=0))
    memory = None
    with torch.no_grad():
        for k, now in enumerate(is_right):
            told = torch.cat([points, torch.from_numpy(now[:, None].astype(np.float32))], dim=1)
            hidden, after = lstm(told[None], memory)
            memory = after if stateful else None
            points = hidden[0] @ torch.from_numpy(dense.w.T) + torch.from_numpy(dense.b)
            stems = points.numpy().reshape(7, 9, 2) * simulator.unit_cm
            assert np.abs(found[k, :, 1:] - stems).max() < COURSE_TOLERANCE_CM


@pytest.mark.parametrize("stateful", [False, True])
def test_a_plant_is_the_same_to_the_last_bit_in_any_row(stateful: bool) -> None:
    simulator = paper(stateful=stateful)
    one = np.random.default_rng(3).random((25, 1)) < 0.5
    alone = courses(simulator, one)
    others = np.random.default_rng(4).random((25, 2 * LANES + 3)) < 0.5
    for row in (0, 1, LANES - 1, LANES, 2 * LANES + 2):
        company = others.copy()
        company[:, [row]] = one
        assert courses(simulator, company)[:, row].tobytes() == alone[:, 0].tobytes()


def test_a_plant_takes_its_past_along_to_another_row() -> None:
    for simulator in (paper(), paper(stateful=True)):
        plants = plants_of(simulator, LEFT, None, LANES + 2)
        moved, stayed = np.empty((10, 2)), np.empty((10, 2))
        there_and_back(plants, LANES + 1, moved, stayed)
        assert moved.tobytes() == stayed.tobytes()
        assert not np.array_equal(moved, LEFT.start_stem_cm)


@jit
def there_and_back(plants: Any, row: int, moved: Any, stayed: Any) -> None:
    is_right = np.ones(row + 1, dtype=np.bool_)
    plants.advance(1, is_right, 0)
    plants.copy_rows(np.zeros(row, dtype=np.int64), np.arange(1, row + 1), row)
    plants.advance(row + 1, is_right, 1)
    stems = np.empty((row + 1, *moved.shape))
    plants.points(row + 1, stems)
    moved[:], stayed[:] = stems[row], stems[0]


def test_a_product_of_a_tile_is_that_of_a_plain_loop_to_the_bit() -> None:
    rng = np.random.default_rng(6)
    rows, columns, first, tile_row = 8, 5, 4, 2
    weights, b = (rng.standard_normal(size).astype(np.float32) for size in ((16, columns), 16))
    tile, out = lstm_tiles.tiles(1, tile_row + columns)[0], lstm_tiles.tiles(1, rows + 1)[0]
    tile[:], out[:] = rng.standard_normal(len(tile)), np.nan
    lstm_tiles.product(weights.ravel(), b, first, rows, columns, tile, tile_row, out)
    found = out.reshape(-1, LANES)
    expected = np.repeat(b[first : first + rows, None], LANES, axis=1)
    for k in range(columns):  # each product rounded before it is added, in the order of the columns
        expected = expected + weights[first : first + rows, [k]] * tile.reshape(-1, LANES)[tile_row + k]
    assert expected.dtype == np.float32
    assert found[:rows].tobytes() == expected.tobytes()
    assert np.isnan(found[rows]).all()


def test_a_hyperbolic_tangent_in_parts_keeps_its_accuracy() -> None:
    gates = lstm_tiles.tiles(1, 3)[0]
    values = np.linspace(-12.0, 12.0, LANES, dtype=np.float32)
    hidden = lstm_tiles.tiles(1, 1)[0]
    for i, g, o in np.random.default_rng(5).permuted(np.tile(values, (200, 3)), axis=1).reshape(200, 3, LANES):
        gates[:] = np.concatenate([i, g, o])
        lstm_tiles.hidden_from_zero(1, gates, hidden)
        exact = [part.astype(np.float64) for part in (i, g, o)]
        c = (0.5 + 0.5 * np.tanh(exact[0])) * np.tanh(exact[1])
        assert np.abs(hidden - (0.5 + 0.5 * np.tanh(exact[2])) * np.tanh(c)).max() < 1.5e-6


def reference(genomes: list[Any], config: Any) -> list[FromFile]:
    return [FromFile(controller_of(FeedForwardNetwork.create(genome, config), LEFT)) for genome in genomes]


@pytest.mark.parametrize("stateful", [False, True])
def test_decisions_are_those_of_the_reference_wherever_rounding_does_not_decide(stateful: bool) -> None:
    """In whole episodes of drawn networks; each difference is told to be one of rounding, or the test fails."""
    config, task = genome_config(), replace(LEFT, hours=24.0)
    genomes = random_genomes(25, 11, config, steering=True)
    simulator, controllers = paper(stateful=stateful, seed=8), reference(genomes, config)
    wanted, found = (
        run_episodes(controllers, simulator, task),
        evaluate(pack(genomes, INPUTS), simulator, task).outcomes,
    )
    is_same = (found.is_right == wanted.is_right).all(axis=-1) & (found.reason == wanted.reason)
    for g, s, _ in np.argwhere(~is_same):
        course = run_episode(controllers[g], simulator, task, task.scenarios[s])
        assert is_doubtful(course, found, g, s, task.stop_height_cm)
    assert (~is_same).mean() < 0.03
    assert np.array_equal(found.steps[is_same], wanted.steps[is_same])
    assert np.abs(found.tip_cm - wanted.tip_cm)[is_same].max() < COURSE_TOLERANCE_CM
    assert np.abs(found.fitness - wanted.fitness)[is_same].max() < COURSE_TOLERANCE_CM
    assert 0.02 < wanted.is_right.mean() < 0.98
    assert len(np.unique(wanted.reason)) > 1


def is_doubtful(course: Course, found: Outcomes, g: int, s: int, stop_height_cm: float) -> bool:
    """Whether the reference was about to decide otherwise where the other parted from it."""
    steps = min(course.steps, int(found.steps[g, s, 0]))
    other = np.flatnonzero(found.is_right[g, s, 0, :steps] != course.is_right[:steps])
    if len(other):
        return abs(float(course.outputs[other[0]]) - 0.5) < DOUBT
    tip_y_cm = float(course.stems_cm[steps, -1, 1])
    return course.clearance_cm < COURSE_TOLERANCE_CM or abs(tip_y_cm - stop_height_cm) < COURSE_TOLERANCE_CM


@pytest.mark.parametrize("stateful", [False, True])
def test_sharing_threads_and_company_change_nothing(stateful: bool) -> None:
    simulator, task = paper(stateful=stateful, seed=8), replace(LEFT, hours=24.0)
    genomes = random_genomes(40, 12, genome_config(calm=True), steering=True)
    found = evaluate(pack(genomes, INPUTS), simulator, task)
    assert found.steps_run < found.episode_steps
    for other in (
        evaluate(pack(genomes, INPUTS), simulator, task, share=False),
        evaluate(pack(genomes, INPUTS), simulator, task, threads=3),
    ):
        for name in OUTCOMES:
            assert getattr(other.outcomes, name).tobytes() == getattr(found.outcomes, name).tobytes()
    alone = evaluate(pack([genomes[17]], INPUTS), simulator, task).outcomes
    assert alone.tip_cm.tobytes() == found.outcomes.tip_cm[17:18].tobytes()


def test_the_papers_simulator_has_no_individuals() -> None:
    genomes = pack(random_genomes(2, 1, genome_config()), INPUTS)
    with pytest.raises(BadInput, match="a simulator of kind `paper` has no individuals; leave --individuals out"):
        evaluate(genomes, paper(), MIDDLE, Individuals(2))


def test_a_step_that_makes_no_five_minutes_is_refused() -> None:
    genomes = pack(random_genomes(2, 1, genome_config()), INPUTS)
    with pytest.raises(BadInput, match="a step of 300 s; this simulator knows multiples of 200 s only"):
        evaluate(genomes, paper(step_s=200.0), MIDDLE)


def test_an_episode_starts_from_the_tasks_stem() -> None:
    task = replace(MIDDLE, start_cm=straight_stem(9.0, 1.5), stop_height_cm=8.0)
    found = evaluate(pack(random_genomes(1, 1, genome_config()), INPUTS), paper(), task).outcomes
    assert found.steps.max() == 0
    assert np.allclose(found.tip_cm, [1.5, 9.0], atol=STEP_TOLERANCE_CM)
    assert math.isfinite(found.fitness.sum())
