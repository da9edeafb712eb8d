"""Errors of simulators whose errors can be worked out on paper."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulator_fakes import ALONG, GROWTH_CM_H, LEAN_CM_H, StraightPlant, straight_run

from flora_common.arrays import FloatArray
from flora_common.geometry import polyline_length
from flora_lab.rollout.free_running import (
    NO_START,
    Judged,
    Plan,
    errors_between,
    free_run,
    judge,
    one_step,
    parting_mm,
    start_rows,
    starts_of,
)
from flora_lab.rollout.predictors import GoesOn, NothingMoves
from flora_lab.rollout.summary import (
    COMPARED,
    END,
    STARTS,
    Entry,
    Measure,
    Place,
    Start,
    errors_at,
    horizons,
    summarise,
)
from flora_lab.simulator.measured import MeasuredRun

PLAN = Plan(12.0, 6.0, (12, 72, 288))
H = 12
"""Rows per hour."""


def at(judged: Judged, start: Start, steps: int, measure: Measure = "tip_mm") -> FloatArray:
    return errors_at(judged, Place(start, steps, measure))[0]


def told(judged: Judged, start: Start, steps: int, measure: Measure = "tip_mm") -> FloatArray:
    """Without what no run is long enough for."""
    found = at(judged, start, steps, measure)
    assert np.isfinite(found).any()
    return found[np.isfinite(found)]


# One stem against another


def test_distances_and_growth_by_hand() -> None:
    start = ALONG[:, None] * [0.0, 8.0]
    measured = ALONG[:, None] * [0.0, 10.0]
    simulated = ALONG[:, None] * [0.0, 11.0] + [0.3, 0.0]
    simulated[0] = 0.0
    errors = errors_between(simulated, measured, start)
    assert errors.tip_mm == pytest.approx(10.0 * np.hypot(0.3, 1.0))
    assert errors.stem_mm == pytest.approx(10.0 * np.hypot(0.3, ALONG[1:]).mean())
    assert errors.growth == pytest.approx((polyline_length(simulated) - 8.0) / 2.0 - 1.0)


def test_growth_is_not_told_where_nothing_grew_nor_errors_where_nothing_was_measured() -> None:
    start = ALONG[:, None] * [0.0, 8.0]
    measured = ALONG[:, None] * np.array([[0.0, 8.05], [0.0, 8.15], [np.nan, np.nan]])[:, None]
    errors = errors_between(np.broadcast_to(start, (3, 10, 2)), measured, start)
    assert np.isnan(errors.growth).tolist() == [True, False, True]
    assert errors.growth[1] == pytest.approx(-1.0)
    assert np.isnan(errors.tip_mm).tolist() == [False, False, True]


# Simulators with known errors


def test_the_right_plant_errs_nowhere() -> None:
    judged = judge(StraightPlant(), [straight_run("a"), straight_run("b", hours=50.0, lamps_h=3.0)], PLAN)
    for start in STARTS:
        for steps in horizons(start, PLAN):
            assert told(judged, start, steps) == pytest.approx(0.0, abs=1e-9)
    assert at(judged, "unseen", 288, "growth") == pytest.approx(0.0, abs=1e-9)


def test_a_shift_of_3_mm_is_an_error_of_3_mm_everywhere() -> None:
    judged = judge(StraightPlant(shift_cm=0.3), [straight_run("a"), straight_run("b", hours=50.0)], PLAN)
    assert len(judged.one_step.run) == 72 * H + 50 * H
    for start in STARTS:
        for steps in horizons(start, PLAN):
            for measure in COMPARED:
                assert told(judged, start, steps, measure) == pytest.approx(3.0, abs=1e-9)


def test_a_plant_twice_too_fast_is_as_far_off_as_the_real_one_moved() -> None:
    bean = straight_run("a")
    judged = judge(StraightPlant(speed=2.0), [bean], PLAN)
    per_step = 10.0 * np.hypot(LEAN_CM_H, GROWTH_CM_H) / H
    assert at(judged, "one_step", 1) == pytest.approx(per_step)
    # six hours under the left lamp
    assert at(judged, "unseen", 72) == pytest.approx(72 * per_step)
    # after twelve, twenty-four and at the end it has gone to and fro, and only grown too much
    assert at(judged, "unseen", 288) == pytest.approx(10.0 * 24.0 * GROWTH_CM_H)
    assert at(judged, "unseen", END) == pytest.approx(10.0 * 72.0 * GROWTH_CM_H)
    assert at(judged, "watched", END) == pytest.approx(10.0 * 60.0 * 0.12)
    nothing = judge(NothingMoves(), [bean], PLAN)
    for steps in (1, 12, 72, 288, END):
        assert at(nothing, "unseen", steps) == pytest.approx(at(judged, "unseen", steps))
    assert at(nothing, "unseen", 288, "growth") == pytest.approx(-1.0)


def test_whoever_watches_knows_the_individual() -> None:
    slow, fast = straight_run("slow", growth_cm_h=0.05), straight_run("fast", growth_cm_h=0.3)
    judged = judge(StraightPlant(), [slow, fast], PLAN)
    assert at(judged, "unseen", 288) == pytest.approx([24 * 0.7, 24 * 1.8])
    assert at(judged, "unseen", 288, "growth").tolist()[1] < -0.5
    assert at(judged, "watched", 288) == pytest.approx(0.0, abs=1e-9)
    assert told(judged, "often", 288) == pytest.approx(0.0, abs=1e-9)


def test_goes_on_is_right_while_the_lamp_stays() -> None:
    judged = judge(GoesOn(), [straight_run("a", lamps_h=13.0)], Plan(12.0, 6.0, (12, 24)))
    assert at(judged, "watched", 12) == pytest.approx(0.0, abs=1e-9)
    assert at(judged, "watched", 24) == pytest.approx(10.0 * 2.0 * LEAN_CM_H)  # one hour under the other lamp
    # of one stem it knows no past
    same = judge(NothingMoves(), [straight_run("a", lamps_h=13.0)], Plan(12.0, 6.0, (12, 24)))
    assert np.array_equal(at(judged, "one_step", 1), at(same, "one_step", 1))
    assert np.array_equal(at(judged, "unseen", 24), at(same, "unseen", 24))


# Starts and gaps


def test_starts_are_at_the_first_stem_after_what_is_watched() -> None:
    runs = [straight_run("a", missing=range(140, 150)), straight_run("b", hours=11.0), straight_run("c", hours=12.0)]
    assert start_rows(runs, 0.0).tolist() == [0, 0, 0]
    assert start_rows(runs, 12.0).tolist() == [150, NO_START, NO_START]
    assert start_rows(runs, 11.0).tolist() == [132, NO_START, 132]


def test_starts_are_every_six_hours_as_long_as_the_shortest_horizon_fits() -> None:
    starts = starts_of([straight_run("a", hours=25.0), straight_run("b", hours=19.0)], Plan(12.0, 6.0, (12, 72)))
    assert [rows.tolist() for rows in starts] == [[144, 144], [216, 216], [288, NO_START]]
    # a gap of nine hours
    gap = straight_run("a", hours=30.0, missing=range(140, 250))
    assert [rows.tolist() for rows in starts_of([gap], PLAN)] == [[250], [288]]
    assert starts_of([straight_run("a", hours=11.0)], PLAN) == []


def test_rows_without_a_stem_are_not_counted() -> None:
    whole, holed = straight_run("a"), straight_run("a", missing=[72, 100, 101])
    simulator = StraightPlant(speed=2.0)
    full, less = judge(simulator, [whole], PLAN), judge(simulator, [holed], PLAN)
    assert len(full.one_step.run) - len(less.one_step.run) == 5
    assert np.isnan(at(less, "unseen", 72)).all()
    assert at(less, "unseen", 288) == pytest.approx(at(full, "unseen", 288))
    assert at(less, "unseen", END) == pytest.approx(at(full, "unseen", END))
    assert np.isfinite(less.unseen.simulated_cm).all()


def test_horizons_beyond_a_runs_end_are_not_told() -> None:
    runs = [straight_run("long", hours=40.0), straight_run("short", hours=20.0), straight_run("tiny", hours=3.0)]
    judged = judge(StraightPlant(speed=2.0), runs, PLAN)
    assert np.isnan(at(judged, "unseen", 288)).tolist() == [False, True, True]
    assert at(judged, "unseen", END) == pytest.approx(
        [10.0 * np.hypot(0.12 * h, LEAN_CM_H * off) for h, off in ((40, 4.0), (20, 4.0), (3, 3.0))]
    )
    assert np.isnan(at(judged, "watched", END)).tolist() == [False, False, True]
    assert judged.unseen.last.tolist() == [40 * H, 20 * H, 3 * H]
    assert judged.watched is not None
    assert judged.watched.last.tolist() == [28 * H, 8 * H, NO_START]


def test_a_run_too_short_to_watch_is_judged_from_its_first_stem() -> None:
    runs = [straight_run("a", hours=8.0)]
    judged = judge(StraightPlant(shift_cm=0.3), runs, PLAN)
    assert judged.watched is None
    summary = summarise([Entry("straight", judged), Entry("other", judged)], runs, PLAN, 1, {})
    assert summary.estimates[Place("unseen", 72, "tip_mm"), "straight"].value == pytest.approx(3.0)
    assert summary.estimates[Place("watched", 72, "tip_mm"), "straight"].plants == 0


@settings(max_examples=20, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(13, 40), st.floats(0.01, 0.4), st.sampled_from([1.0, 2.5, 6.0])), min_size=2, max_size=4
    )
)
def test_a_run_is_judged_alone_as_among_others(made: list[tuple[int, float, float]]) -> None:
    runs = [
        straight_run(str(i), hours=hours, growth_cm_h=growth, lamps_h=lamps, missing=[5 + i, 150 + i])
        for i, (hours, growth, lamps) in enumerate(made)
    ]
    simulator, rows = StraightPlant(speed=1.5), start_rows(runs, 6.0)
    together = free_run(simulator, runs, rows, watched=True)
    for i, run in enumerate(runs):
        alone = free_run(simulator, [run], rows[i : i + 1], watched=True)
        count = int(alone.last[0]) + 1
        for name in ("tip_mm", "stem_mm", "growth"):
            own = getattr(alone.errors, name)[:count, 0]
            assert own.tobytes() == getattr(together.errors, name)[:count, i].tobytes()
        assert np.isnan(together.errors.tip_mm[count:, i]).all()


def test_many_plants_are_simulated_in_parts_with_the_same_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = [straight_run("a", hours=30.0), straight_run("b", hours=20.0, missing=[4])]
    whole = one_step(StraightPlant(speed=2.0), runs)
    monkeypatch.setattr("flora_lab.rollout.free_running.AT_ONCE", 7)
    parts = one_step(StraightPlant(speed=2.0), runs)
    assert parts.errors.tip_mm.tobytes() == whole.errors.tip_mm.tobytes()


# Summaries


def plants() -> list[MeasuredRun]:
    growths = [0.05, 0.08, 0.1, 0.12, 0.14, 0.2, 0.3]
    return [straight_run(f"run{i}", f"plant{i}", growth_cm_h=growth) for i, growth in enumerate(growths)]


def test_medians_differences_and_ratios_over_plants() -> None:
    runs = plants()
    slow, still = judge(StraightPlant(speed=0.5), runs, PLAN), judge(NothingMoves(), runs, PLAN)
    summary = summarise([Entry("slow", slow), Entry("nothing-moves", still)], runs, PLAN, 1, {})
    place = Place("watched", 288, "tip_mm")
    # the middle plant grows 0.12 cm/h; half of that in 24 h is missed
    assert summary.estimates[place, "slow"].value == pytest.approx(10 * 24 * 0.06)
    assert summary.estimates[place, "nothing-moves"].value == pytest.approx(10 * 24 * 0.12)
    (difference,) = summary.differences[place]
    assert difference.other == "nothing-moves"
    assert difference.difference.value == pytest.approx(-10 * 24 * 0.06)
    assert difference.times_better.value == pytest.approx(2.0)
    # every plant is twice as well predicted, whichever are drawn
    assert (difference.times_better.low, difference.times_better.high) == pytest.approx((2.0, 2.0))
    assert difference.difference.high is not None
    assert difference.difference.high < 0.0
    assert summary.per_run[place, "slow"] == pytest.approx(
        [10 * 24 * g / 2 for g in (0.05, 0.08, 0.1, 0.12, 0.14, 0.2, 0.3)]
    )
    growth = summary.estimates[Place("unseen", END, "growth"), "nothing-moves"]
    assert growth.value == pytest.approx(-1.0)


def test_several_runs_of_a_plant_count_once() -> None:
    runs = [
        straight_run(f"run{i}", "one" if i < 5 else f"plant{i}", growth_cm_h=0.3 if i < 5 else 0.1) for i in range(7)
    ]
    summary = summarise([Entry("still", judge(NothingMoves(), runs, PLAN))], runs, PLAN, 1, {})
    found = summary.estimates[Place("unseen", 288, "tip_mm"), "still"]
    assert found.plants == summary.plants == 3
    assert found.value == pytest.approx(24.0)  # of the three plants two grow slowly


def test_when_a_plant_left_the_data_is_told() -> None:
    runs = [straight_run("tall", tip_cm=(0.0, 13.0)), straight_run("low", tip_cm=(0.0, 2.0))]
    judged = judge(StraightPlant(beyond_cm=13.6), runs, PLAN)
    summary = summarise([Entry("straight", judged)], runs, PLAN, 1, {})
    assert summary.beyond["straight"][0] == pytest.approx(5.0, abs=0.1)
    assert np.isnan(summary.beyond["straight"][1])


def test_members_part_as_far_as_they_are_from_their_middle() -> None:
    class Mean(StraightPlant):
        def members(self) -> list[StraightPlant]:
            return [StraightPlant(shift_cm=-0.3), StraightPlant(shift_cm=0.3), StraightPlant(shift_cm=0.0)]

    runs = [straight_run("long", hours=24.0), straight_run("short", hours=6.0)]
    np.testing.assert_allclose(parting_mm(Mean(), runs), 3.0 * np.sqrt(2.0 / 3.0))
    assert np.isnan(parting_mm(StraightPlant(), runs)).all()
