"""Collision, clearance, fitness and resampling against brute force and hand-made values."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from flora_common.arrays import FloatArray
from flora_common.geometry import (
    clearance_cm,
    collides,
    distance_to_polyline_cm,
    resample_by_height,
    turned_right,
)
from flora_common.shapes import Obstacle, Target

BOX = Obstacle(x_cm=0.0, y_cm=10.0, width_cm=4.0, height_cm=2.0)
# Two decimals: touching by a rounding error is no question for brute force.
COORDINATE = st.integers(-1500, 2500).map(lambda n: n / 100)
POLYLINE = st.lists(st.tuples(COORDINATE, COORDINATE), min_size=2, max_size=10)
RECTANGLE = st.builds(
    Obstacle,
    x_cm=COORDINATE,
    y_cm=COORDINATE,
    width_cm=st.integers(1, 1500).map(lambda n: n / 100),
    height_cm=st.integers(1, 1500).map(lambda n: n / 100),
)


def sampled(points: list[tuple[float, float]], steps: int = 2000) -> FloatArray:
    line = np.asarray(points)
    t = np.linspace(0.0, 1.0, steps)[:, None]
    return np.concatenate([a + t * (b - a) for a, b in itertools.pairwise(line)])


def distances(points: FloatArray, box: Obstacle) -> FloatArray:
    """Distance of each point to the closed rectangle."""
    dx = np.maximum(np.maximum(box.left_cm - points[:, 0], points[:, 0] - box.right_cm), 0.0)
    dy = np.maximum(np.maximum(box.bottom_cm - points[:, 1], points[:, 1] - box.top_cm), 0.0)
    found: FloatArray = np.hypot(dx, dy)
    return found


def grown(box: Obstacle, by_cm: float) -> Obstacle:
    return Obstacle(box.x_cm, box.y_cm, box.width_cm + 2 * by_cm, box.height_cm + 2 * by_cm)


@settings(max_examples=300, deadline=None)
@given(points=POLYLINE, box=RECTANGLE)
def test_collision_agrees_with_brute_force(points: list[tuple[float, float]], box: Obstacle) -> None:
    nearest = float(distances(sampled(points), box).min())
    longest_step = max(np.hypot(*np.subtract(b, a)) for a, b in itertools.pairwise(points)) / 1999
    # What touches by less than a rounding error may be told either way.
    if collides(points, grown(box, -1e-6)):
        assert collides(points, box)
        assert nearest <= longest_step
    if not collides(points, grown(box, 1e-6)):
        assert not collides(points, box)
        assert nearest > 0.0


@settings(max_examples=300, deadline=None)
@given(points=POLYLINE, box=RECTANGLE)
def test_clearance_agrees_with_brute_force(points: list[tuple[float, float]], box: Obstacle) -> None:
    nearest = float(distances(sampled(points), box).min())
    longest_step = max(np.hypot(*np.subtract(b, a)) for a, b in itertools.pairwise(points)) / 1999
    assert clearance_cm(points, box) == pytest.approx(nearest, abs=longest_step + 1e-9)
    assert clearance_cm(points, box) == 0.0 or not collides(points, box)


@pytest.mark.parametrize(
    ("points", "hit"),
    [
        ([(-5, 10), (5, 10)], True),  # straight through, no point inside
        ([(0, 0), (0, 9)], True),  # ends on the edge, which belongs to it
        ([(0, 0), (0, 8.99)], False),
        ([(-2, 0), (-2, 20)], True),  # along the left edge
        ([(-2.01, 0), (-2.01, 20)], False),
        ([(-1, 9.5), (1, 10.5)], True),  # wholly inside
        ([(-3, 9), (-2, 8), (0, 8.5), (2, 8), (3, 9)], False),  # below, around
        ([(-4, 9.01), (0, 13.01)], False),  # past the corner
        ([(-3, 10), (-1, 12)], True),  # through the corner
        ([(0, 10), (0, 10)], True),  # a stem of no length, inside
        ([(9, 9), (9, 9)], False),
    ],
)
def test_collision_by_hand(points: list[tuple[float, float]], hit: bool) -> None:
    assert collides(points, BOX) is hit


def test_clearance_by_hand() -> None:
    assert clearance_cm([(0, 0), (0, 6)], BOX) == pytest.approx(3.0)
    assert clearance_cm([(5, 0), (5, 20)], BOX) == pytest.approx(3.0)
    assert clearance_cm([(5, 15), (9, 15)], BOX) == pytest.approx(5.0)  # 3 and 4 from the corner (2, 11)


def test_distance_to_polyline_by_hand() -> None:
    line = [(0.0, 0.0), (0.0, 10.0), (4.0, 10.0)]
    found = distance_to_polyline_cm([(3.0, 5.0), (0.0, -2.0), (2.0, 13.0), (7.0, 14.0)], line)
    assert found == pytest.approx([3.0, 2.0, 3.0, 5.0])


@pytest.mark.parametrize(
    ("tip", "value"),
    [
        ((-5.12, 17.9), 1.0),  # on the target
        ((0.0, 0.0), 0.0),  # at the anchor: nothing gained
        ((-5.12, 0.0), 5.12 / 23.02),  # x alone is right
        ((0.0, 17.9), 17.9 / 23.02),  # y alone is right
        ((5.12, 17.9), (17.9 - 5.12) / 23.02),  # x as far off on the other side
        ((-10.24, 17.9), 17.9 / 23.02),  # overshot by as much as there was to go
        ((0.0, 35.8), 0.0),
        ((5.12, -17.9), -1.0),
    ],
)
def test_fitness_is_the_papers(tip: tuple[float, float], value: float) -> None:
    assert Target(x_cm=-5.12, y_cm=17.9).fitness(*tip) == pytest.approx(value)


def test_fitness_of_a_target_at_the_anchor_is_not_defined() -> None:
    with pytest.raises(ValueError, match="not defined for a target at the anchor"):
        Target(0.0, 0.0).fitness(1.0, 1.0)


@given(COORDINATE, COORDINATE, COORDINATE, COORDINATE)
def test_fitness_is_best_on_the_target_and_the_same_mirrored(tx: float, ty: float, x: float, y: float) -> None:
    assume(abs(tx) + abs(ty) > 0)
    value = Target(tx, ty).fitness(x, y)
    assert value <= 1.0
    assert Target(-tx, ty).fitness(-x, y) == pytest.approx(value)


def test_target_contains_its_edge() -> None:
    target = Target(1.0, 10.0, radius_cm=2.0)
    assert target.contains(3.0, 10.0)
    assert not target.contains(3.01, 10.0)
    assert target.distance_cm(4.0, 14.0) == pytest.approx(5.0)


def test_resampling_a_straight_stem_gives_even_points() -> None:
    points = resample_by_height([(0.0, 0.0), (9.0, 18.0)])
    assert points[:, 1] == pytest.approx(np.arange(10) * 2.0)
    assert points[:, 0] == pytest.approx(np.arange(10) * 1.0)


def test_resampling_a_fold_takes_the_passage_nearest_the_anchor() -> None:
    folded = [(0.0, 0.0), (0.0, 12.0), (2.0, 12.0), (2.0, 9.0)]
    points = resample_by_height(folded)
    assert points[-1] == pytest.approx([2.0, 9.0])
    assert points[:-1, 0] == pytest.approx(np.zeros(9))
    assert points[:, 1] == pytest.approx(np.arange(10))


@settings(max_examples=200, deadline=None)
@given(points=st.lists(st.tuples(COORDINATE, st.integers(1, 300)), min_size=1, max_size=12))
def test_resampled_points_lie_on_the_stem(points: list[tuple[float, int]]) -> None:
    heights = np.cumsum([step for _, step in points]) / 100
    line = np.array([(0.0, 0.0), *zip([x for x, _ in points], heights, strict=True)])
    found = resample_by_height(line)
    assert found.shape == (10, 2)
    assert found[0] == pytest.approx(line[0])
    assert found[-1] == pytest.approx(line[-1])
    assert found[:, 1] == pytest.approx(np.linspace(0.0, line[-1, 1], 10))
    assert distance_to_polyline_cm(found, line).max() < 1e-9


def test_a_stem_is_turned_to_the_right_about_its_foot() -> None:
    upright = np.array([[[0.0, 0.0], [0.0, 2.0]], [[0.0, 0.0], [-2.0, 0.0]]])
    turned = turned_right(upright, np.radians([90.0, 90.0]))
    assert turned == pytest.approx(np.array([[[0.0, 0.0], [2.0, 0.0]], [[0.0, 0.0], [0.0, 2.0]]]))
