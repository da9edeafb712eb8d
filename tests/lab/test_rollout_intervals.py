"""Intervals over plants: they hold the truth about as often as they say, and rows are no plants."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flora_lab.rollout.intervals import (
    FEWEST_PLANTS,
    by_plant,
    estimate,
    how_sure,
    median,
    ratio_of_medians,
    resampled,
)

REPEATS = 300


def test_intervals_hold_the_true_median_about_as_often_as_they_say() -> None:
    for plants in (7, 12):
        draw = np.random.default_rng(plants)
        held = 0
        for repeat in range(REPEATS):
            # skewed, as errors are
            found = median(np.exp(draw.normal(size=plants)), repeat)
            assert found.low is not None
            assert found.high is not None
            held += found.low <= 1.0 <= found.high
        # 0.95 would give 285 of 300; four standard errors are 15
        assert 0.90 <= held / REPEATS <= 0.99


def test_intervals_of_paired_differences_hold_the_truth() -> None:
    draw = np.random.default_rng(3)
    held = 0
    for repeat in range(REPEATS):
        individual = 3.0 * draw.normal(size=12)
        ours, theirs = individual + draw.normal(size=12), individual + 1.0 + draw.normal(size=12)
        found = median(ours - theirs, repeat)
        assert found.low is not None
        assert found.high is not None
        held += found.low <= -1.0 <= found.high
    assert 0.90 <= held / REPEATS <= 0.99


def test_resampling_rows_as_if_they_were_plants_is_far_too_sure() -> None:
    """A hundred rows of each of eight plants are eight observations, not eight hundred."""
    draw = np.random.default_rng(8)
    by_rows = by_plants = 0
    wide_rows, wide_plants = [], []
    repeats = 60
    for repeat in range(repeats):
        individual = np.repeat(draw.normal(size=8), 100)
        rows = 10.0 + individual + 0.3 * draw.normal(size=800)
        wrong = np.quantile(np.median(rows[resampled(800, repeat, times=400)], axis=-1), [0.025, 0.975])
        right = median(by_plant(rows, [f"plant{i // 100}" for i in range(800)]), repeat)
        assert right.low is not None
        assert right.high is not None
        by_rows += wrong[0] <= 10.0 <= wrong[1]
        by_plants += right.low <= 10.0 <= right.high
        wide_rows.append(wrong[1] - wrong[0])
        wide_plants.append(right.high - right.low)
    assert by_plants / repeats >= 0.85
    assert by_rows / repeats <= 0.5
    assert np.median(wide_plants) > 4 * np.median(wide_rows)


def test_a_plant_is_the_median_of_its_own() -> None:
    values = np.array([[1.0, 2.0, 30.0, np.nan], [3.0, np.nan, 50.0, np.nan]])
    assert by_plant(values, ["a", "a", "b", "c"])[:2].tolist() == [2.0, 40.0]
    assert np.isnan(by_plant(values, ["a", "a", "b", "c"])[2])


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=30), st.integers(0, 2**32 - 1))
def test_intervals_hold_the_estimate_and_lie_within_the_plants(values: list[float], seed: int) -> None:
    found = median(np.array(values), seed)
    assert found == median(np.array(values), seed)
    assert found.plants == len(values)
    if len(values) < FEWEST_PLANTS:
        assert (found.low, found.high) == (None, None)
        return
    assert found.low is not None
    assert found.high is not None
    assert min(values) <= found.low <= found.value <= found.high <= max(values)


def test_plants_of_which_nothing_is_known_are_left_out() -> None:
    some = np.array([1.0, np.nan, 2.0, 3.0, np.nan])
    assert median(some, 1) == median(np.array([1.0, 2.0, 3.0]), 1)
    none = median(np.array([np.nan, np.nan]), 1)
    assert (none.plants, none.low) == (0, None)
    assert np.isnan(none.value)
    pair = ratio_of_medians(np.array([1.0, 4.0, 8.0, 6.0]), np.array([np.nan, 2.0, 4.0, 3.0]), 1)
    assert (pair.value, pair.plants) == (2.0, 3)


def test_a_ratio_to_no_error_at_all_is_not_told() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = ratio_of_medians(np.ones(6), np.zeros(6), 1)
    assert np.isnan(found.value)
    assert (found.low, found.high) == (None, None)


def test_other_statistics_are_resampled_the_same_way() -> None:
    draw = np.random.default_rng(1)
    values = draw.normal(size=200)
    found = estimate(values, lambda v: v.mean(axis=-1), 5)
    assert found.low is not None
    assert found.high is not None
    assert found.high - found.low == pytest.approx(2 * 1.96 * values.std() / np.sqrt(200), rel=0.1)


def test_what_intervals_are_worth_is_said() -> None:
    assert how_sure(1).startswith("1 plant: no intervals")
    assert how_sure(2).startswith("2 plants: no intervals")
    assert "75 %" in how_sure(3)
    assert "94 %" in how_sure(5)
    assert how_sure(6) == "6 plants; in brackets 95 % intervals, by resampling plants"
