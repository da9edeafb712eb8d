"""A stem that is followed near the place where it was, without a look at the rest of the picture."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from path_fakes import ANCHOR, CAMERA, SCALE, tip_error_mm

from bench.vision.figures import line_distances_mm
from flora_common.arrays import FloatArray
from flora_common.vision.lamp_states import from_background
from flora_common.vision.path import nearby
from flora_common.vision.path.chain import Before
from flora_common.vision.path.sampler import Sampler
from flora_common.vision.path.tracker import PathTracker
from flora_common.vision.picture import Picture, decode_picture
from flora_common.vision.reading import OK
from truth_run import twin_run

_GRAIN = np.random.default_rng(11).normal(0.0, 90.0, (400, 480))
_BOARD = np.clip(70.0 + cv2.GaussianBlur(_GRAIN, (0, 0), 6.0), 25, 160)[:, :, None]
LAMPS = {
    "left": np.linspace(1.4, 0.6, 480)[None, :, None] * np.array([0.9, 1.0, 1.1]),
    "right": np.linspace(0.6, 1.4, 480)[None, :, None] * np.array([1.1, 1.0, 0.9]),
}
STEM = (60.0, 200.0, 90.0)


def board(number: int, light: str = "left") -> Picture:
    noise = np.random.default_rng(number).normal(0.0, 1.5, (400, 480, 3))
    return np.clip(_BOARD * LAMPS[light] + noise, 0, 255).astype(np.uint8)


def drawn(picture: Picture, line_cm: FloatArray, thickness: int = 5) -> Picture:
    points = np.rint(16 * (np.array(ANCHOR) + line_cm * np.array([SCALE, -SCALE]))).astype(np.int32)
    cv2.polylines(picture, [points], False, STEM, thickness, cv2.LINE_AA, 4)
    return picture


def leaning(lean_cm: float, height_cm: float = 9.0) -> FloatArray:
    s = np.linspace(0.0, 1.0, 60)
    return np.column_stack([lean_cm * s**2, height_cm * s])


def growing(k: int) -> FloatArray:
    return leaning(1.0 + 0.03 * k, 9.0 + 0.02 * k)


def tracker() -> PathTracker:
    setup = from_background([board(1000 + k, light) for k, light in enumerate(("left", "right") * 2)])
    return PathTracker(setup, CAMERA)


def looks(one: PathTracker) -> int | None:
    """How many pictures in a row were looked at near the stem only; None where the next one cannot be."""
    assert one.memory is not None
    return None if one.memory.near is None else one.memory.near.looks


def followed(count: int) -> PathTracker:
    one = tracker()
    for k in range(count):
        assert one.read(drawn(board(k), growing(k)), 300.0 * k).outcome == OK
    return one


def test_the_whole_picture_is_looked_at_first_and_then_every_so_often() -> None:
    one, seen = tracker(), []
    for k in range(nearby.MOST_LOOKS + 4):
        one.read(drawn(board(k), growing(k)), 300.0 * k)
        seen.append(looks(one))
    assert seen == [*range(nearby.MOST_LOOKS + 1), 0, 1, 2]


def test_under_another_lamp_the_whole_picture_is_looked_at() -> None:
    one = followed(3)
    assert looks(one) == 2
    assert one.read(drawn(board(3, "right"), growing(3)), 900.0).outcome == OK
    assert looks(one) == 0


@pytest.mark.parametrize("later_s", [-300.0, 1500.0])
def test_after_a_pause_or_back_in_time_the_whole_picture_is_looked_at(later_s: float) -> None:
    one = followed(3)
    one.read(drawn(board(3), growing(3)), 600.0 + later_s)
    assert looks(one) == 0


def test_a_plant_that_was_replaced_is_found_again() -> None:
    one, other = followed(4), leaning(3.5, 6.0)
    readings = [one.read(drawn(board(k), other), 300.0 * k) for k in range(4, 12)]
    assert OK not in [r.outcome for r in readings[:2]]
    assert [r.outcome for r in readings[-2:]] == [OK, OK]
    assert max(tip_error_mm(r, other) for r in readings[-3:]) < 3.0


def test_what_is_new_beside_the_stem_makes_the_whole_picture_looked_at() -> None:
    one, line = followed(3), growing(3)
    beside = drawn(drawn(board(3), line), np.array([[0.5, 3.0], [2.5, 3.5]]), thickness=16)
    one.read(beside, 900.0)
    assert looks(one) in (0, None)


def test_a_plant_that_is_gone_is_not_told_to_be_there() -> None:
    one = followed(4)
    reading = one.read(board(4), 1200.0)
    assert (reading.outcome, reading.points_cm) == ("no_stem", None)


@pytest.mark.parametrize(
    ("shown", "elsewhere_cm", "only_plain", "there"),
    [
        (growing(4), (5.0, 6.0), True, True),
        (growing(4), (5.0, 6.0), False, True),
        (growing(4), (2.5, 9.0), True, False),
        (growing(4), (2.5, 9.0), False, True),
        (leaning(4.0), (5.0, 6.0), False, False),
        (growing(4)[:45], (5.0, 6.0), False, False),
    ],
)
def test_a_stem_is_held_to_where_it_is_still_to_be_seen(
    shown: FloatArray, elsewhere_cm: tuple[float, float], only_plain: bool, there: bool
) -> None:
    one = followed(4)
    assert one.memory is not None
    assert one.memory.near is not None
    before = Before(np.array(one.memory.line_px), 0.9)
    sampler = Sampler(one.look(drawn(board(4), shown)).evidence)
    stem, _ = nearby.found(before.line_px, one.memory.near, sampler, SCALE, before)
    end = np.array(ANCHOR) + np.array(elsewhere_cm) * [SCALE, -SCALE]
    other = replace(stem, line=np.concatenate([stem.line, end[None]]))
    seen = one.memory.seen
    got = nearby.still_there(before, one.memory.near, seen, other, sampler, SCALE, only_plain=only_plain)
    assert (got is not None) == there
    plainer = replace(other, clean=np.ones(len(stem.clean) + 1, dtype=np.bool_))
    assert nearby.still_there(before, one.memory.near, seen, plainer, sampler, SCALE, only_plain=True) is None


def test_what_is_known_of_a_stem_outlasts_a_picture_that_is_not_clear_if_that_ends_at_the_same_place() -> None:
    one = followed(3)
    assert one.memory is not None
    near = one.memory.near
    assert near is not None
    before = Before(np.array(one.memory.line_px), 0.9)
    stem, _ = nearby.found(before.line_px, near, Sampler(one.look(drawn(board(3), growing(3))).evidence), SCALE, before)
    kept = nearby.since_clear(near, stem, before, SCALE)
    assert kept is not None
    assert (kept.looks, kept.sure_px) == (nearby.MOST_LOOKS, near.sure_px)
    assert nearby.since_clear(None, stem, before, SCALE) is None
    other = replace(stem, line=stem.line + np.array([2.0 * nearby.STEP_CM * SCALE, 0.0]))
    assert nearby.since_clear(near, other, before, SCALE) is None


@pytest.mark.parametrize("seed", [202, pytest.param(204, marks=pytest.mark.slow)])
def test_near_the_stem_the_same_is_seen_as_in_the_whole_picture(seed: int) -> None:
    run = twin_run(seed, hours=1.0)
    one = PathTracker(from_background([decode_picture(jpeg, where="empty") for jpeg in run.background]), run.camera)
    along, at_tip = [], []
    for frame in run.frames():
        picture, before = decode_picture(frame.jpeg, where="frame"), one.memory
        near, after = one.read(picture, frame.time_s), one.memory
        if not looks(one):
            continue
        one.memory = before
        whole = one.follow(one.look(picture), frame.time_s)
        one.memory = after
        assert near.outcome == whole.outcome == OK
        assert near.stem_pixels == whole.stem_pixels
        assert near.line_px is not None
        assert whole.line_px is not None
        along.append(line_distances_mm(near.line_px / run.camera.px_per_cm, whole.line_px / run.camera.px_per_cm))
        at_tip.append(10.0 * np.hypot(*(near.line_px[-1] - whole.line_px[-1])) / run.camera.px_per_cm)
    assert len(along) > 6
    assert np.mean(along) < 0.1
    assert np.mean(at_tip) < 0.5
