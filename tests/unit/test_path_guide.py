"""The network that tells where stem and apex are: its sums, its ways, and what it has learnt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
import pytest

from flora_common.arrays import FloatArray
from flora_common.vision.path import convolutions, guide
from flora_common.vision.path.convolutions import EXACT, HEAD, LAYERS, MOST, Layer, Network, convolved
from flora_common.vision.path.evidence import Evidence
from flora_common.vision.path.sampler import normals
from guide.canvas import PX_PER_CM
from guide.examples import Example
from guide.misleading import misleading_example
from guide.modelled import modelled_example
from guide.scapes import Scape
from guide.wild import wild_example

HELD_OUT: Final = range(2_000_000, 2_000_060)
"""Plants that were not learnt from."""

scape_example = partial(modelled_example, habit=Scape)


def by_hand(weight: FloatArray, x: FloatArray, stride: int, dilation: int) -> FloatArray:
    """A convolution as it is written down, in whole numbers."""
    out, _, side, _ = weight.shape
    around = dilation * (side // 2)
    padded = np.pad(x.astype(np.int64), ((0, 0), (around, around), (around, around)))
    height, width = (n // stride for n in x.shape[1:])
    result = np.zeros((out, height, width), np.int64)
    for row in range(height):
        for column in range(width):
            y, z = row * stride, column * stride
            part = padded[:, y : y + dilation * side : dilation, z : z + dilation * side : dilation]
            result[:, row, column] = (weight.astype(np.int64) * part).sum(axis=(1, 2, 3))
    return result


@pytest.mark.parametrize(("side", "stride", "dilation"), [(3, 1, 1), (3, 2, 1), (3, 1, 2), (3, 1, 4), (1, 1, 1)])
def test_sums_are_exact(side: int, stride: int, dilation: int) -> None:
    rng = np.random.default_rng(1)
    weight = rng.integers(-900, 900, (5, 7, side, side)).astype(np.float32)
    x = rng.integers(0, int(MOST) + 1, (7, 12, 16)).astype(np.float32)
    found = convolved(weight, x, stride=stride, dilation=dilation)
    assert np.array_equal(found.astype(np.int64), by_hand(weight, x, stride, dilation))


def test_a_large_picture_is_summed_in_bands_to_the_same_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    weight = rng.integers(-900, 900, (4, 3, 3, 3)).astype(np.float32)
    x = rng.integers(0, int(MOST) + 1, (3, 40, 24)).astype(np.float32)
    for stride, dilation in ((1, 1), (2, 1), (1, 4)):
        whole = convolved(weight, x, stride=stride, dilation=dilation)
        with monkeypatch.context() as patch:
            patch.setattr(convolutions, "MOST_TAPS", 3000)
            assert np.array_equal(convolved(weight, x, stride=stride, dilation=dilation), whole)


def test_the_same_picture_gives_the_same_bits_wherever_it_lies_in_memory() -> None:
    picture = np.random.default_rng(2).integers(0, 256, (4, 64, 80)).astype(np.float32)
    first = guide.network()(picture)
    for off in range(1, 16):
        room = np.zeros(picture.size + 16, np.float32)
        moved = room[off : off + picture.size].reshape(picture.shape)
        moved[:] = picture
        assert guide.network()(moved).tobytes() == first.tobytes()


def layer(**changed: object) -> Layer:
    """One that is well, but for what is changed."""
    arrays = {
        "weight": np.ones((2, 3, 3, 3), np.float32),
        "factor": np.ones(2, np.float32),
        "shift": np.zeros(2, np.float32),
    }
    return Layer(**{**arrays, **changed})


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"weight": np.full((2, 3, 3, 3), 0.5, np.float32)}, "whole"),
        ({"weight": np.full((2, 3, 3, 3), EXACT / MOST / 26, np.float32)}, "exact"),
        ({"shift": np.full(2, np.nan, np.float32)}, "none"),
        ({"factor": np.ones(3, np.float32)}, "fit together"),
    ],
)
def test_a_layer_that_cannot_be_summed_exactly_is_refused(changed: dict[str, object], reason: str) -> None:
    layer()
    with pytest.raises(ValueError, match=reason):
        layer(**changed)


def test_a_network_without_one_of_its_layers_is_refused() -> None:
    layers = {name: layer() for name in (*LAYERS, HEAD) if name != "d1"}
    with pytest.raises(ValueError, match="d1 is missing"):
        Network(layers)


def seen(example: Example) -> Evidence:
    """The evidence of an example, somewhere in a larger picture."""
    return Evidence((40, 60), example.plant.astype(np.float32), example.code, 1.0)


def maps_of(evidence: Evidence) -> guide.Maps:
    return guide.Maps(evidence, PX_PER_CM, np.array(evidence.origin_px), guide.SEEN_CM)


def test_more_light_on_everything_changes_nothing_that_the_network_is_shown() -> None:
    evidence = seen(wild_example(HELD_OUT[0]))
    code = np.clip(evidence.code, 30, 200)
    both = [replace(evidence, code=code + k) for k in (0, 25)]
    dark, bright = (guide.network_input(one, guide.mean_colour(one), (90, 70)) for one in both)
    assert np.abs(dark - bright).max() <= 1.0


def test_the_cheapest_way_goes_along_a_stem_and_round_its_bend() -> None:
    """Two bands from the anchor: one goes up and comes down again, the other is a straight one of nothing."""
    maps = maps_of(seen(wild_example(HELD_OUT[0])))
    height, width = 60, 50
    stem, apex = np.full((height, width), 1e-3), np.full((height, width), 1e-4)
    stem[10:56, 12], stem[10, 12:40], stem[10:41, 40] = 0.9, 0.9, 0.9
    apex[40, 40] = 0.7
    maps.stem, maps.apex = stem, apex
    anchor = maps.to_px(np.array([12.0, 55.0]))
    (way,) = guide.ways(maps, anchor, PX_PER_CM)
    assert np.allclose(way.line_px[0], anchor)
    assert np.hypot(*(way.tip_px - maps.to_px(np.array([40.0, 40.0])))) < PX_PER_CM / 10
    corner = maps.to_px(np.array([12.0, 10.0]))
    assert np.hypot(*(way.line_px - corner).T).min() < 0.3 * PX_PER_CM
    assert 0.5 < way.sure < 0.7
    assert way.elsewhere == pytest.approx(1e-4), "it is the only one"


def test_an_apex_elsewhere_is_one_seven_millimetres_off_be_it_a_peak_or_not() -> None:
    maps = maps_of(seen(wild_example(HELD_OUT[0])))
    maps.apex = np.full((60, 50), 1e-4)
    maps.apex[30, 20], maps.apex[30, 23], maps.apex[30, 26] = 0.5, 0.4, 0.1
    place, apart_px = maps.to_px(np.array([20.0, 30.0])), guide.ELSEWHERE_CM * PX_PER_CM
    assert maps.likeliest_beyond(place, apart_px) == pytest.approx(0.1), "3 px of 6 to a cm are half of one"
    assert maps.likeliest_beyond(place, 10.0 * apart_px) == pytest.approx(0.0, abs=1e-3)


def test_an_apex_behind_a_gap_is_less_sure_than_one_on_the_stem() -> None:
    maps = maps_of(seen(wild_example(HELD_OUT[0])))
    stem, apex = np.full((60, 50), 1e-3), np.full((60, 50), 1e-4)
    stem[20:56, 12], stem[5:30, 40] = 0.9, 0.9
    apex[20, 12], apex[5, 40] = 0.4, 0.8
    maps.stem, maps.apex = stem, apex
    ways = guide.ways(maps, maps.to_px(np.array([12.0, 55.0])), PX_PER_CM)
    assert [round(float(one.tip_px[0])) for one in ways] == [
        round(float(maps.to_px(np.array([x, 0.0]))[0])) for x in (12.0, 40.0)
    ]


def bowed(line: FloatArray, aside_px: float) -> FloatArray:
    """A line that is so far off in its middle, and not at its ends."""
    share = np.sin(np.linspace(0.0, np.pi, len(line)))[:, None]
    return np.asarray(line + share * aside_px * normals(line), dtype=np.float64)


@pytest.mark.parametrize("aside_cm", [-0.35, 0.35])
def test_a_known_line_is_moved_to_the_middle_of_what_is_likely(aside_cm: float) -> None:
    maps = maps_of(seen(wild_example(HELD_OUT[0])))
    rows, columns = np.indices((60, 50))
    maps.stem = 0.9 * np.exp(-0.5 * ((columns - 25.0 - 4.0 * np.sin(rows / 20.0)) / 0.8) ** 2)
    y = np.linspace(55.0, 8.0, 300)
    true = maps.to_px(np.column_stack([25.0 + 4.0 * np.sin(y / 20.0), y]))
    line, along = guide.in_middle(maps, bowed(true, aside_cm * PX_PER_CM), PX_PER_CM)
    assert np.array_equal(line[[0, -1]], true[[0, -1]])
    off_cm = np.hypot(*(line[:, None] - true[None]).transpose(2, 0, 1)).min(axis=1) / PX_PER_CM
    assert off_cm.max() < 0.12
    assert np.median(off_cm) < 0.02, "which was 0.25 cm off"
    assert np.median(along) > 0.7


def test_a_known_line_where_nothing_is_likely_is_not_sure() -> None:
    maps = maps_of(seen(wild_example(HELD_OUT[0])))
    maps.stem = np.full((60, 50), 1e-4)
    line = maps.to_px(np.column_stack([np.full(200, 25.0), np.linspace(55.0, 8.0, 200)]))
    kept, along = guide.in_middle(maps, line, PX_PER_CM)
    assert np.abs(kept - line).max() < 0.01 * PX_PER_CM
    assert along.max() < 0.01


def test_a_stem_that_swung_is_found_again_and_one_that_is_gone_is_not_sure() -> None:
    moved_cm, sure, gone = [], [], []
    for seed in HELD_OUT[:20]:
        example = wild_example(seed)
        evidence = seen(example)
        line = (example.line + evidence.origin_px).astype(np.float64)
        way = guide.near(evidence, bowed(line, 0.3 * PX_PER_CM), PX_PER_CM)
        apart = np.hypot(*(way.line_px[:, None] - line[None]).transpose(2, 0, 1)).min(axis=1)
        moved_cm.append(float(np.median(apart)) / PX_PER_CM)
        sure.append(way.sure)
        gone.append(guide.near(evidence, bowed(line, 2.0 * PX_PER_CM), PX_PER_CM).sure)
    assert np.median(moved_cm) < 0.06, "which was 0.2 cm off"
    assert np.median(sure) > 3.0 * np.median(gone)


@pytest.mark.parametrize(
    ("made", "off_by_cm", "share_of_trivial"),
    [
        (wild_example, 0.45, 0.1),
        (misleading_example, 0.3, 0.1),
        (modelled_example, 0.45, 0.2),
        (scape_example, 0.45, 0.5),
    ],
)
def test_plants_that_were_not_learnt_from_are_seen(
    made: Callable[[int], Example | None], off_by_cm: float, share_of_trivial: float
) -> None:
    """Beside a trivial answer, the plant's place that is farthest from the anchor."""
    off_cm, trivial_cm, line_cm = [], [], []
    for seed in HELD_OUT[:40]:
        example = made(seed)
        if example is None:
            continue
        evidence = seen(example)
        line = example.line + evidence.origin_px
        best = guide.everywhere(evidence, line[0].astype(np.float64), PX_PER_CM)[0]
        off_cm.append(float(np.hypot(*(best.tip_px - line[-1]))) / PX_PER_CM)
        rows, columns = np.nonzero(example.plant)
        away = np.hypot(columns - example.line[0, 0], rows - example.line[0, 1])
        far = int(np.argmax(away))
        trivial_cm.append(
            float(np.hypot(columns[far] - example.line[-1, 0], rows[far] - example.line[-1, 1])) / PX_PER_CM
        )
        apart = np.hypot(*(best.line_px[:, None] - line[None]).transpose(2, 0, 1)).min(axis=1)
        line_cm.append(float(np.median(apart)) / PX_PER_CM)
    assert np.median(off_cm) < off_by_cm
    assert np.median(off_cm) < share_of_trivial * np.median(trivial_cm)
    assert np.median(line_cm) < 0.06


@pytest.mark.parametrize("made", [wild_example, misleading_example, modelled_example, scape_example])
def test_plants_to_learn_from_have_their_stem_where_they_say(made: Callable[[int], Example | None]) -> None:
    shown, examples = [], [made(seed) for seed in HELD_OUT[:20]]
    for example in examples:
        if example is None:
            continue
        x, y = np.round(example.line).astype(int).T
        height, width = example.plant.shape
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        shown.append(float((example.plant[y[inside], x[inside]] > 0).mean()))
    assert len(shown) > 15
    assert np.median(shown) > 0.9


def test_a_seed_makes_the_same_plant_again() -> None:
    for made in (misleading_example, modelled_example, scape_example):
        one, again, other = made(HELD_OUT[0]), made(HELD_OUT[0]), made(HELD_OUT[1])
        assert one is not None
        assert again is not None
        assert other is not None
        assert np.array_equal(one.code, again.code)
        assert np.array_equal(one.line, again.line)
        assert one.code.shape != other.code.shape or not np.array_equal(one.code, other.code)
