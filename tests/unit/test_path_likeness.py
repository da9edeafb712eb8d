"""Which lamp state a picture is like, where a plant hides what tells the states apart."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np

from flora_common.vision.lamp_states import EmptySetup, coarse_code, from_background
from flora_common.vision.path.likeness import REDUCED, USUAL, Demands, Likeness, SetupLikeness

ROWS, COLUMNS = 144, 208
HIDDEN = slice(60, 86)
"""Columns in which the lamps make all the difference, and a plant stands."""


def structure(seed: int) -> np.ndarray:
    """Of a board, standard deviation 1."""
    rough = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(ROWS, COLUMNS)), (0, 0), 1.4)
    return np.asarray((rough - rough.mean()) / rough.std())


def picture(reduced: np.ndarray) -> np.ndarray:
    """A board with some structure, shape (height, width, 3), uint8."""
    grey = cv2.resize(120.0 + 12.0 * reduced, (COLUMNS * REDUCED, ROWS * REDUCED), interpolation=cv2.INTER_LINEAR)
    return np.rint(np.clip(grey, 0, 255)).astype(np.uint8)[..., None].repeat(3, axis=2)


def survey(seen: np.ndarray, number: int) -> Any:
    """What the likeness is told of a picture."""
    coarse = coarse_code(seen)
    return SimpleNamespace(
        coarse=coarse, number=number, plant=np.zeros(coarse.shape[:2], np.uint8), slow=np.zeros((2, 2, 3), np.float32)
    )


def test_the_state_that_the_picture_meets_goes_before_one_that_is_a_little_like_it_everywhere() -> None:
    """Under the other lamp all of it is somewhat like it; under its own some is hidden, and the rest is the same."""
    own = np.ones((ROWS, COLUMNS))
    own[:, HIDDEN] = 2.2
    common = 1.7 * structure(0)
    common[:, HIDDEN] = 0.0
    left, right = (common + own * structure(k) for k in (1, 2))
    setup = EmptySetup([from_background([picture(one)]).states[0] for one in (left, right)], "background")
    seen = right + structure(3)
    seen[:, HIDDEN] = left[:, HIDDEN]
    likely = SetupLikeness(setup, anchor_y_px=0.0).of(survey(picture(seen), number=1))
    assert likely.elsewhere > 0.15
    assert not USUAL.unmet(0.0, likely)


def test_what_a_plant_hides_is_not_asked_for_where_little_else_has_structure() -> None:
    """A plain board with a pole, along which a plant grows up: what is left of the pole is the setup's."""
    rows = np.arange(ROWS)[:, None]
    pole = np.where(np.abs(np.arange(COLUMNS) - 100) < 3, 6.0 + 2.0 * np.sin(rows / 3.0), 0.0)
    likeness = SetupLikeness(
        EmptySetup([from_background([picture(pole)]).states[0]], "background"), anchor_y_px=ROWS * REDUCED
    )
    covered, moved = pole.copy(), np.roll(pole, 9, axis=1)
    covered[60:, 90:110] = structure(5)[60:, 90:110] * 4.0
    grown, elsewhere = survey(picture(covered), number=0), survey(picture(moved), number=0)
    grown.plant[60 * 2 :, 90 * 2 : 110 * 2] = 1
    assert not USUAL.unmet(0.0, likeness.of(grown))
    assert USUAL.unmet(0.0, likeness.of(elsewhere))
    bare = survey(picture(covered), number=0)
    assert "cannot be recognised" in USUAL.unmet(0.0, likeness.of(bare))


def test_a_picture_that_is_hardly_like_the_setup_anywhere_says_by_how_much() -> None:
    demands = Demands(changed=0.1, correlation=0.85, worst_band=0.5, gain=0.5, elsewhere=0.25)
    assert "by 23% otherwise" in demands.unmet(0.0, Likeness(correlation=0.77))
    assert "40% of the setup cannot be recognised" in demands.unmet(0.0, Likeness(correlation=0.77, elsewhere=0.4))
