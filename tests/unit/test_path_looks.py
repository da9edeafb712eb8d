"""Lines that run from the stem into a young leaf, told by its colour and by its thin foot."""

from __future__ import annotations

import math

import numpy as np
import pytest
from path_fakes import ANCHOR, CAMERA, HEIGHT, SCALE, WIDTH, drawn, tip_error_mm

from flora_common.arrays import FloatArray
from flora_common.vision.lamp_states import from_background
from flora_common.vision.path.chain import Before
from flora_common.vision.path.curve import along_line
from flora_common.vision.path.looks import has_neck, leaf_from
from flora_common.vision.path.sampler import Sampler
from flora_common.vision.path.tip import find_tip, round_bends
from flora_common.vision.path.tracker import PathTracker
from flora_common.vision.reading import OCCLUDED, OK

STEM, LEAF, SHADED, FAINT = (90, 200, 190), (40, 120, 55), (55, 122, 116), (58, 85, 90)
Tone = tuple[int, int, int]


def board(number: int) -> np.ndarray:
    picture = np.full((HEIGHT, WIDTH, 3), (48.0, 55.0, 66.0))
    picture += np.random.default_rng(number).normal(0.0, 1.5, picture.shape)
    return np.clip(picture, 0, 255).astype(np.uint8)


def tracker() -> PathTracker:
    return PathTracker(from_background([board(1000 + k) for k in range(2)]), CAMERA)


def upright(low_cm: float, high_cm: float) -> FloatArray:
    return np.column_stack([np.zeros(60), np.linspace(low_cm, high_cm, 60)])


def hook(height_cm: float, radius_cm: float, turn_rad: float) -> FloatArray:
    """Upright, then round a circle to the right."""
    t = np.linspace(0.0, turn_rad, 40)[1:]
    bend = np.column_stack([radius_cm * (1.0 - np.cos(t)), height_cm + radius_cm * np.sin(t)])
    return np.concatenate([upright(0.0, height_cm), bend])


def leaf_on(line_cm: FloatArray, at: int, long_cm: float, turn_rad: float) -> FloatArray:
    """Straight on from a point of a line, turned to the left."""
    ahead = line_cm[at] - line_cm[at - 1]
    heading = math.atan2(ahead[1], ahead[0]) + turn_rad
    return line_cm[at] + np.linspace(0.0, long_cm, 20)[:, None] * np.array([math.cos(heading), math.sin(heading)])


def sampler(picture: np.ndarray) -> Sampler:
    return Sampler(tracker().look(picture).evidence)


@pytest.mark.parametrize("long_cm", [1.2, 1.6])
@pytest.mark.parametrize("radius_cm", [0.8, 1.0])
def test_a_hook_is_not_left_for_a_darker_greener_leaf_on_its_top(long_cm: float, radius_cm: float) -> None:
    line = hook(6.0, radius_cm, 2.7)
    picture = drawn(drawn(board(1), leaf_on(line, 74, long_cm, 0.25), LEAF, 3), line, STEM, 5)
    assert tip_error_mm(tracker().read(picture, 0.0), line) < 3.0


def test_an_end_that_is_a_leaf_is_told() -> None:
    picture = drawn(drawn(board(1), upright(6.9, 7.9), LEAF, 5), upright(0.0, 7.0), STEM, 6)
    reading = tracker().read(picture, 0.0)
    assert reading.outcome == OCCLUDED or tip_error_mm(reading, upright(0.0, 7.0)) < 3.0


@pytest.mark.parametrize(("colour", "leaf"), [(LEAF, True), (SHADED, False), (STEM, False)])
def test_a_leaf_is_darker_and_greener_and_a_shaded_stem_is_not(colour: Tone, leaf: bool) -> None:
    """In the shade all channels fall by the same share."""
    picture = drawn(drawn(board(1), upright(6.0, 7.0), colour, 6), upright(0.0, 6.0), STEM, 6)
    line = np.array(ANCHOR) + upright(0.0, 7.0) * np.array([SCALE, -SCALE])
    start = leaf_from(line, sampler(picture), SCALE)
    assert (start < len(line)) == leaf
    if leaf:
        assert (ANCHOR[1] - line[start, 1]) / SCALE == pytest.approx(6.0, abs=0.25)


def test_stem_above_a_leaf_that_crosses_it_is_stem() -> None:
    picture = drawn(drawn(board(1), upright(0.0, 7.0), STEM, 6), upright(5.6, 6.2), LEAF, 6)
    line = np.array(ANCHOR) + upright(0.0, 7.0) * np.array([SCALE, -SCALE])
    assert leaf_from(line, sampler(picture), SCALE) == len(line)


def test_a_line_too_short_to_compare_is_left_as_it_is() -> None:
    picture = drawn(board(1), upright(0.0, 0.6), STEM, 6)
    line = np.array(ANCHOR) + upright(0.0, 0.5) * np.array([SCALE, -SCALE])
    assert leaf_from(line, sampler(picture), SCALE) == len(line)
    assert not has_neck(line, sampler(picture), SCALE)


def test_a_neck_is_told_and_a_stem_of_one_width_is_not() -> None:
    line = upright(0.0, 8.0)
    plain = drawn(board(1), line, STEM, 6)
    foot = drawn(drawn(board(1), upright(0.0, 6.6), STEM, 6), line, FAINT, 1)
    necked = drawn(foot, upright(7.2, 8.0), STEM, 5)
    px = np.array(ANCHOR) + line * np.array([SCALE, -SCALE])
    assert not has_neck(px, sampler(plain), SCALE)
    assert has_neck(px, sampler(necked), SCALE)
    alone, after_neck = (tracker().read(picture, 0.0) for picture in (plain, necked))
    assert alone.outcome == OK
    assert after_neck.outcome == OCCLUDED or after_neck.line_px[-1, 1] > ANCHOR[1] - 7.2 * SCALE


def test_a_kept_tip_at_which_the_stem_plainly_goes_on_is_no_tip() -> None:
    """A tip that is where it was before needs no other; one at a hook's top does."""
    for line, end, goes_on in ((hook(5.0, 1.0, 2.5), 64, True), (upright(0.0, 7.0), 60, False)):
        places = sampler(drawn(board(1), line, STEM, 7))
        line_px = np.array(ANCHOR) + line * np.array([SCALE, -SCALE])
        stem = along_line(line_px[:end], math.inf, (7.0, 7.0), math.inf, places, SCALE)
        tip = find_tip(stem, places, SCALE)
        before = Before(np.concatenate([stem.line[: tip.safe + 1], tip.places]))
        band = round_bends(stem, tip, places, SCALE, before)
        assert (len(band) > 0) == goes_on
        if goes_on:
            assert math.dist(band[-1], line_px[-1]) < 0.3 * SCALE
