"""The functional box plot's parts, against the definition and against statsmodels."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from evolution_fakes import stepwise
from statsmodels.graphics.functional import banddepth

from flora_common.arrays import FloatArray
from flora_lab.evolve_report.functional_box import band_depth, functional_box


def by_definition(curves: FloatArray) -> FloatArray:
    """The share of pairs between which a curve lies, averaged over its places."""
    inside = []
    for a, b in combinations(range(len(curves)), 2):
        low, high = np.minimum(curves[a], curves[b]), np.maximum(curves[a], curves[b])
        inside.append(((curves >= low) & (curves <= high)).mean(axis=1))
    return np.mean(inside, axis=0)


@pytest.mark.parametrize("seed", range(5))
def test_depth_is_that_of_its_definition_with_and_without_ties(seed: int) -> None:
    for curves in (stepwise(9, 30, seed), np.random.default_rng(seed).random((9, 30))):
        assert band_depth(curves) == pytest.approx(by_definition(curves))


@pytest.mark.parametrize("count", [2, 3, 20])
def test_without_ties_depth_is_that_of_statsmodels(count: int) -> None:
    curves = np.cumsum(np.random.default_rng(count).normal(size=(count, 200)), axis=1)

    assert band_depth(curves) == pytest.approx(banddepth(curves))


def test_depth_does_not_depend_on_the_order_of_the_runs() -> None:
    curves = stepwise(20, 100, 1)
    order = np.random.default_rng(2).permutation(20)

    assert (band_depth(curves[order]) == band_depth(curves)[order]).all()


def test_the_region_holds_the_deeper_half_and_the_envelope_all_but_outliers() -> None:
    curves = np.arange(11.0)[:, None] + np.zeros((11, 4))
    curves[10, 2] = 60.0

    box = functional_box(curves)

    assert box.median == 5
    assert (box.region == [[2.0] * 4, [7.0] * 4]).all() or (box.region == [[3.0] * 4, [8.0] * 4]).all()
    assert box.outliers == (10,)
    assert (box.envelope == [[0.0] * 4, [9.0] * 4]).all()


def test_equal_curves_have_no_outliers_and_the_first_is_the_median() -> None:
    box = functional_box(np.tile(np.linspace(0.0, 1.0, 50), (20, 1)))

    assert box.outliers == ()
    assert box.median == 0
    assert (box.region == box.envelope).all()


def test_where_half_of_the_curves_are_equal_a_hairs_breadth_makes_no_outlier() -> None:
    curves = np.full((20, 30), 0.8)
    curves[-3] += 1e-4
    curves[-1] = 0.5

    assert functional_box(curves).outliers == (17, 19)
    assert functional_box(curves, least=0.001).outliers == (19,)


def test_one_curve_has_no_box() -> None:
    with pytest.raises(ValueError, match="1 curves"):
        functional_box(np.zeros((1, 5)))
