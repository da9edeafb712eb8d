"""How far off an end may be: what is seen from it, the sums, what was learnt, and a second look."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Final

import numpy as np
import pytest

from flora_common.arrays import Float32Array, FloatArray
from flora_common.vision.path import apex_error, guide
from flora_common.vision.path.along_way import FIRST_SHARE_OF_TWO, USABLE, stands_out
from flora_common.vision.path.apex_error import LIMITS_CM, Perceptron, error_cm, perceptron, views_of
from flora_common.vision.path.evidence import Evidence
from flora_common.vision.path.guide import Way
from flora_common.vision.path.second_look import closely
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


@dataclass(frozen=True)
class End:
    """The likeliest end of a plant.

    Attributes:
        off_cm: how far off it is.
        sure, elsewhere, off: see :class:`flora_common.vision.path.guide.Way`.
    """

    off_cm: float
    sure: float
    elsewhere: float
    off: FloatArray


@cache
def ends(made: Callable[[int], Example | None]) -> list[tuple[End, End]]:
    """The likeliest ends by one look, and by four."""
    found = []
    for seed in HELD_OUT[:OF_WILD] if made is wild_example else HELD_OUT:
        example = made(seed)
        if example is None:
            continue
        evidence = Evidence((7, 5), example.plant.astype(np.float32), example.code, 1.0)
        line = example.line + evidence.origin_px
        looks = [look(evidence, line[0].astype(np.float64), PX_PER_CM)[0] for look in (guide.everywhere, closely)]
        found.append((end_of(looks[0], line[-1]), end_of(looks[1], line[-1])))
    return found


def end_of(way: Way, true_px: FloatArray) -> End:
    assert way.off is not None
    return End(float(np.hypot(*(way.tip_px - true_px))) / PX_PER_CM, way.sure, way.elsewhere, way.off)


def usable(made: Callable[[int], Example | None], look: int = 0) -> list[End]:
    """Of one look, ends that somebody would believe."""
    return [pair[look] for pair in ends(made) if pair[look].sure >= USABLE]


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
    off = np.array([end.off_cm for end in usable(made)]) > LIMITS_CM[1]
    assert min(np.count_nonzero(off), np.count_nonzero(~off)) >= 10
    assert told_apart(off, np.array([end.off[1] for end in usable(made)])) > 0.75


some_or_all = pytest.mark.parametrize("kinds", [(modelled_example,), pytest.param(ALL, marks=pytest.mark.slow)])


@some_or_all
def test_chances_mean_what_they_say(kinds: Sequence[Callable[[int], Example | None]]) -> None:
    """Of all these ends as many are off as their chances come to, within three standard deviations."""
    told = [end for made in kinds for end in usable(made)]
    for k, limit in enumerate(LIMITS_CM):
        chance = np.array([end.off[k] for end in told])
        off = np.count_nonzero([end.off_cm > limit for end in told])
        assert abs(off - chance.sum()) < 3.0 * np.sqrt((chance * (1.0 - chance)).sum())


def is_believed(end: End) -> bool:
    return bool(stands_out(end.sure, end.elsewhere, FIRST_SHARE_OF_TWO))


@some_or_all
def test_four_looks_are_right_more_often_than_one(kinds: Sequence[Callable[[int], Example | None]]) -> None:
    """Nearer in the mean, no fewer ends that are believed by themselves, and fewer of these that are plainly off."""
    once, closer = zip(*(pair for made in kinds for pair in ends(made)), strict=True)
    off_cm = [np.mean([min(end.off_cm, 5.0) for end in look]) for look in (once, closer)]
    believed = [[end for end in look if is_believed(end)] for look in (once, closer)]
    wrong = [np.mean([end.off_cm > LIMITS_CM[1] for end in look]) for look in believed]
    last = [end for made in kinds for end in usable(made, 1)]
    assert (
        told_apart(np.array([end.off_cm for end in last]) > LIMITS_CM[1], np.array([end.off[1] for end in last])) > 0.75
    )
    assert off_cm[1] < off_cm[0]
    assert len(believed[1]) > 0.9 * len(believed[0])
    assert wrong[1] < wrong[0]


def test_four_looks_at_a_place_are_at_the_same_place() -> None:
    """The mean does not depend on where in the full picture the plant stands."""
    example = next(made for seed in HELD_OUT if (made := modelled_example(seed)) is not None)
    tips = []
    for x, y in ((0, 0), (31, 17)):
        evidence = Evidence((x, y), example.plant.astype(np.float32), example.code, 1.0)
        ways = closely(evidence, example.line[0] + np.array([x, y], dtype=np.float64), PX_PER_CM)
        tips.append(ways[0].tip_px - np.array([x, y]))
    assert tips[0] == pytest.approx(tips[1], abs=1e-6)
    mirrored = Evidence((31, 17), example.plant.astype(np.float32), example.code, 1.0)
    places = np.array([[31.0, 20.0], [40.5, 18.0]])
    assert mirrored.mirrored_px(mirrored.mirrored_px(places)) == pytest.approx(places)
    assert mirrored.mirrored_px(places)[0, 0] == 31.0 + example.plant.shape[1] - 1.0
