"""How far stems reached, and how far beyond another one is."""

from __future__ import annotations

import numpy as np
import pytest

from flora_common.arrays import FloatArray
from flora_common.geometry import polyline_length
from flora_common.stem_range import StemRange, range_of

MET = StemRange(left_cm=-8.0, right_cm=9.0, lowest_tip_cm=6.0, highest_tip_cm=21.0, shortest_cm=6.5, longest_cm=24.0)


def straight(x_cm: float, y_cm: float) -> FloatArray:
    return np.linspace((0.0, 0.0), (x_cm, y_cm), 10)


def bowed(tip_y_cm: float, bow_cm: float) -> FloatArray:
    """A stem whose tip is above the anchor, and whose middle is not."""
    points = straight(0.0, tip_y_cm)
    points[:, 0] = bow_cm * np.sin(np.pi * np.linspace(0.0, 1.0, 10))
    return points


@pytest.mark.parametrize("points", [straight(-8.0, 15.0), straight(9.0, 15.0), straight(0.0, 21.0), straight(0.0, 6.5)])
def test_a_stem_within_the_range_is_not_beyond_it(points: FloatArray) -> None:
    assert MET.beyond(points) == (0.0, "")


@pytest.mark.parametrize(
    ("points", "far_cm", "way"),
    [
        (straight(-10.5, 15.0), 2.5, "farther left"),
        (straight(9.5, 15.0), 0.5, "farther right"),
        (bowed(8.0, 9.6), 0.45, "farther right"),
        (straight(1.0, 25.0), 4.0, "higher"),
        (straight(8.0, 5.0), 1.0, "lower"),
    ],
)
def test_the_way_in_which_a_stem_is_farthest_beyond_is_told(points: FloatArray, far_cm: float, way: str) -> None:
    found_cm, said = MET.beyond(points)

    assert found_cm == pytest.approx(far_cm, abs=0.01)
    assert said == way


def test_a_stem_that_bends_more_than_any_is_longer_though_it_is_within_on_all_sides() -> None:
    to_and_fro = straight(0.0, 18.0)
    to_and_fro[1::2, 0] = 5.0

    far_cm, way = MET.beyond(to_and_fro)

    assert way == "longer"
    assert far_cm == pytest.approx(polyline_length(to_and_fro) - 24.0)
    assert far_cm > 20.0


def test_a_seedling_grows_into_the_range_and_a_stem_that_has_sunk_has_left_it() -> None:
    assert MET.beyond(straight(0.0, 1.5)) == (0.0, "")
    assert MET.beyond(straight(7.0, 1.5)) == (4.5, "lower")


def test_a_stem_that_grows_on_is_told_by_its_height_alone() -> None:
    taller = straight(0.0, 29.0)

    assert polyline_length(taller) > MET.longest_cm
    assert MET.beyond(taller) == (8.0, "higher")


def test_the_range_of_stems_holds_each_of_them() -> None:
    draw = np.random.default_rng(1)
    stems = straight(0.0, 12.0) + draw.normal(scale=2.0, size=(50, 10, 2))

    met = range_of(stems)

    assert met.is_ordered
    assert [met.beyond(stem) for stem in stems] == [(0.0, "")] * 50
    assert met.left_cm == pytest.approx(stems[..., 0].min(), abs=0.01)
    assert met.highest_tip_cm == pytest.approx(stems[:, -1, 1].max(), abs=0.01)
    assert met.longest_cm == round(met.longest_cm, 2)
