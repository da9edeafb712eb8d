"""Lines that turned into a petiole at a fork, told by what branches off beyond it and by their width."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from flora_common.arrays import FloatArray
from flora_common.runs import CameraSection
from flora_common.vision.lamp_states import from_background
from flora_common.vision.path.forks import doubted_for, petiole_from
from flora_common.vision.path.strands import Strands
from flora_common.vision.path.tracker import PathTracker
from flora_common.vision.reading import OCCLUDED

WIDTH, HEIGHT, SCALE = 480, 400, 20.0
ANCHOR = (240.0, 385.0)
CAMERA = CameraSection(anchor_px=ANCHOR, px_per_cm=SCALE, width_px=WIDTH, height_px=HEIGHT)
FORK_CM, END_CM = 7.0, 13.0
COLOUR = (60, 200, 180)


def along(*corners: tuple[float, float]) -> FloatArray:
    """A line through corners given in cm from the anchor, up and to the right; px, close together."""
    px = np.array(ANCHOR) + np.array(corners) * np.array([SCALE, -SCALE])
    t = np.linspace(0.0, len(corners) - 1.0, 200)
    return np.column_stack([np.interp(t, np.arange(len(corners)), px[:, k]) for k in range(2)])


LINE = along((0.0, 0.0), (0.0, FORK_CM), (0.0, END_CM))
SHOOT = along((0.0, FORK_CM), (2.0, 7.6), (3.0, 8.6))


def plant(*, petiole_px: int = 4, shoot: bool = True, young_leaf: bool = False, blade_px: int = 8) -> np.ndarray:
    """What is set: a stem of 6 px, a petiole that goes on in its direction to a blade, and a shoot to the right."""
    picture = np.zeros((HEIGHT, WIDTH), np.uint8)

    def band(line: FloatArray, width: int) -> None:
        cv2.polylines(picture, [np.rint(16 * line).astype(np.int32)], False, 1, width, cv2.LINE_8, 4)

    def blade(middle_cm: tuple[float, float], axes_px: tuple[int, int]) -> None:
        x, y = (round(a + b * SCALE) for a, b in zip(ANCHOR, (middle_cm[0], -middle_cm[1]), strict=True))
        cv2.ellipse(picture, (x, y), axes_px, 0, 0, 360, 1, -1)

    band(along((0.0, 0.0), (0.0, FORK_CM)), 6)
    band(along((0.0, FORK_CM), (0.0, END_CM - 0.3)), petiole_px)
    blade((0.0, END_CM - 1.5), (blade_px, 30))
    if shoot:
        band(SHOOT, 6)
        blade((3.4, 8.8), (14, 6))
        blade((3.0, 9.2), (6, 12))
    if young_leaf:
        band(along((0.0, 10.0), (-0.8, 10.4)), 5)
    return picture


def strands(mask: np.ndarray) -> Strands:
    return Strands((), mask, np.zeros_like(mask), (0, 0))


def test_a_line_that_bears_one_leaf_beyond_a_fork_is_a_petiole_from_there_on() -> None:
    assert petiole_from(LINE, strands(plant()), SCALE) == pytest.approx(FORK_CM * SCALE, abs=0.8 * SCALE)


@pytest.mark.parametrize(
    "other",
    [
        plant(young_leaf=True),
        plant(shoot=False),
        plant(petiole_px=6),
        plant(blade_px=2),
    ],
    ids=["it bears another leaf", "nothing else begins there", "it is as thick as the stem", "it bears no blade"],
)
def test_it_is_none_where_one_of_its_marks_is_missing(other: np.ndarray) -> None:
    assert petiole_from(LINE, strands(other), SCALE) == math.inf


def test_a_short_line_is_no_petiole() -> None:
    assert petiole_from(LINE[:20], strands(plant()), SCALE) == math.inf


def test_the_part_that_is_looked_at_may_begin_anywhere() -> None:
    part = Strands((), plant()[40:, 100:].copy(), np.zeros((HEIGHT - 40, WIDTH - 100), np.uint8), (100, 40))
    assert petiole_from(LINE, part, SCALE) == pytest.approx(petiole_from(LINE, strands(plant()), SCALE))


def test_a_line_is_doubted_until_it_was_clear_for_some_pictures() -> None:
    left = doubted_for(0, is_petiole=True)
    assert left > 1
    for _ in range(100):
        left = doubted_for(left, is_petiole=True)
    clear = 0
    while left:
        left, clear = doubted_for(left, is_petiole=False), clear + 1
    assert 3 < clear <= 12
    assert doubted_for(0, is_petiole=False) == 0


def photograph(mask: np.ndarray, number: int) -> np.ndarray:
    picture = np.full((HEIGHT, WIDTH, 3), (48.0, 55.0, 66.0))
    picture[mask > 0] = COLOUR
    picture = cv2.GaussianBlur(picture, (0, 0), 0.8)
    picture += np.random.default_rng(number).normal(0.0, 1.5, picture.shape)
    return np.clip(picture, 0, 255).astype(np.uint8)


def tracker() -> PathTracker:
    nothing = np.zeros((HEIGHT, WIDTH), np.uint8)
    return PathTracker(from_background([photograph(nothing, 1000 + k) for k in range(2)]), CAMERA)


def test_a_picture_by_itself_that_shows_a_petiole_for_a_stem_is_occluded() -> None:
    reading = tracker().read(photograph(plant(), 1), 0.0)
    assert reading.outcome == OCCLUDED
