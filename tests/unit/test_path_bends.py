"""Stems that bend tightly, leaves told by their colour, stems that are not left at once, and honest doubt."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from path_fakes import ANCHOR, CAMERA, HEIGHT, SCALE, STEM, WIDTH, drawn, tip_error_mm

from flora_common.arrays import FloatArray
from flora_common.vision.lamp_states import from_background
from flora_common.vision.path import along_way, doubts
from flora_common.vision.path import tracker as tracker_module
from flora_common.vision.path.chain import Before, best_chain
from flora_common.vision.path.guide import Way
from flora_common.vision.path.sampler import Sampler
from flora_common.vision.path.trace import traced
from flora_common.vision.path.tracker import PathTracker
from flora_common.vision.reading import OCCLUDED, OK

_GRAIN = np.random.default_rng(11).normal(0.0, 90.0, (HEIGHT, WIDTH))
BOARD = np.clip(70.0 + cv2.GaussianBlur(_GRAIN, (0, 0), 6.0), 25, 160)[:, :, None] * np.array([1.05, 1.0, 0.95])
LEAF = (50, 190, 60)


def board(number: int) -> np.ndarray:
    picture = BOARD + np.random.default_rng(number).normal(0.0, 1.5, BOARD.shape)
    return np.clip(picture, 0, 255).astype(np.uint8)


def tracker() -> PathTracker:
    return PathTracker(from_background([board(1000 + k) for k in range(2)]), CAMERA)


def upright(height_cm: float) -> FloatArray:
    return np.column_stack([np.zeros(40), np.linspace(0.0, height_cm, 40)])


def hooked(height_cm: float, radius_cm: float, turn_rad: float) -> FloatArray:
    """Upright, then round a circle to the right."""
    t = np.linspace(0.0, turn_rad, 40)[1:]
    bend = np.column_stack([radius_cm * (1.0 - np.cos(t)), height_cm + radius_cm * np.sin(t)])
    return np.concatenate([upright(height_cm), bend])


@pytest.mark.parametrize("radius_cm", [0.35, 0.5, 0.8])
@pytest.mark.parametrize("turn_rad", [1.6, 2.2])
def test_a_tight_hook_is_followed_to_its_end(radius_cm: float, turn_rad: float) -> None:
    line = hooked(7.0, radius_cm, turn_rad)
    reading = tracker().read(drawn(board(1), line), 0.0)
    assert reading.outcome == OK
    assert tip_error_mm(reading, line) < 5.0  # a pixel of the network's maps is 1.7 mm


def test_an_end_that_only_rules_find_is_not_believed_unless_an_apex_was_seen_there_lately(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    line, one = hooked(7.0, 0.35, 1.6), tracker()
    seen = one.look(drawn(board(1), line))
    shown = seen
    monkeypatch.setattr(tracker_module, "closely", lambda *_: shown.ways)
    faint = replace(seen, ways=tuple(replace(way, sure=0.05) for way in seen.ways))
    shown = faint
    assert one.follow(faint, 0.0).outcome == OCCLUDED
    again = one.follow(replace(faint), 300.0)
    assert (again.outcome, again.reason) == (OCCLUDED, doubts.NO_APEX)
    shown = seen
    one.memory = None
    assert one.follow(replace(seen), 0.0).outcome == OK
    assert one.follow(replace(faint), 300.0).outcome == OK
    for k in range(2, 20):
        last = one.follow(replace(faint), 300.0 * k)
    assert (last.outcome, last.reason) == (OCCLUDED, doubts.NO_APEX)


@pytest.mark.parametrize(("radius_cm", "turn_rad"), [(0.5, 2.6), (0.8, 2.6), (0.8, 3.0)])
def test_a_hook_in_front_of_a_greener_leaf_is_followed_by_its_colour(radius_cm: float, turn_rad: float) -> None:
    line = hooked(7.0, radius_cm, turn_rad)
    picture = board(1)
    middle = np.array(ANCHOR) + (line[-1] + [0.1, 0.3]) * np.array([SCALE, -SCALE])
    cv2.ellipse(picture, tuple(np.rint(middle).astype(int).tolist()), (11, 19), 12.0, 0.0, 360.0, LEAF, -1, cv2.LINE_AA)
    sampler = Sampler(tracker().look(drawn(picture, line)).evidence)
    px = np.array(ANCHOR) + line * np.array([SCALE, -SCALE])
    band, _ = traced(px[:45], 5.0, sampler, SCALE)
    off = np.hypot(*(band[:, None] - px[None]).transpose(2, 0, 1)).min(axis=1)
    assert off.max() < 2.0  # px: it stays on the stem
    assert math.dist(band[-1], px[-1]) < 0.2 * SCALE


@pytest.mark.parametrize("turn_rad", [0.0, 0.3])
def test_a_narrow_leaf_on_top_that_is_greener_is_no_piece_of_the_stem(turn_rad: float) -> None:
    line, one = upright(7.0), tracker()
    t = np.linspace(0.0, 1.0, 20)[:, None]
    leaf = line[-1] + 2.5 * t * np.array([math.sin(turn_rad), math.cos(turn_rad)])
    for colour, end_cm in ((LEAF, 7.0), (STEM, 9.5)):
        strands = one.look(drawn(drawn(board(1), leaf, colour), line)).strands
        assert strands is not None
        chain = best_chain(strands, CAMERA, one.settings)
        assert chain is not None
        top_cm = (ANCHOR[1] - float(chain.points[-1, 1])) / SCALE
        assert top_cm == pytest.approx(end_cm, abs=0.4)


def leaning(lean_cm: float, height_cm: float, foot_cm: float = 0.0) -> FloatArray:
    return np.column_stack([foot_cm + np.linspace(0.0, lean_cm, 40), np.linspace(0.0, height_cm, 40)])


def test_a_stem_that_was_followed_is_not_left_at_once_for_a_longer_one() -> None:
    one, line, other = tracker(), leaning(-2.5, 6.0), leaning(0.5, 11.0)
    for k in range(6):
        assert one.read(drawn(board(k), line), 300.0 * k).outcome == OK
    for k in range(6, 11):
        reading = one.read(drawn(drawn(board(k), line), other), 300.0 * k)
        assert reading.outcome != OK
        assert k > 8 or tip_error_mm(reading, line) < 3.0


def test_a_second_plant_beside_the_first_is_told() -> None:
    line = leaning(0.5, 7.0)
    alone = tracker().read(drawn(board(1), line), 0.0)
    both = tracker().read(drawn(drawn(board(1), line), leaning(-1.0, 8.0, foot_cm=4.0)), 0.0)
    assert alone.outcome == OK
    assert both.outcome == OCCLUDED
    assert "beside the anchor" in both.reason


def test_a_stem_beside_the_anchor_is_no_stem_of_the_plant_there() -> None:
    """The line goes level over to it; a base that is hidden by a rim begins above the anchor."""
    beside = tracker().read(drawn(board(1), leaning(0.5, 8.0, foot_cm=-1.6)), 0.0)
    above = tracker().read(drawn(board(1), np.array([0.5, 1.6]) + leaning(0.5, 7.0)), 0.0)
    assert beside.outcome != OK
    assert above.outcome == OK


def test_of_two_stems_alike_none_is_said_with_confidence() -> None:
    left, right = (np.column_stack([s * np.linspace(0.0, 2.5, 40), np.linspace(0.0, 7.0, 40)]) for s in (-1.0, 1.0))
    reading = tracker().read(drawn(drawn(board(1), left), right), 0.0)
    assert reading.outcome == OCCLUDED
    assert reading.reason


def test_a_stem_that_fades_is_told() -> None:
    line = upright(9.0)
    picture = board(1)
    shades = np.linspace(1.0, 0.06, 24)
    for k, share in enumerate(shades):
        part = line[round(k * 39 / 24) : round((k + 1) * 39 / 24) + 1]
        y = round(ANCHOR[1] - SCALE * float(part[:, 1].mean()))
        behind = picture[y, 240].astype(float)
        tone = tuple(float(v) for v in behind + share * (np.array(STEM) - behind))
        drawn(picture, part, tone)  # type: ignore[arg-type]
    reading = tracker().read(picture, 0.0)
    assert reading.outcome != OK or tip_error_mm(reading, line) < 10.0


def in_noise(upper: float, noise: float, seed: int) -> np.ndarray:
    """A stem of 9 cm of which the upper half has that share of the lower one's contrast, and noise."""
    line, picture = upright(9.0), board(1)
    drawn(picture, line[:21])
    behind = picture[round(ANCHOR[1] - 7.0 * SCALE), 240].astype(float)
    tone = tuple(float(v) for v in behind + upper * (np.array(STEM) - behind))
    drawn(picture, line[20:], tone)  # type: ignore[arg-type]
    noisy = picture + np.random.default_rng(seed).normal(0.0, noise, picture.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("upper", "outcome"), [(1.0, OK), (0.35, OCCLUDED)])
