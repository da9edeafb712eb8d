"""The predictors that anybody could make up, and what every simulated plant must keep to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from simulator_contract import check_contract
from simulator_fakes import Straight, StraightPlant, straight_run

from flora_common.arrays import FloatArray
from flora_common.runs import LampsSection
from flora_lab.rollout.at_time_scale import AtTimeScale
from flora_lab.rollout.predictors import GoesOn, NothingMoves
from flora_lab.run_tracks import RunTrack
from flora_lab.simulator.interface import Covariates, History, run
from flora_lab.simulator.measured import MeasuredRun, in_steps, side_by_side
from flora_twin.runs import dataset_runs

STEP_S = 300.0


@pytest.fixture(scope="module")
def beans() -> list[MeasuredRun]:
    grown = dataset_runs(30, open_loops=2, closed_loops=0, random_loops=3, hours=4)
    return [
        in_steps(RunTrack(run.name, run.run_file.plant, Path(run.name), "0" * 64, run.track, LampsSection()))
        for run in grown
    ]


def history_of(run: MeasuredRun, rows: int) -> History:
    batch = side_by_side([run])
    return History(batch.points_cm[:rows], batch.light[: rows - 1], STEP_S, {})


LEFT = np.array([[1.0, 0.0]])


def test_the_trivial_predictors_keep_to_the_contract(beans: list[MeasuredRun]) -> None:
    check_contract(NothingMoves(), beans)
    check_contract(GoesOn(), beans)


def test_a_plant_with_its_clock_set_right_keeps_to_the_contract(beans: list[MeasuredRun]) -> None:
    check_contract(AtTimeScale(NothingMoves(), 9.7), beans)
    check_contract(AtTimeScale(GoesOn(), 0.6), beans)


def test_the_contract_of_a_plant_that_moves() -> None:
    runs = [straight_run(str(i), hours=4, tip_cm=(0.3 * i, 8.0 + i), lamps_h=1.0) for i in range(4)]
    # leaning over, its tip is nearer to the anchor
    check_contract(StraightPlant(), runs, shrink_cm=0.03)
    check_contract(AtTimeScale(StraightPlant(), 3.3), runs, shrink_cm=0.03)


# The contract finds what it is for


class Leaks(StraightPlant):
    def stems_cm(self, state: Straight) -> FloatArray:
        stems = super().stems_cm(state)
        stems += 1e-12 * len(stems)  # the size of the batch, as BLAS does it
        stems[:, 0] = 0.0
        return stems


class WritesItsState(StraightPlant):
    def step(
        self, state: Straight, light: FloatArray, dt_s: float, covariates: Covariates | None = None
    ) -> tuple[Straight, FloatArray]:
        after, stems = super().step(state, light, dt_s)
        state.tip_cm[:] = after.tip_cm
        return after, stems


class Shrinks(StraightPlant):
    def step(
        self, state: Straight, light: FloatArray, dt_s: float, covariates: Covariates | None = None
    ) -> tuple[Straight, FloatArray]:
        return super().step(Straight(state.tip_cm * 0.99, state.growth_cm_h), light, dt_s)


class BlowsUp(StraightPlant):
    def step(
        self, state: Straight, light: FloatArray, dt_s: float, covariates: Covariates | None = None
    ) -> tuple[Straight, FloatArray]:
        after, stems = super().step(state, light, dt_s)
        return after, np.where(stems[:, -1:, 1:] > 12.0, np.nan, stems)


class TakesAnyTime(StraightPlant):
    def step(
        self, state: Straight, light: FloatArray, dt_s: float, covariates: Covariates | None = None
    ) -> tuple[Straight, FloatArray]:
        return super().step(state, light, dt_s if dt_s > 0 else STEP_S)


class MindsTheMoon(StraightPlant):
    def step(
        self, state: Straight, light: FloatArray, dt_s: float, covariates: Covariates | None = None
    ) -> tuple[Straight, FloatArray]:
        return super().step(state, light, dt_s * (1.1 if covariates else 1.0))


class StepsTwice(StraightPlant):
    def step(
        self, state: Straight, light: FloatArray, dt_s: float, covariates: Covariates | None = None
    ) -> tuple[Straight, FloatArray]:
        return super().step(state, light, STEP_S if dt_s > 0 and np.isfinite(dt_s) else dt_s)


class FallsAtGaps(StraightPlant):
    def watch(self, history: History) -> Straight:
        rise = history.points_cm[:, :, -1, 1].mean(axis=0) - history.points_cm[0, :, -1, 1]
        return Straight(history.points_cm[-1, :, -1].copy(), rise)


@pytest.mark.parametrize(
    "broken", [Leaks, WritesItsState, Shrinks, BlowsUp, TakesAnyTime, MindsTheMoon, StepsTwice, FallsAtGaps]
)
def test_the_contract_finds_plants_that_break_it(broken: type[StraightPlant]) -> None:
    runs = [straight_run(str(i), hours=4, tip_cm=(0.3 * i, 8.0 + i), lamps_h=1.0) for i in range(4)]
    with pytest.raises((AssertionError, pytest.fail.Exception)):
        check_contract(broken(), runs, shrink_cm=0.03, start_cm=1e-6, watch_cm=1e-6)


# What they predict


def test_nothing_moves() -> None:
    stems = straight_run().points_cm[:3]
    predictor = NothingMoves()
    after = run(predictor, predictor.start(stems), np.tile(LEFT, (5, 3, 1)), STEP_S)
    assert all(np.array_equal(step, stems) for step in after)


def test_goes_on_goes_on_as_over_the_last_hour() -> None:
    # the lamps change every half hour: over an hour to and fro cancel, and what stays is growth
    bean = straight_run(hours=3, lamps_h=0.5)
    predictor = GoesOn()
    state = predictor.watch(history_of(bean, 25))
    after = run(predictor, state, np.tile(LEFT, (12, 1, 1)), STEP_S)
    assert after[-1, 0, -1] == pytest.approx(bean.points_cm[24, -1] + [0.0, 0.12])
    # seen for half an hour only, it goes on sideways too
    state = predictor.watch(history_of(bean, 7))
    after = run(predictor, state, np.tile(LEFT, (12, 1, 1)), STEP_S)
    assert after[-1, 0, -1] == pytest.approx(bean.points_cm[6, -1] + [-0.3, 0.12])


def test_goes_on_from_a_single_stem_is_nothing_moves() -> None:
    bean = straight_run(hours=1)
    light = np.tile(LEFT, (12, 1, 1))
    for begun in (GoesOn().start(bean.points_cm[:1]), GoesOn().watch(history_of(bean, 1))):
        assert np.array_equal(run(GoesOn(), begun, light, STEP_S)[-1], bean.points_cm[:1])


def test_goes_on_leaves_out_what_was_not_measured() -> None:
    # a stem half an hour ago and the last one are all that is left of the last hour
    bean = straight_run(hours=3, missing=[k for k in range(12, 36) if k not in (18, 24)])
    state = GoesOn().watch(history_of(bean, 25))
    assert state.velocity_cm_s[0, -1] * 3600.0 == pytest.approx([-0.3, 0.12])
    # nothing but the last: it stands still
    bean = straight_run(hours=3, missing=range(12, 24))
    assert not GoesOn().watch(history_of(bean, 25)).velocity_cm_s.any()
