"""How far off an end may be: what is seen from it, the sums, what was learnt, and a second look."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np
import pytest

from flora_common.arrays import Float32Array, FloatArray
from flora_common.vision.path import apex_error, guide
from flora_common.vision.path.apex_error import LIMITS_CM, Perceptron, error_cm, perceptron, together, views_of
from flora_common.vision.path.evidence import Evidence
from flora_common.vision.path.guide import Way
from flora_common.vision.path.second_look import confirmed
from guide.budding import Budding
from guide.canvas import PX_PER_CM
from guide.examples import Example
from guide.misleading import misleading_example
from guide.modelled import modelled_example
from guide.wild import wild_example

SIZE_PX: Final = 120
SCALE: Final = 6.0
HOOK: Final = np.array([[30.0, 110.0], [34.0, 90.0], [36.0, 70.0], [44.0, 61.0], [53.0, 64.0], [56.0, 71.0]])
ALONG: Final = np.array([0.9, 0.8, 0.7, 0.9, 0.6, 0.5])


def planes(seed: int = 1) -> Float32Array:
    """Some picture, smooth enough that places between pixels are what they are in a mirror."""
    return np.random.default_rng(seed).uniform(0.0, 200.0, (SIZE_PX, SIZE_PX, 6)).astype(np.float32)


def seen(picture: Float32Array, line: FloatArray) -> FloatArray:
    return views_of(picture, line, ALONG, 0.4, 0.05, SCALE)


def test_a_mirror_only_changes_sides() -> None:
    picture = planes()
    own, turned = seen(picture, HOOK)
    assert not np.allclose(own, turned)
    mirrored = HOOK * [-1.0, 1.0] + [SIZE_PX - 1.0, 0.0]
    other, back = seen(np.ascontiguousarray(picture[:, ::-1]), mirrored)
    assert other == pytest.approx(turned, abs=0.5)
    assert back == pytest.approx(own, abs=0.5)


def test_what_lies_ahead_comes_first_whichever_way_the_end_looks() -> None:
    """A patch beyond the end is seen in the first direction of a ring, and nowhere else."""
    for angle in np.linspace(0.0, 2.0 * np.pi, 7):
        ahead = np.array([np.cos(angle), np.sin(angle)])
        end = np.array([60.0, 60.0])
        line = end + ahead * np.linspace(-30.0, 0.0, 20)[:, None]
        x, y = end + 1.2 * SCALE * ahead
        picture = np.zeros((SIZE_PX, SIZE_PX, 6), np.float32)
        rows, columns = np.indices((SIZE_PX, SIZE_PX))
        picture[..., 0] = np.exp(-0.5 * ((columns - x) ** 2 + (rows - y) ** 2) / 1.5**2)
        told = views_of(picture, line, ALONG, 0.4, 0.05, SCALE)[0]
        rings = apex_error.RINGS_CM
        first = len(told) - 6 * (len(rings) * apex_error.ANGLES + len(apex_error.BELOW_CM) * len(apex_error.ASIDE_CM))
        ring = told[first:][: 6 * len(rings) * apex_error.ANGLES].reshape(len(rings), apex_error.ANGLES, 6)[..., 0]
        assert np.unravel_index(ring.argmax(), ring.shape) == (rings.index(1.2), 0)
        assert ring[rings.index(1.2), 3:10].max() < 0.01


@pytest.mark.parametrize("length_px", [0.5, 3.0, 12.0])
def test_a_line_that_is_shorter_than_what_is_looked_at_is_seen_all_the_same(length_px: float) -> None:
    line = np.array([[60.0, 60.0], [60.0, 60.0 - length_px]])
    told = views_of(planes(), line, np.array([0.9, 0.9]), 0.4, 0.05, SCALE)
    assert np.isfinite(told).all()


def test_an_end_at_the_margin_is_seen_all_the_same() -> None:
    line = np.array([[60.0, 60.0], [1.0, 0.0]])
    assert np.isfinite(views_of(planes(), line, np.array([0.9, 0.0]), 0.0, 0.0, SCALE)).all()


def test_chances_fall_from_limit_to_limit_and_do_not_depend_on_the_order_of_sums() -> None:
    net, rng = perceptron(), np.random.default_rng(4)
    for _ in range(20):
        views = net.middle + net.spread * rng.normal(0.0, 2.0, (2, len(net.middle)))
        chances = net.chances(views)
        assert chances.shape == (len(LIMITS_CM),)
        assert (np.diff(chances) <= 0.0).all()
        assert (chances >= 0.0).all()
        assert (chances <= 1.0).all()
        assert net.chances(views[::-1]).tobytes() == chances.tobytes()
        order = rng.permutation(len(net.middle))
        inner = np.vstack([net.inner[:-1][order], net.inner[-1:]])
        other = replace(net, middle=net.middle[order], spread=net.spread[order], inner=inner)
        assert other.chances(views[:, order]).tobytes() == chances.tobytes()


def test_how_far_off_it_is_in_the_mean() -> None:
    assert error_cm(np.zeros(len(LIMITS_CM))) == 0.0
    assert error_cm(np.ones(len(LIMITS_CM))) == apex_error.BETWEEN_CM[-1]
    first = np.array([0.25, 0.0, 0.0, 0.0])
    assert error_cm(first) == pytest.approx(0.5 * apex_error.BETWEEN_CM[0])
    # each distance lies between its limits
    for low, between, high in zip(LIMITS_CM, apex_error.BETWEEN_CM, (*LIMITS_CM[1:], 99.0), strict=True):
        assert low < between < high


def test_a_file_that_is_damaged_is_not_believed() -> None:
    net = perceptron()
    with pytest.raises(ValueError, match="fit together"):
        Perceptron(net.middle[:-1], net.spread, net.inner, net.outer)
    with pytest.raises(ValueError, match="fit together"):
        Perceptron(net.middle, net.spread, net.inner, net.outer[:, :-1])
    bad = net.inner.copy()
    bad[3, 2] = np.nan
    with pytest.raises(ValueError, match="numbers that are none"):
        Perceptron(net.middle, net.spread, bad, net.outer)


HELD_OUT: Final = range(2_000_000, 2_000_120)
"""Plants that were not learnt from, neither by the network nor by the perceptron."""
OF_WILD: Final = 70
"""So many of these have ends enough that are off."""


@cache
def ends(made: Callable[[int], Example | None]) -> list[tuple[float, FloatArray, FloatArray]]:
    """How far off the likeliest ends are, cm, that anybody would believe; the chances by one look, and by two."""
    found = []
    for seed in HELD_OUT[:OF_WILD] if made is wild_example else HELD_OUT:
        example = made(seed)
        if example is None:
            continue
        evidence = Evidence((7, 5), example.plant.astype(np.float32), example.code, 1.0)
        line = example.line + evidence.origin_px
        way = guide.everywhere(evidence, line[0].astype(np.float64), PX_PER_CM)[0]
        if way.sure < 0.13:
            continue
        twice = confirmed(way, evidence, PX_PER_CM)
        assert way.off is not None
        assert twice.off is not None
        found.append((float(np.hypot(*(way.tip_px - line[-1]))) / PX_PER_CM, way.off, twice.off))
    return found


def told_apart(off: np.ndarray, chance: FloatArray) -> float:
    """The share of pairs of an end that is off and one that is not of which the first has the greater chance."""
    return float((chance[off][:, None] > chance[~off][None]).mean())


def budding_example(seed: int) -> Example | None:
    return modelled_example(seed, Budding)


SLOW: Final = wild_example, misleading_example, budding_example
ALL: Final = *SLOW, modelled_example


@pytest.mark.parametrize("made", [*(pytest.param(made, marks=pytest.mark.slow) for made in SLOW), modelled_example])
def test_ends_that_are_off_are_told_from_others_in_plants_that_were_not_learnt_from(
    made: Callable[[int], Example | None],
) -> None:
    off = np.array([end[0] for end in ends(made)]) > LIMITS_CM[1]
    assert min(np.count_nonzero(off), np.count_nonzero(~off)) >= 10
    for look in (1, 2):
        assert told_apart(off, np.array([end[look][1] for end in ends(made)])) > 0.75


some_or_all = pytest.mark.parametrize("kinds", [(modelled_example,), pytest.param(ALL, marks=pytest.mark.slow)])


@some_or_all
def test_chances_mean_what_they_say(kinds: Sequence[Callable[[int], Example | None]]) -> None:
    """Of all these ends as many are off as their chances come to, within three standard deviations."""
    told = [end for made in kinds for end in ends(made)]
    for k, limit in enumerate(LIMITS_CM):
        chance = np.array([end[1][k] for end in told])
        off = np.count_nonzero([end[0] > limit for end in told])
        assert abs(off - chance.sum()) < 3.0 * np.sqrt((chance * (1.0 - chance)).sum())


@some_or_all
def test_a_second_look_sees_the_same_end(kinds: Sequence[Callable[[int], Example | None]]) -> None:
    for made in kinds:
        once, twice = (np.log([end[k][1] for end in ends(made)]) for k in (1, 2))
        assert np.corrcoef(once, twice)[0, 1] > 0.9, "a mirror must not matter much"
        assert np.abs(once - twice).max() > 0.0


def test_what_was_not_looked_at_is_not_seen_by_a_second_look() -> None:
    line = np.array([[10.0, 40.0], [10.0, 10.0]])
    nothing = Way(line[-1], 0.3, line, np.full(2, 0.9))
    empty = Evidence((0, 0), np.zeros((60, 60), np.float32), np.zeros((60, 60, 3), np.uint8), 1.0)
    assert confirmed(nothing, empty, SCALE) is nothing


def test_two_looks_count_alike() -> None:
    some, other = np.array([0.5, 0.2, 0.0, 0.0]), np.array([0.5, 0.4, 0.1, 0.0])
    both = together(some, other)
    assert both == pytest.approx(together(other, some))
    assert both[0] == pytest.approx(0.5)
    assert 0.2 < both[1] < 0.4
    assert together(some, some)[:2] == pytest.approx(some[:2])
    assert np.isfinite(together(np.zeros(4), np.ones(4))).all()
