"""The figures that stem finders are judged by: known curves in, known numbers out."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bench.vision.figures import (
    FIGURES,
    Found,
    RunScores,
    intervals,
    length_cm,
    line_distances_mm,
    pooled,
    run_scores,
    sampled,
)
from flora_common.arrays import FloatArray

UPRIGHT = np.array([[0.0, 0.0], [0.0, 10.0]])


def moved(line_cm: FloatArray, x_cm: float) -> FloatArray:
    return np.asarray(line_cm + np.array([x_cm, 0.0]), dtype=np.float64)


def upright(length: float) -> FloatArray:
    return np.array([[0.0, 0.0], [0.0, length]])


def test_samples_are_even_along_the_line_however_its_points_lie() -> None:
    bent = np.array([[0.0, 0.0], [0.0, 0.1], [0.0, 3.0], [4.0, 3.0]])
    assert length_cm(bent) == pytest.approx(7.0)
    points = sampled(bent, 8)
    assert points == pytest.approx(np.array([[0, 0], [0, 1], [0, 2], [0, 3], [1, 3], [2, 3], [3, 3], [4, 3]]))


def test_a_line_beside_the_true_one_is_off_by_their_distance_both_ways() -> None:
    distances = line_distances_mm(moved(UPRIGHT, 0.2), UPRIGHT)
    assert distances.shape == (100,)
    assert distances == pytest.approx(np.full(100, 2.0))


def test_a_stem_cut_short_is_punished_by_the_way_back_alone() -> None:
    distances = line_distances_mm(upright(5.0), UPRIGHT)
    assert distances[:50] == pytest.approx(np.zeros(50))
    # of 50 points on 10 cm those above 5 cm are 0..50 mm from its end: the mean of max(0, y - 50) over y in 0..100
    assert distances[50:].max() == pytest.approx(50.0)
    assert distances[50:].mean() == pytest.approx(12.5, abs=0.3)


def test_a_stem_that_goes_on_into_a_leaf_is_punished_by_the_way_there() -> None:
    beyond = np.array([[0.0, 0.0], [0.0, 10.0], [3.0, 10.0]])
    distances = line_distances_mm(beyond, UPRIGHT)
    assert distances[:50].max() == pytest.approx(30.0)
    assert distances[50:] == pytest.approx(np.zeros(50))


def test_outcomes_are_counted_apart() -> None:
    found = [
        Found("ok", UPRIGHT),
        Found("ok", moved(UPRIGHT, 1.1)),  # sure, and 11 mm off
        Found("jumped", moved(UPRIGHT, 1.1)),  # as far off, and says so
        Found("no_stem", None),
    ]
    scores = run_scores([0, 300, 600, 900], [UPRIGHT] * 4, found, range(4))
    assert (scores.frames, scores.missing, scores.flagged, scores.confident) == (4, 1, 1, 1)
    assert scores.tip_mm == pytest.approx([0.0, 11.0, 11.0])
    figures = pooled([scores])
    assert figures["missing_percent"] == pytest.approx(25.0)
    assert figures["flagged_percent"] == pytest.approx(25.0)
    assert figures["confident_percent"] == pytest.approx(25.0)
    assert figures["tip_mean_mm"] == pytest.approx(22.0 / 3.0)
    assert figures["tip_p95_mm"] == pytest.approx(11.0)
    assert figures["distance_mean_mm"] == pytest.approx(22.0 / 3.0, abs=0.01)


def test_what_a_method_says_of_its_tips_is_held_against_how_far_off_those_are_that_are_ok() -> None:
    found = [
        Found("ok", moved(UPRIGHT, 0.3), 2.0),
        Found("ok", moved(UPRIGHT, 0.4), 1.0),  # 4 mm off, more than three times what it says
        Found("occluded", moved(UPRIGHT, 2.0), 1.0),
        Found("ok", moved(UPRIGHT, 1.2)),  # says nothing
        Found("no_stem", None),
    ]
    figures = pooled([run_scores(np.arange(5) * 300, [UPRIGHT] * 5, found, range(5))])
    assert figures["ok_rms_mm"] == pytest.approx(math.sqrt((3.0**2 + 4.0**2) / 2.0))
    assert figures["said_rms_mm"] == pytest.approx(math.sqrt((2.0**2 + 1.0**2) / 2.0))
    assert figures["beyond_percent"] == pytest.approx(50.0)
    silent = pooled([run_scores([0], [UPRIGHT], [Found("ok", UPRIGHT)], [0])])
    assert math.isnan(silent["ok_rms_mm"])
    assert math.isnan(silent["beyond_percent"])


def test_a_tip_exactly_10_mm_off_is_no_confident_failure() -> None:
    scores = run_scores([0], [UPRIGHT], [Found("ok", moved(UPRIGHT, 1.0))], [0])
    assert scores.confident == 0


def test_jitter_is_found_step_less_true_step_and_a_constant_offset_is_none() -> None:
    true = [moved(UPRIGHT, 0.01 * i) for i in range(5)]
    beside = run_scores(np.arange(5) * 300, true, [Found("ok", moved(line, 0.3)) for line in true], range(5))
    assert pooled([beside])["jitter_mm"] == pytest.approx(0.0, abs=1e-9)
    # steps of the found tip: +1 mm and -1 mm in turns, of the true one 0
    to_and_fro = [Found("ok", moved(UPRIGHT, 0.1 * (i % 2))) for i in range(5)]
    shaking = run_scores(np.arange(5) * 300, [UPRIGHT] * 5, to_and_fro, range(5))
    assert pooled([shaking])["jitter_mm"] == pytest.approx(1.0)


def test_only_frames_that_follow_each_other_make_a_step() -> None:
    found = [Found("ok", UPRIGHT) for _ in range(8)]
    found[6] = Found("no_stem", None)
    true = [UPRIGHT] * 8
    assert len(run_scores(np.arange(8) * 300, true, found, [0, 2, 4, 5]).step_mm) == 1
    assert len(run_scores(np.arange(8) * 300, true, found, range(8)).step_mm) == 5


def test_steps_without_any_motion_are_counted_and_tiny_ones_are_not() -> None:
    x = [0.0, 0.0, 1e-9, 0.1, 0.1]
    found = [Found("ok", moved(UPRIGHT, shift)) for shift in x]
    scores = run_scores(np.arange(5) * 300, [UPRIGHT] * 5, found, range(5))
    assert scores.same == 2
    assert pooled([scores])["same_percent"] == pytest.approx(50.0)


def test_growth_compares_the_first_and_last_quarter_hour_along_the_stem() -> None:
    times = np.arange(13) * 300.0
    true = [upright(5.0 + 0.5 * i) for i in range(13)]
    # found: 2 mm short throughout, hence the same growth; then one that grows 10 percent too much
    short = run_scores(times, true, [Found("ok", upright(5.0 + 0.5 * i - 0.2)) for i in range(13)], range(13))
    assert short.growth_percent == pytest.approx(0.0, abs=1e-9)
    fast = run_scores(times, true, [Found("ok", upright(5.0 + 0.55 * i)) for i in range(13)], range(13))
    assert fast.growth_percent == pytest.approx(10.0)
    slow = run_scores(times, true, [Found("ok", upright(5.0 + 0.45 * i)) for i in range(13)], range(13))
    assert pooled([fast, slow])["growth_error_percent"] == pytest.approx(10.0)


def test_growth_without_a_stem_at_one_end_is_none() -> None:
    times = np.arange(13) * 300.0
    found = [Found("ok", UPRIGHT) if i < 8 else Found("no_stem", None) for i in range(13)]
    scores = run_scores(times, [upright(5.0 + i) for i in range(13)], found, range(13))
    assert math.isnan(scores.growth_percent)
    assert math.isnan(pooled([scores])["growth_error_percent"])


def test_a_method_that_never_finds_a_stem_has_figures_all_the_same() -> None:
    scores = run_scores([0, 300], [UPRIGHT] * 2, [Found("no_stem", None)] * 2, range(2))
    figures = pooled([scores])
    assert figures["missing_percent"] == 100.0
    assert figures["confident_percent"] == 0.0
    assert math.isnan(figures["tip_mean_mm"])
    assert set(figures) == set(FIGURES)
    assert all(math.isnan(limit) for limit in intervals([scores])["distance_p95_mm"])


def test_frames_weigh_alike_in_the_pooled_figure() -> None:
    three = run_scores([0, 300, 600], [UPRIGHT] * 3, [Found("ok", UPRIGHT)] * 3, range(3))
    one = run_scores([0], [UPRIGHT], [Found("ok", moved(UPRIGHT, 0.4))], [0])
    assert pooled([three, one])["tip_mean_mm"] == pytest.approx(1.0)


def test_few_runs_give_their_range_and_many_an_interval_inside_it() -> None:
    def run(off_cm: float) -> RunScores:
        return run_scores([0], [UPRIGHT], [Found("ok", moved(UPRIGHT, off_cm))], [0])

    few = intervals([run(0.1), run(0.5)])
    assert few["tip_mean_mm"] == pytest.approx((1.0, 5.0))
    many = [run(0.1 * i) for i in range(1, 11)]
    low, high = intervals(many)["tip_mean_mm"]
    middle = pooled(many)["tip_mean_mm"]
    # mean of ten values 1..10 mm: its standard error is 0.91 mm
    assert 1.0 < low < middle < high < 10.0
    assert high - low == pytest.approx(2 * 1.96 * 0.91, rel=0.2)
    assert intervals(many) == intervals(many)
