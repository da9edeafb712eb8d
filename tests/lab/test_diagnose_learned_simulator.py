"""What a learned simulator lacks as a whole: the right clock, and a memory; and runs of a simulator itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from diagnose_runs import LAMPS, QUIET, TYPICAL, base, change_of, run_of, turns
from simulator_fakes import Forgetful, straight_run, write_straight

from flora_common.arrays import FloatArray
from flora_lab.diagnose import emulated, stored_base
from flora_lab.diagnose.inputs import Runs
from flora_lab.diagnose.learned_simulator import clock_interval, faults_of, still_wrong
from flora_lab.simulator.growing import DataRange
from flora_lab.simulator.interface import Covariates
from flora_lab.simulator.load import KINDS, load
from flora_lab.simulator.measured import MeasuredRun
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.store import Extension

GROWTHS = (0.1, 0.12, 0.14, 0.11, 0.13)


class Bends(Forgetful):
    """Bends towards the lit lamp as fast as plants do on the mean, from the stem alone."""

    def step(
        self, state: FloatArray, light: FloatArray, dt_s: float, covariates: Covariates | None = None
    ) -> tuple[FloatArray, FloatArray]:
        hours = dt_s / 3600.0
        along = np.linspace(0.0, 1.0, 10) ** 2
        after = state.copy()
        after[..., 0] += 0.15 * hours * along * (light[:, 1] - light[:, 0])[:, None]
        after[..., 1] *= 1.0 + 0.018 * hours
        return after, after


@pytest.fixture(autouse=True)
def _fakes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(KINDS, "straight", "simulator_fakes:StraightPlant")


def rod() -> RodSimulator:
    return stored_base.simulator_of(base(), LAMPS, DataRange(60.0, 30.0), None)


def plants(count: int = 4) -> list[MeasuredRun]:
    """Plants of the law: they remember their light for some twenty minutes, and bend on for hours."""
    return [run_of(seed, chance=QUIET, light=turns(24.0, 3.0)) for seed in range(count)]


def straight(growths: tuple[float, ...] = GROWTHS) -> list[MeasuredRun]:
    return [straight_run(f"bean{i}", hours=24.0, growth_cm_h=growth) for i, growth in enumerate(growths)]


def test_a_simulator_without_memory_is_told() -> None:
    faults = {fault.effect: fault for fault in faults_of(Bends(), plants())}
    fault = faults["memory"]
    assert fault.p_value < 0.01
    assert fault.confidence == 1.0 - fault.p_value
    hours = fault.parameters["time_constant_h"]
    low, high = fault.interval["time_constant_h"]
    assert 0.05 < low <= hours <= high < 12.0
    assert "does not depend on what went before" in fault.evidence
    assert fault.evidence.endswith(" by chance).")


def test_a_day_of_one_plant_is_too_short_for_a_memory() -> None:
    assert [fault.effect for fault in faults_of(Bends(), plants(1))] == []


def test_a_growing_simulator_remembers() -> None:
    faults = faults_of(rod(), plants())
    assert [fault.effect for fault in faults] == []


@pytest.mark.parametrize("speed", [3.0, 0.5])
def test_a_clock_that_is_wrong_is_told_with_its_factor(tmp_path: Path, speed: float) -> None:
    fast = load(write_straight(tmp_path / "fast.simulator", speed=speed))
    (fault,) = faults_of(fast, straight())
    assert fault.effect == "time_scale"
    assert fault.parameters["factor"] == pytest.approx(speed, rel=0.1)
    low, high = fault.interval["factor"]
    assert low <= fault.parameters["factor"] <= high
    assert low > 1.0 or high < 1.0
    assert f"{speed:.1f}" in fault.evidence
    assert "fast as real ones" in fault.evidence


def test_few_plants_are_less_sure_of_a_clock(tmp_path: Path) -> None:
    fast = load(write_straight(tmp_path / "fast.simulator", speed=3.0))
    told = [faults_of(fast, straight((0.12,) * count))[0] for count in (1, 2, 5)]
    assert all(fault.parameters["factor"] == pytest.approx(3.0, rel=0.15) for fault in told)
    wide = [high / low for low, high in (fault.interval["factor"] for fault in told)]
    assert wide[0] > wide[1] > wide[2] > 1.1
    assert [0.99 < fault.confidence <= 0.999 for fault in told] == [True] * 3


def test_a_clock_that_is_wrong_by_less_than_one_plant_tells_is_left(tmp_path: Path) -> None:
    fast = load(write_straight(tmp_path / "fast.simulator", speed=1.2))
    assert faults_of(fast, straight((0.12,))) == []
    (fault,) = faults_of(fast, straight((0.12,) * 6))
    assert fault.parameters["factor"] == pytest.approx(1.2, rel=0.1)


def test_plants_that_differ_widen_the_interval_of_a_clock() -> None:
    alike, apart = (clock_interval(2.0, np.log([2.0, 2.0 * more, 2.0 / more])) for more in (1.0, 1.5))
    assert alike[0] < 1.2 < apart[0]
    assert apart[1] < alike[1]
    few, many = (clock_interval(1.3, np.full(count, np.log(1.3))) for count in (1, 9))
    assert few[0] > 1.3 > many[0]
    assert few[1] < 0.96 < many[1]
    aside = clock_interval(3.17, np.log([3.05, 3.05, 7.7, 7.7]))
    assert 3.17 * aside[0] > 4.85 > 3.17 / aside[0]


def test_a_clock_beyond_what_was_searched_is_told_as_one(tmp_path: Path) -> None:
    slow = load(write_straight(tmp_path / "slow.simulator", speed=0.05))
    (fault,) = faults_of(slow, straight((0.12,) * 4))
    assert fault.evidence.endswith("; the truth may lie beyond what was searched.")


def test_a_simulator_that_is_right_has_no_fault(tmp_path: Path) -> None:
    assert faults_of(load(write_straight(tmp_path / "right.simulator")), straight()) == []


def test_plants_that_grow_more_slowly_are_no_fault_of_the_clock_once_that_is_known() -> None:
    slower = change_of({"growth_rate": {"factor": 0.55}})
    runs = [run_of(seed, chance=QUIET, light=turns(24.0, 3.0), change=slower) for seed in range(4)]
    faults = faults_of(rod(), runs)
    assert [fault.effect for fault in faults] == ["time_scale"]
    assert still_wrong(faults, rod().extended([Extension("growth_rate", {"factor": 0.55})]), runs) == []
    assert still_wrong(faults, rod().extended([Extension("sag", {"amplitude": 0.01})]), runs) == faults
    assert still_wrong([], rod(), runs) == []


# Runs of a simulator itself


def measured(*runs: MeasuredRun) -> Runs:
    return Runs((), runs, (), ((),) * len(runs))


def test_a_simulator_is_learned_from_its_own_runs() -> None:
    simulator = rod()
    first = run_of(1, hours=12.0)
    told = emulated.reference_of(simulator, measured(first, run_of(2, hours=12.0)))
    assert len(told.measured) == emulated.COUNT
    for i, run in enumerate(told.measured):
        assert run.hours == emulated.HOURS
        assert run.points_cm[0].tolist() == (first if i % 2 == 0 else run_of(2, hours=12.0)).points_cm[0].tolist()
        assert run.is_measured.all()
        assert run.lamps == LAMPS
        assert (run.light.sum(axis=1) == 1.0).all()
    ends = np.array([run.points_cm[-1, -1, 1] for run in told.measured])
    assert ends.std() > 0.3  # plants differ
    dwells = [np.diff(np.flatnonzero(np.diff(run.light[:, 0]) != 0.0)) for run in told.measured]
    assert all((dwell == 72).all() for dwell in dwells[::2])
    assert all(len(set(dwell.tolist())) > 3 for dwell in dwells[1::2])
    # left is first as often as right, so that nothing leans to a side by the schedule
    assert {run.light[0].tolist()[0] for run in told.measured} == {0.0, 1.0}


def test_simulated_runs_are_the_same_every_time() -> None:
    told = [emulated.reference_of(rod(), measured(run_of(1, hours=12.0))) for _ in range(2)]
    assert all(a.points_cm.tobytes() == b.points_cm.tobytes() for a, b in zip(*(t.measured for t in told), strict=True))


def test_a_simulator_without_chance_gives_the_same_plant_again() -> None:
    told = emulated.reference_of(Bends(), measured(run_of(1, hours=12.0)))
    assert told.measured[0].points_cm.tobytes() == told.measured[4].points_cm.tobytes()
    assert np.abs(told.measured[0].points_cm[-1] - told.measured[1].points_cm[-1]).max() > 0.1
    assert TYPICAL.shape == (9,)