def test_a_stem_that_sinks_into_noise_is_not_taken_for_short(upper: float, outcome: str) -> None:
    """What is seen of it is as plain as it ever gets; one that is known may be shown so."""
    reading = tracker().read(in_noise(upper, 30.0, 4), 0.0)
    assert reading.outcome == outcome
    assert (tip_error_mm(reading, upright(9.0)) > 30.0) == (outcome == OCCLUDED)


@pytest.mark.parametrize(("beyond", "outcome"), [(0.0, OK), (0.12, OCCLUDED)])
def test_a_stem_that_is_paler_at_its_end_has_not_faded_unless_it_goes_on_fainter(beyond: float, outcome: str) -> None:
    """A thin one's young end has less contrast, and is plain to see."""
    line, one = upright(9.0), tracker()
    for k in range(3):  # from then on pictures are looked at once
        assert one.follow(one.look(drawn(board(1), line)), 300.0 * k).outcome == OK
    picture = board(2)
    behind = picture[round(ANCHOR[1] - 9.0 * SCALE), 240].astype(float)

    def tone(share: float) -> tuple[int, int, int]:
        b, g, r = (round(v) for v in behind + share * (np.array(STEM) - behind))
        return b, g, r

    if beyond:
        drawn(picture, upright(12.0)[30:], tone(beyond))
    drawn(picture, line[33:], tone(0.34))
    drawn(picture, line[:35])
    reading = one.follow(one.look(picture), 900.0)
    assert (reading.outcome, "fades" in reading.reason) == (outcome, outcome == OCCLUDED)
    assert tip_error_mm(reading, line) < 5.0


