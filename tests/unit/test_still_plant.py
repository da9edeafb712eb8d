"""What never moves of a stem is taken out of the setup that is learnt from its own pictures, and nothing else is."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from drawings.run import make_world
from flora_common.vision.lamp_states import EmptySetup, from_frames
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.path.tracker import PathTracker
from flora_common.vision.picture import decode_picture
from flora_common.vision.still_plant import replace

ANCHOR, WIDEST_PX = (200.0, 290.0), 10.0
BOARD = np.clip(np.random.default_rng(4).normal(120.0, 1.0, (320, 400, 3)), 0, 255).astype(np.uint8)
GREEN, PALE = (90, 170, 120), (150, 150, 165)


def setup_with(stem: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """A board on which a foot stands up to where a plant moves, with a leaf beside it and a crack aside."""
    empty = BOARD.copy()
    cv2.line(empty, (200, 290), (206, 180), stem, 4)
    cv2.ellipse(empty, (245, 230), (14, 6), 0, 0, 360, GREEN, -1)
    cv2.line(empty, (60, 0), (60, 319), (60, 60, 60), 3)
    moves = np.zeros(empty.shape[:2], np.uint8)
    cv2.fillPoly(moves, [np.array([[206, 185], [170, 90], [250, 90]])], 1)
    return empty, moves


def off_board(empty: np.ndarray) -> np.ndarray:
    return np.abs(empty.astype(int) - BOARD).max(axis=-1)


@pytest.mark.parametrize("stem", [GREEN, PALE])
def test_a_foot_of_any_colour_is_taken_out_and_the_setup_stays(stem: tuple[int, int, int]) -> None:
    empty, moves = setup_with(stem)
    before = empty.copy()
    assert np.quantile(off_board(empty)[195:285, 190:215], 0.98) > 25
    replace(empty, moves, ANCHOR, WIDEST_PX)
    assert np.quantile(off_board(empty)[195:285, 190:215], 0.98) < 12
    for aside in (np.s_[:, :150], np.s_[:, 300:], np.s_[:80], np.s_[310:]):
        assert (empty[aside] == before[aside]).all()


def test_noise_that_moves_in_the_dark_and_a_plant_beside_lead_nowhere() -> None:
    empty, moves = setup_with(PALE)
    cv2.line(empty, (370, 290), (372, 180), PALE, 4)
    cv2.circle(moves, (372, 140), 40, 1, -1)
    moves[280:300, 150:160] |= (np.random.default_rng(1).random((20, 10)) < 0.3).astype(np.uint8)
    replace(empty, moves, ANCHOR, WIDEST_PX)
    assert np.quantile(off_board(empty)[195:285, 190:215], 0.98) < 12
    assert off_board(empty)[200:280, 365:378].max() > 25


def test_where_nothing_moves_nothing_is_taken_out() -> None:
    empty, moves = setup_with(GREEN)
    replace(empty, np.zeros_like(moves), ANCHOR, WIDEST_PX)
    assert (empty == setup_with(GREEN)[0]).all()


def test_a_plant_with_a_pale_foot_is_followed_without_background_pictures() -> None:
    world = make_world(71008, hours=72.0, size_px=(1640, 1232))
    frames = [world.frame(hour_h * 3600.0) for hour_h in np.arange(20.0, 44.0)]
    pictures = [decode_picture(frame.jpeg, where="picture") for frame in frames]
    widest_px = PathSettings().widest_stem_cm * world.section.px_per_cm
    states = [
        from_frames(
            [picture for picture, frame in zip(pictures, frames, strict=True) if frame.light == light],
            anchor_px=world.section.anchor_px,
            widest_px=widest_px,
        )
        for light in ("left", "right")
    ]
    tracker = PathTracker(EmptySetup(states, "frames"), world.section)
    readings = [tracker.read(picture, frame.time_s) for picture, frame in zip(pictures, frames, strict=True)]
    off_mm = [
        10.0 * np.hypot(*(reading.points_cm[-1] - frame.centreline_cm[-1]))
        for reading, frame in zip(readings, frames, strict=True)
        if reading.points_cm is not None and reading.outcome == "ok"
    ]
    assert len(off_mm) >= 22
    assert np.mean(off_mm) < 2.0
