"""How many times too fast a simulated plant is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulator_fakes import GROWTH_CM_H, StraightPlant, half_as_often, straight_run

from flora_lab.rollout.at_time_scale import AtTimeScale, resampled
from flora_lab.rollout.free_running import free_run
from flora_lab.rollout.predictors import NothingMoves
from flora_lab.rollout.time_scale import FREE_RUNS, RANGE, best_time_scale, mean_tip_errors_mm
from flora_lab.simulator.interface import History, run
from flora_lab.simulator.measured import MeasuredRun, side_by_side

ROW = np.zeros(1, dtype=np.int64)


def beans(count: int = 7, *, spread: float = 0.01) -> list[MeasuredRun]:
    """Plants that grow by so much faster or slower than the typical one."""
    growths = GROWTH_CM_H * (1.0 + spread * np.linspace(-1.0, 1.0, count))
    return [
        straight_run(f"run{i}", hours=48.0, growth_cm_h=float(growth), lamps_h=3.0 + i)
        for i, growth in enumerate(growths)
    ]


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0, 9.7])
def test_the_speed_of_a_plant_is_found(speed: float) -> None:
    calls: list[int] = []
    found = best_time_scale(StraightPlant(speed=speed), beans(), 1, lambda: calls.append(1))
    assert found.factor.value == pytest.approx(speed, rel=0.03)
    assert found.factor.low is not None
    assert found.factor.high is not None
    assert found.factor.low <= found.factor.value <= found.factor.high
    assert found.factor.low == pytest.approx(speed, rel=0.06)
    assert found.factor.high == pytest.approx(speed, rel=0.06)
    assert found.error_mm == found.errors_mm.min() <= found.error_as_is_mm
    assert not found.at_edge
    assert len(calls) == FREE_RUNS


def test_twice_too_fast_is_2() -> None:
    found = best_time_scale(StraightPlant(speed=2.0), beans(), 1)
    assert found.factor.value == pytest.approx(2.0, rel=0.02)
    # what is left is that individuals grow at their own rates; as it was it ran a day ahead
    assert found.error_mm < 1.0
    assert found.error_as_is_mm > 20.0


def test_the_interval_is_as_wide_as_individuals_differ() -> None:
    alike, unlike = (best_time_scale(StraightPlant(speed=2.0), beans(9, spread=s), 1).factor for s in (0.01, 0.3))
    widths = [factor.high - factor.low for factor in (alike, unlike) if factor.low and factor.high]
    assert widths[1] > 3 * widths[0]
    assert widths[1] > 0.2


def test_runs_of_different_steps_are_each_simulated_in_their_own() -> None:
    often, seldom = beans(6), [half_as_often(bean) for bean in beans(6)]
    mixed = [often[0], seldom[1], often[2], seldom[3], seldom[4], often[5]]
    fast = StraightPlant(speed=2.0)
    apart = [float(mean_tip_errors_mm(fast, [one])[0]) for one in mixed]
    for order in (mixed, mixed[::-1]):
        together = dict(zip([one.plant for one in order], mean_tip_errors_mm(fast, order), strict=True))
        assert [together[one.plant] for one in mixed] == pytest.approx(apart)
    assert best_time_scale(fast, mixed, 1).factor.value == pytest.approx(2.0, rel=0.03)


def test_a_plant_that_does_not_move_has_none_and_stays_as_it_is() -> None:
    found = best_time_scale(NothingMoves(), beans(3), 1)
    assert found.factor.value == 1.0
    assert len(set(found.errors_mm.tolist())) == 1


def test_a_plant_faster_than_was_searched_is_told() -> None:
    runs = [straight_run(str(i), hours=24.0, lamps_h=24.0) for i in range(3)]
    found = best_time_scale(StraightPlant(speed=90.0), runs, 1)
    assert found.at_edge
    assert found.factor.value == RANGE[1]


def test_fewer_than_three_plants_have_no_interval() -> None:
    factor = best_time_scale(StraightPlant(speed=2.0), beans(2), 1).factor
    assert (factor.low, factor.high, factor.plants) == (None, None, 2)


# A clock set right


def test_at_factor_1_a_plant_is_itself() -> None:
    runs = beans(2)
    rows = np.array([0, 100])
    for watched in (False, True):
        plain = free_run(StraightPlant(), runs, rows, watched=watched)
        same = free_run(AtTimeScale(StraightPlant(), 1.0), runs, rows, watched=watched)
        assert same.simulated_cm == pytest.approx(plain.simulated_cm, abs=1e-9, nan_ok=True)


def test_its_light_is_what_shines_then_not_what_shone_in_its_own_time() -> None:
    # four times too fast, lamps that change with a whole number of its steps: set right it errs nowhere
    bean = straight_run("a", hours=48.0, lamps_h=4.0)
    errors = free_run(AtTimeScale(StraightPlant(speed=4.0), 4.0), [bean], ROW, watched=False).errors
    assert np.nanmax(errors.tip_mm) == pytest.approx(0.0, abs=1e-6)
    # as it is, it has gone four times as far
    assert mean_tip_errors_mm(StraightPlant(speed=4.0), [bean])[0] > 50.0


def test_watching_is_in_its_own_time_too() -> None:
    # it thinks that a row is 300 s; ten of its rows are forty of the plant's
    bean = straight_run("a", hours=48.0, lamps_h=4.0)
    simulator = AtTimeScale(StraightPlant(speed=1.0), 4.0)
    state = simulator.watch(History(bean.points_cm[:41, None], bean.light[:40, None], 300.0, {}))
    assert state.inner.growth_cm_h == pytest.approx(4 * 0.12)
    light = np.repeat(bean.light[40:52, None], 1, axis=1)
    after = run(simulator, state, light, 300.0)
    assert after[-1, 0, -1, 1] - bean.points_cm[40, -1, 1] == pytest.approx(0.12)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 40), st.floats(0.3, 30.0), st.lists(st.integers(1, 38), max_size=10), st.integers(0, 2**32 - 1))
def test_a_resampled_history_is_a_history(rows: int, factor: float, missing: list[int], seed: int) -> None:
    bean = straight_run("a", hours=4.0, lamps_h=0.5)
    other = straight_run("b", hours=4.0, missing=[k for k in missing if k < rows - 1])
    batch = side_by_side([bean, other])
    draw = np.random.default_rng(seed)
    history = History(batch.points_cm[:rows], batch.light[: rows - 1], 300.0, {"heat": draw.normal(size=(rows - 1, 2))})
    found = resampled(history, factor)
    count = len(found.points_cm)
    assert count == int((rows - 1) / factor + 1e-9) + 1
    assert found.light.shape == (count - 1, 2, 2)
    assert found.covariates["heat"].shape == (count - 1, 2)
    assert np.isfinite(found.points_cm[[0, -1]]).all()
    assert np.array_equal(found.points_cm[-1], history.points_cm[-1])
    assert np.isfinite(found.points_cm[:, 0]).all()
    measured = np.isfinite(found.points_cm[:, 1, -1, 0])
    places = np.clip(rows - 1 - factor * np.arange(count - 1, -1, -1.0), 0, None)
    # both plants grow at the same, steady pace
    heights = 9.0 + 0.01 * places
    for plant, there in ((0, np.ones(count, dtype=bool)), (1, measured)):
        assert found.points_cm[there, plant, -1, 1] == pytest.approx(heights[there], abs=1e-6)
