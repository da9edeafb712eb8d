"""The paper's simulator with its clock set right and a memory beside it: as a plant, on the disk, in compiled loops."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evolve_courses import courses
from evolve_simulators import paper
from simulator_contract import check_contract
from simulator_fakes import straight_run

from flora_common.errors import BadInput
from flora_lab.evolve.plants_kinds import plants_of
from flora_lab.evolve.task import LEFT
from flora_lab.simulator.interface import History, run
from flora_lab.simulator.load import load
from flora_lab.simulator.measured import MeasuredRun
from flora_lab.simulator.remembering import FEATURES, TRACES_H, RememberingSimulator
from flora_lab.simulator.store import Extension, Provenance, write_simulator

FACTOR = 4.0
STEPS = 60


def bending(speed_cm: float = 0.05) -> Any:
    """A memory that grows, and bends to where the lamps were in the last hours; more so the higher it is."""
    memory = np.zeros((18, FEATURES))
    along = np.linspace(0.1, 1.0, 9)
    memory[1::2, 0] = 0.03 * along
    memory[0::2, -1 - len(TRACES_H)] = speed_cm * along
    memory[0::2, -2] = 0.1 * speed_cm * along
    return memory


def mended(memory: Any = None, factor: float = FACTOR) -> RememberingSimulator:
    return RememberingSimulator(paper(), factor, bending() if memory is None else memory)


@pytest.fixture(scope="module")
def measured() -> list[MeasuredRun]:
    return [straight_run(f"bean{i}", hours=8.0, growth_cm_h=0.1 + 0.01 * i, lamps_h=1.0 + i) for i in range(4)]


def test_it_keeps_what_simulated_plants_promise(measured: list[MeasuredRun]) -> None:
    # nothing keeps the network's stems from getting shorter
    check_contract(mended(), measured, start_cm=1e-9, watch_cm=1e-9, shrink_cm=np.inf, merged_cm=1e-9, hours=12.0)


def test_without_memory_it_is_the_network_that_many_times_slower() -> None:
    network = paper()
    slow = mended(np.zeros((18, FEATURES)))
    stem, light = LEFT.start_stem_cm[None], np.array([[0.0, 1.0]])
    fast = network.step(network.start(stem), light, 300.0)[1]
    found = slow.step(slow.start(stem), light, 300.0)[1]
    assert found == pytest.approx(stem + (fast - stem) / FACTOR, abs=1e-6)
    assert np.abs(found - stem).max() > 0.01


def test_it_remembers_the_lamps_and_nothing_else(measured: list[MeasuredRun]) -> None:
    plant, seen = mended(), measured[0]
    points, right = seen.points_cm[:37, None], np.zeros((36, 1, 2))
    right[..., 1] = 1.0
    left = right[..., ::-1]
    after = np.repeat(left[:1], 12, axis=0)
    tips = {}
    for name, lamps in (("right", right), ("left", left)):
        state = plant.watch(History(points, lamps, 300.0, {}))
        tips[name] = run(plant, state, after, 300.0)[:, 0, -1, 0]
    assert (tips["right"] > tips["left"] + 0.01).all()
    # what was before the stem is nothing to it
    moved = points.copy()
    moved[:-1] += 0.5
    a, b = (plant.watch(History(p, right, 300.0, {})) for p in (points, moved))
    assert a.stems.tobytes() == b.stems.tobytes()
    assert a.traces.tobytes() == b.traces.tobytes()
    # a lamp that is told to have shone for long has filled the traces
    assert plant.start(points[-1], before=np.array([[0.0, 1.0]])).traces.tolist() == [[1.0] * len(TRACES_H)]


def written(path: Path, plant: RememberingSimulator, **scales: Any) -> Path:
    write_simulator(
        path,
        kind=plant.kind,
        step_s=plant.step_s,
        weights=plant.weights(),
        scales={**plant.scales(), **scales},
        provenance=Provenance(recipe="test", seed=0, software="test"),
        extensions=[Extension("time_scale", {"factor": plant.factor}), Extension("memory", {"time_constant_h": 1.0})],
    )
    return path


def test_read_again_it_is_the_same_plant(tmp_path: Path, measured: list[MeasuredRun]) -> None:
    plant = mended()
    again = load(written(tmp_path / "mended.simulator", plant))
    stems, light = measured[0].points_cm[:1], measured[0].light[:STEPS, None]
    found, expected = (run(one, one.start(stems), light, 300.0) for one in (again, plant))
    assert found.tobytes() == expected.tobytes()


def test_a_clock_that_can_be_none_is_told(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="time_scale_factor"):
        load(written(tmp_path / "still.simulator", mended(), time_scale_factor=0.0))


def test_controllers_are_evolved_in_the_same_plant() -> None:
    plant = mended()
    is_right = np.random.default_rng(1).random((STEPS, 3)) < 0.5
    found = courses(plant, is_right)
    light = np.stack([~is_right, is_right], axis=-1).astype(np.float64)
    expected = run(plant, plant.start(np.repeat(LEFT.start_stem_cm[None], 3, axis=0)), light, 300.0)
    assert np.abs(found - expected).max() < 1e-3  # the network's float32
    assert np.ptp(expected[-1, :, -1, 0]) > 0.05  # lamps matter


def test_it_has_no_individuals() -> None:
    with pytest.raises(BadInput, match="individuals"):
        plants_of(mended(), LEFT, 3, 1)
