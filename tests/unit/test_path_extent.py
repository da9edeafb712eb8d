"""How far a stem may go on beyond what is seen of it."""

from __future__ import annotations

import numpy as np
import pytest

from flora_common.vision.path.evidence import Evidence
from flora_common.vision.path.extent import BARE_CM, within_plant
from flora_common.vision.path.sampler import Sampler
from flora_common.vision.path.tip import Tip

PX_PER_CM = 20.0
BARE_PX = BARE_CM * PX_PER_CM


def upwards(length_px: int) -> Tip:
    """A tip at (50, 60) whose stem would go on straight up."""
    onwards = np.column_stack([np.full(length_px, 50.0), 59.0 - np.arange(length_px)])
    return Tip(0, np.array([[50.0, 60.0]]), onwards, open_end=True, error_px=1.0)


def board(*leaves: tuple[int, int]) -> Sampler:
    """A bare board with leaves across the way between these rows."""
    plant = np.zeros((100, 100), np.float32)
    for top, bottom in leaves:
        plant[top:bottom] = 40.0
    return Sampler(Evidence((0, 0), plant, np.full((100, 100, 3), 90, np.uint8), 2.0))


@pytest.mark.parametrize(
    ("leaves", "px"),
    [
        ((), BARE_PX),  # from the tip on there is the board
        (((40, 61),), 20 + BARE_PX),  # a leaf hides 20 px of the way
        (((20, 61),), 30),  # or all of it
        (((30, 40), (50, 61)), 10 + BARE_PX),  # what lies behind a gap is another thing
        (((50, 59), (57, 59)), 10 + BARE_PX),
    ],
)
def test_a_stem_goes_on_behind_a_leaf_but_not_before_the_board(leaves: tuple[tuple[int, int], ...], px: float) -> None:
    kept = within_plant(upwards(30), board(*leaves), PX_PER_CM)
    assert len(kept.onwards) == pytest.approx(px, abs=2.0)
    assert np.array_equal(kept.onwards, upwards(30).onwards[: len(kept.onwards)])


def test_a_tip_without_a_way_ahead_stays_as_it_is() -> None:
    tip = Tip(0, np.array([[50.0, 60.0]]), np.zeros((0, 2)), open_end=True, error_px=1.0)
    assert within_plant(tip, board(), PX_PER_CM) is tip