def behind_leaf(line: np.ndarray, hidden_cm: float, wide_cm: float = 2.2) -> np.ndarray:
    """An upright stem with a leaf before it, from 4 cm of height on."""
    picture = drawn(board(1), line)
    centre = round(ANCHOR[0]), round(ANCHOR[1] - SCALE * (4.0 + 0.5 * hidden_cm))
    axes = round(0.5 * wide_cm * SCALE), round(0.5 * hidden_cm * SCALE)
    cv2.ellipse(picture, centre, axes, 0, 0, 360, LEAF, -1, cv2.LINE_AA)
    return picture


def aside(hidden_cm: float, by_cm: float) -> np.ndarray:
    """A stem that goes on beside itself beyond such a leaf."""
    line = upright(11.0)
    return line + np.column_stack([np.interp(line[:, 1], [4.0, 4.0 + hidden_cm], [0.0, by_cm]), np.zeros(len(line))])


@pytest.mark.parametrize(
    ("hidden_cm", "by_cm", "reason"),
    [
        (1.6, 0.0, ""),
        (2.6, 0.0, ""),
        (3.2, 0.0, ""),
        (3.2, -0.5, ""),
        (3.2, 1.6, "nothing is seen of it"),
        (3.2, -1.6, "nothing is seen of it"),
        (5.6, 0.0, "nothing is seen of it"),
    ],
)
def test_what_goes_on_behind_a_large_leaf_may_be_another_plant_where_it_is_not_in_line(
    hidden_cm: float, by_cm: float, reason: str
) -> None:
    one, line = tracker(), aside(hidden_cm, by_cm)
    line_px = np.array(ANCHOR) + line * np.array([SCALE, -SCALE])
    way = Way(line_px[-1], 0.5, line_px, np.full(len(line_px), 0.9))
    stem, _ = along_way.stem_along(way, Sampler(one.look(behind_leaf(line, hidden_cm, 5.0)).evidence), SCALE)
    told = along_way.unsure(way, stem, None, SCALE)
    assert told.startswith(reason) if reason else not told
    assert not along_way.unsure(way, stem, Before(line_px, 1.0), SCALE)


