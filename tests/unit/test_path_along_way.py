"""Which of the ways that the network tells is the stem's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flora_common.arrays import FloatArray
from flora_common.vision.path import along_way
from flora_common.vision.path.chain import Before
from flora_common.vision.path.guide import Way

SCALE = 20.0
TOP_CM = 8.0


def way(sure: float, *, top_cm: float = TOP_CM, aside_cm: float = 0.0, beyond: float = 0.9) -> Way:
    """Up from the anchor to its top; above :data:`TOP_CM` it is the stem's middle with likelihood ``beyond``."""
    height = np.linspace(0.0, top_cm, 120)
    side = aside_cm * np.clip(height / TOP_CM, 0.0, 1.0)
    line = np.column_stack([100.0 + SCALE * side, 300.0 - SCALE * height])
    return Way(line[-1], sure, line, np.where(height > TOP_CM, beyond, 0.9))


@pytest.mark.parametrize(
    ("sure", "elsewhere", "believed"),
    [
        (0.31, 0.5, True),
        (0.29, 0.12, False),
        (0.2, 0.06, True),
        (0.2, 0.08, False),
        (0.16, 0.0, True),
        (0.14, 0.0, False),
    ],
)
def test_an_apex_needs_to_be_less_likely_where_there_is_hardly_another(
    sure: float, elsewhere: float, believed: bool
) -> None:
    assert along_way.is_believed(replace(way(sure), elsewhere=elsewhere), is_first=False) == believed


@pytest.mark.parametrize(
    ("sure", "elsewhere", "by_itself", "of_two"),
    [
        (0.32, 0.07, True, True),
        (0.32, 0.12, False, True),
        (0.32, 0.14, False, False),
        (0.64, 0.15, True, True),
        (0.21, 0.0, False, False),
    ],
)
def test_another_likely_apex_counts_against_one_of_which_nothing_is_known(
    sure: float, elsewhere: float, by_itself: bool, of_two: bool
) -> None:
    told = replace(way(sure), elsewhere=elsewhere)
    assert along_way.is_believed(told, is_first=True) == by_itself
    assert along_way.is_believed_of_two(told, is_first=True) == of_two


def test_a_known_stem_may_have_another_likely_apex_where_the_rules_come_to_its_own() -> None:
    told = replace(way(0.25), elsewhere=0.2)
    assert along_way.is_believed_of_two(told, is_first=False)
    assert not along_way.is_believed_of_two(told, is_first=True)


def before(top_cm: float) -> Before:
    return Before(way(1.0, top_cm=top_cm).line_px, 1.0)


@pytest.mark.parametrize("past", [None, before(TOP_CM)])
def test_an_apex_through_which_a_stem_goes_on_is_none(past: Before | None) -> None:
    near, far = way(0.4), way(0.25, top_cm=TOP_CM + 1.5)
    assert along_way.chosen([near, far], past, SCALE) is far


@pytest.mark.parametrize(
    "far",
    [
        way(0.25, top_cm=TOP_CM + 0.6),  # a young leaf in line with the stem is as long
        way(0.25, top_cm=TOP_CM + 1.5, aside_cm=0.4),  # it passes by
        way(0.25, top_cm=TOP_CM + 1.5, beyond=0.2),  # what goes on does not look like a stem
        way(0.15, top_cm=TOP_CM + 1.5),  # its end is much less likely an apex
    ],
)
def test_else_the_likelier_apex_is_the_stems(far: Way) -> None:
    near = way(0.4)
    assert along_way.chosen([near, far], None, SCALE) is near
    assert along_way.chosen([near, far], before(TOP_CM), SCALE) is near


def place(top_cm: float) -> FloatArray:
    return way(1.0, top_cm=top_cm).tip_px


def test_an_apex_that_is_followed_is_given_up_where_the_network_is_sure_of_another_for_some_pictures() -> None:
    sure, unsure = way(0.4, aside_cm=2.0), way(0.3, aside_cm=2.0)
    told = [along_way.is_refuted(place(TOP_CM), [sure], SCALE, elsewhere=k) for k in range(5)]
    assert told == [False, False, False, True, True]
    assert not along_way.is_refuted(place(TOP_CM), [unsure], SCALE, elsewhere=9)
    assert not along_way.is_refuted(place(TOP_CM), [sure, way(0.1)], SCALE, elsewhere=9), "it sees one there, too"


def test_one_through_which_the_stem_goes_on_is_given_up_at_once() -> None:
    assert along_way.is_refuted(place(TOP_CM), [way(0.3, top_cm=TOP_CM + 2.0)], SCALE, elsewhere=0)
    assert not along_way.is_refuted(place(TOP_CM), [way(0.05, top_cm=TOP_CM + 2.0)], SCALE, elsewhere=0)
