"""A simulator by the paper's recipe is mended: the memory that was hidden in measured runs is found again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from evolve_simulators import paper
from simulator_fakes import half_as_often
from test_simulator_remembering import bending

from flora_lab.diagnose import figures_of_learned, learned_told
from flora_lab.diagnose.diagnosis import NamedCause
from flora_lab.diagnose.mended_simulator import BASE, CLOCK, MEAN, MEMORY, NO_MEMORY, STILL, Mended, mended
from flora_lab.evolve.task import LEFT
from flora_lab.simulator import interface
from flora_lab.simulator.lstm_cell import Dense
from flora_lab.simulator.measured import MeasuredRun
from flora_lab.simulator.paper import CELLS, PaperNetwork, PaperSimulator
from flora_lab.simulator.remembering import FEATURES, RememberingSimulator

FACTOR = 50.0
ROWS = 24 * 12
NOISE_CM = 0.02


def idle() -> PaperSimulator:
    """A network that draws every stem towards the same upright one, so that only memory can bend it."""
    network = paper()
    upright = np.repeat(np.linspace(0.02, 0.2, 9), 2) * np.tile([0.0, 1.0], 9)
    still = PaperNetwork(network.network.cell, Dense.of(np.zeros((18, CELLS)), upright))
    return PaperSimulator(still, network.box, unit_cm=65.0, step_s=300.0)


def run_of(seed: int) -> MeasuredRun:
    """A plant that is the network, slowed down, and remembers its lamps; measured with errors, here and there not."""
    plant = RememberingSimulator(idle(), FACTOR, bending())
    draw = np.random.default_rng(seed)
    turns = np.repeat(draw.integers(0, 2, ROWS // 18), 18)
    light = np.stack([1 - turns, turns], axis=-1).astype(np.float64)
    start = LEFT.start_stem_cm[None]
    stems = interface.run(plant, plant.start(start), light[:, None], 300.0)[:, 0]
    points = np.concatenate([start, stems])
    points[1:, 1:] += NOISE_CM * draw.standard_normal(points[1:, 1:].shape)
    points[40:44] = np.nan
    time_s = np.arange(ROWS + 1, dtype=np.float64) * np.float64(300.0)
    return MeasuredRun(f"bean{seed}", f"bean{seed}", "0" * 64, points, light, time_s, 300.0, {})


def faults(*names: str) -> list[NamedCause]:
    values = {"time_scale": {"factor": FACTOR}, "memory": {"time_constant_h": 1.0}}
    return [NamedCause(name, values[name], {}, 0.9, 0.01, [], "", 0.0) for name in names]


@pytest.fixture(scope="module")
def runs() -> list[MeasuredRun]:
    return [run_of(seed) for seed in range(4)]


@pytest.fixture(scope="module")
def whole(runs: Sequence[MeasuredRun]) -> Mended:
    found = mended(idle(), faults("time_scale", "memory"), runs[:3])
    assert found is not None
    return found


def test_memory_is_what_the_lamps_past_tells(whole: Mended) -> None:
    off = whole.errors_mm[MEAN]
    assert off[MEMORY] < 0.25 * off[CLOCK]
    assert off[MEMORY] < 0.5 * off[NO_MEMORY]
    assert off[MEMORY] < 0.5 * off[STILL]
    assert off[BASE] > off[MEMORY]
    assert set(whole.errors_mm) == {"1h", "6h", "24h", "end", MEAN}


def test_what_is_judged_was_not_fitted_to(runs: list[MeasuredRun], whole: Mended) -> None:
    held_out = mended(idle(), faults("time_scale", "memory"), runs[:3], runs[3:])
    assert held_out is not None
    assert held_out.simulator.memory.tobytes() == whole.simulator.memory.tobytes()
    assert [run.name for run in held_out.runs] == ["bean3"]
    assert "1 run held out" in held_out.judged_on
    plant = whole.simulator
    stems = interface.run(plant, plant.start(runs[3].points_cm[:1]), runs[3].light[:, None], 300.0)[:, 0]
    assert held_out.stems_cm[MEMORY][0][1:] == pytest.approx(stems, abs=1e-9)


def test_runs_of_different_steps_are_each_followed_in_their_own(runs: list[MeasuredRun]) -> None:
    mixed = [half_as_often(runs[2]), runs[3]]
    together = mended(idle(), faults("time_scale"), runs[:2], mixed)
    assert together is not None
    for run, stems in zip(mixed, together.stems_cm[CLOCK], strict=True):
        alone = mended(idle(), faults("time_scale"), runs[:2], [run])
        assert alone is not None
        assert stems == pytest.approx(alone.stems_cm[CLOCK][0])


def test_what_judges_itself_is_told(runs: list[MeasuredRun]) -> None:
    alone = mended(idle(), faults("time_scale"), runs[:1])
    assert alone is not None
    assert alone.judged_on == "the very run that it was mended by, which makes the figures too good"


@pytest.mark.parametrize("seldom", [(0, 2), (0, 1, 2)])
def test_memory_is_the_same_in_runs_of_longer_steps(runs: list[MeasuredRun], seldom: tuple[int, ...]) -> None:
    steps = [half_as_often(run) if i in seldom else run for i, run in enumerate(runs[:3])]
    found, often = (mended(idle(), faults("time_scale", "memory"), ones, runs[3:]) for ones in (steps, runs[:3]))
    assert found is not None
    assert often is not None
    assert found.errors_mm[MEAN][MEMORY] < 1.5 * often.errors_mm[MEAN][MEMORY]


def test_no_side_is_preferred(whole: Mended) -> None:
    plant, stem = whole.simulator, LEFT.start_stem_cm[None] * np.array([0.0, 1.0])
    rest = {}
    for side in (0, 1):
        light = np.zeros((30, 1, 2))
        light[..., side] = 1.0
        network = RememberingSimulator(plant.learned, plant.factor, np.zeros((18, FEATURES)))
        with_memory, without = (interface.run(one, one.start(stem), light[:1], 300.0) for one in (plant, network))
        rest[side] = (with_memory - without)[0, 0]
    assert rest[0] * np.array([-1.0, 1.0]) == pytest.approx(rest[1], abs=1e-9)
    assert np.abs(rest[0]).max() > 1e-3


def test_a_clock_alone_is_set_right_without_a_memory(runs: list[MeasuredRun]) -> None:
    found = mended(idle(), faults("time_scale"), runs)
    assert found is not None
    assert found.simulator.factor == FACTOR
    assert not found.simulator.memory.any()
    assert set(found.errors_mm[MEAN]) == {BASE, CLOCK, STILL}
    only_memory = mended(idle(), faults("memory"), runs[:2])
    assert only_memory is not None
    assert only_memory.simulator.factor == 1.0
    assert only_memory.simulator.memory.any()


def test_what_is_right_or_has_a_state_is_left_alone(runs: list[MeasuredRun]) -> None:
    assert mended(idle(), [], runs) is None
    assert mended(paper(stateful=True), faults("time_scale"), runs) is None


def test_a_memory_that_makes_it_worse_is_left_out(runs: list[MeasuredRun]) -> None:
    shrinking = replace(runs[1], points_cm=runs[1].points_cm[::-1].copy())
    found = mended(idle(), faults("time_scale", "memory"), [runs[0], shrinking])
    assert found is not None
    assert not found.simulator.memory.any()
    assert MEMORY not in found.errors_mm[MEAN]


def test_people_are_told(whole: Mended) -> None:
    told = whole.told()
    text = "\n".join(learned_told.lines(told))
    assert f"{whole.errors_mm['end'][MEMORY]:.1f}" in text
    assert "each of 3 runs" in text
    picture = figures_of_learned.heights(whole)
    page = "".join(learned_told.pieces(told, {"learned": picture}))
    assert page.count("<img") == 1
    assert f"{whole.errors_mm['6h'][CLOCK]:.1f}" in page
    assert learned_told.pieces({}, {}) == []
    assert learned_told.lines({}) == []