@pytest.mark.parametrize(("hidden_cm", "outcome"), [(1.6, OK), (3.2, OK), (5.6, OCCLUDED)])
def test_a_first_picture_with_a_large_leaf_before_the_stem_is_read(hidden_cm: float, outcome: str) -> None:
    reading = tracker().read(behind_leaf(upright(11.0), hidden_cm), 0.0)
    assert reading.outcome == outcome
    assert tip_error_mm(reading, upright(11.0)) < 3.0


@pytest.mark.parametrize(
    ("leant_cm", "unsure"),
    [(None, doubts.BEGINS_ASIDE), (0.0, doubts.BEGINS_ASIDE), (1.4, doubts.BEGINS_ASIDE), (2.2, ""), (2.5, "")],
)
def test_a_way_that_goes_level_to_another_foot_is_doubted_where_the_stem_has_not_leant_there(
    leant_cm: float | None, unsure: str
) -> None:
    one = tracker()
    line = np.concatenate([np.linspace([0.0, 0.0], [2.5, 0.6], 20), np.linspace([2.5, 0.6], [2.7, 8.0], 40)[1:]])
    line_px = np.array(ANCHOR) + line * np.array([SCALE, -SCALE])
    way = Way(line_px[-1], 0.5, line_px, np.full(len(line_px), 0.9))
    stem, _ = along_way.stem_along(way, Sampler(one.look(drawn(board(1), line)).evidence), SCALE)
    known = None
    if leant_cm is not None:
        leant = np.concatenate([np.linspace([0.0, 0.0], [leant_cm, 0.6], 20), [[leant_cm + 0.2, 8.0]]])
        known = Before(np.array(ANCHOR) + leant * np.array([SCALE, -SCALE]), 1.0)
    assert along_way.unsure(way, stem, known, SCALE) == unsure


def test_a_stem_that_was_seen_before_is_known_behind_a_large_leaf() -> None:
    line, one = upright(11.0), tracker()
    assert one.read(drawn(board(1), line), 0.0).outcome == OK
    reading = one.read(behind_leaf(line, 3.2), 300.0)
    assert reading.outcome == OK
    assert tip_error_mm(reading, line) < 3.0
    assert one.memory is not None
    assert one.memory.near is not None
    assert one.memory.near.looks == 0, "nor is it known less well than before"


@pytest.mark.parametrize(("noise", "outcome"), [(0.0, OK), (12.0, OCCLUDED)])
def test_a_short_stem_that_hardly_stands_out_of_the_noise_may_go_on_in_it(noise: float, outcome: str) -> None:
    """Of one that is shorter than a centimetre and a half nothing below its end tells that it fades."""
    line = upright(1.4)
    faint = [round(0.7 * behind + 0.3 * stem) for behind, stem in zip((74, 70, 66), STEM, strict=True)]
    picture = drawn(board(1), line, (faint[0], faint[1], faint[2]), 7)
    picture = np.clip(picture + np.random.default_rng(5).normal(0.0, noise, picture.shape), 0, 255).astype(np.uint8)
    reading = tracker().read(picture, 0.0)
    assert reading.outcome == outcome
    assert ("fades" in reading.reason) == (outcome == OCCLUDED)
