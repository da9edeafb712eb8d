"""Lines that leave the plant at the anchor for another one beside it."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from flora_common.arrays import FloatArray
from flora_common.runs import CameraSection
from flora_common.vision.path.neighbours import another_stem, goes_over
from flora_common.vision.path.strands import End, Strand

SCALE, ANCHOR = 20.0, (240.0, 385.0)
CAMERA = CameraSection(anchor_px=ANCHOR, px_per_cm=SCALE, width_px=480, height_px=400)
STRENGTH, WIDTH_PX = 60.0, 6.0


def along(*corners: tuple[float, float]) -> FloatArray:
    """A line through corners given in cm from the anchor, up and to the right; px, close together."""
    px = np.array(ANCHOR) + np.array(corners) * np.array([SCALE, -SCALE])
    t = np.linspace(0.0, len(corners) - 1.0, 400)
    return np.column_stack([np.interp(t, np.arange(len(corners)), px[:, k]) for k in range(2)])


def piece(points: FloatArray, strength: float = STRENGTH, foot: End = End.FREE) -> Strand:
    n = len(points)
    return Strand(points, np.full(n, WIDTH_PX), np.full(n, strength), np.zeros(n), 0.0, (foot, End.BRANCH))


BESIDE = piece(along((2.0, 0.2), (2.2, 1.5)))
JOINING = along((0.0, 0.0), (0.6, 3.0), (2.5, 5.0), (3.3, 9.0))
"""Smoothly from the anchor to where the stem beside it leads."""


def test_a_line_that_goes_on_where_the_stem_beside_it_leads() -> None:
    assert goes_over(JOINING, STRENGTH, [BESIDE], CAMERA)
    assert goes_over(JOINING, STRENGTH, [BESIDE.reversed()], CAMERA)
    assert not goes_over(JOINING, STRENGTH, [], CAMERA)


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(piece(along((2.0, 0.2), (2.2, 1.5)), 0.1 * STRENGTH), id="too faint"),
        pytest.param(piece(along((2.0, 0.2), (2.1, 0.8))), id="too short"),
        pytest.param(piece(along((2.0, 3.2), (2.2, 4.5))), id="too high"),
        pytest.param(piece(along((0.5, 0.2), (0.7, 1.5))), id="no farther aside than the stem"),
        pytest.param(piece(along((2.0, 0.2), (3.3, 0.4))), id="lies"),
        pytest.param(piece(along((2.0, 0.2), (2.2, 1.5)), foot=End.LEAF), id="hangs from a leaf"),
        pytest.param(piece(along((-2.0, 0.2), (-2.2, 1.5))), id="leads elsewhere"),
    ],
)
def test_what_is_no_stem_beside_the_anchor_leads_nowhere(other: Strand) -> None:
    assert not goes_over(JOINING, STRENGTH, [other], CAMERA)


def test_the_stem_beside_is_followed_up_over_what_hides_it() -> None:
    far = along((0.0, 0.0), (0.6, 6.0), (2.6, 12.0), (3.6, 14.0))
    low, high = along((3.6, 0.2), (3.6, 1.5)), along((3.6, 3.5), (3.6, 9.0))
    aside, back = along((4.6, 3.5), (4.6, 9.0)), along((3.6, 3.5), (2.0, 4.0))
    beyond = along((3.6, 4.5), (3.6, 9.0))
    for upper, goes in ((high, True), (high[::-1], True), (aside, False), (back, False), (beyond, False)):
        assert goes_over(far, STRENGTH, [piece(low), piece(upper)], CAMERA) is goes


def test_pieces_that_lie_in_a_ring_come_to_an_end() -> None:
    corners = [(3.0 + np.cos(a), 1.2 + np.sin(a)) for a in np.arange(-2.0, 4.5, 0.35)]
    ring = [piece(along(a, b)) for a, b in itertools.pairwise(corners)]
    assert not goes_over(
        along((0.0, 0.0), (0.0, 12.0)), STRENGTH, [piece(along((4.0, 0.0), (4.0, 1.0))), *ring], CAMERA
    )


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("far_cm", [1.8, 2.6])
def test_a_line_that_steps_aside(side: float, far_cm: float) -> None:
    step = along((0.0, 0.0), (0.0, 4.0), (side * far_cm, 4.4), (side * far_cm, 9.0))
    assert goes_over(step, STRENGTH, [], CAMERA)


@pytest.mark.parametrize(
    "corners",
    [
        pytest.param([(0.0, 0.0), (0.0, 12.0)], id="straight"),
        pytest.param([(0.0, 0.0), (0.0, 5.0), (4.0, 9.0)], id="bent"),
        pytest.param([(0.0, 0.0), (0.0, 8.0), (0.7, 9.0), (1.6, 8.6), (1.9, 7.0)], id="hooked"),
        pytest.param([(0.0, 0.0), (1.0, 3.0), (-0.5, 7.0), (1.0, 11.0)], id="swaying"),
        pytest.param([(0.0, 0.0), (0.0, 0.6)], id="seedling"),
    ],
)
def test_stems_bend_and_hang_but_do_not_step_aside(corners: list[tuple[float, float]]) -> None:
    assert not goes_over(along(*corners), STRENGTH, [], CAMERA)


def test_another_stem_is_as_long_and_as_clear() -> None:
    line = along((0.0, 0.0), (0.0, 12.0))
    assert another_stem(line, STRENGTH, WIDTH_PX, [piece(along((2.0, 0.2), (2.1, 1.6)))], CAMERA)
    assert not another_stem(line, STRENGTH, WIDTH_PX, [piece(along((2.0, 0.2), (2.1, 1.6)), 0.4 * STRENGTH)], CAMERA)
    assert not another_stem(line, STRENGTH, WIDTH_PX, [piece(along((2.0, 0.2), (2.1, 1.3)))], CAMERA)
    assert not another_stem(line, STRENGTH, WIDTH_PX, [piece(along((2.0, 1.2), (2.1, 2.6)))], CAMERA)


def test_another_stem_may_be_hidden_in_part_and_need_not_be_as_clear_farther_up() -> None:
    line, foot = along((0.0, 0.0), (0.0, 12.0)), along((2.0, 0.2), (2.0, 0.6))
    upper, short = along((1.9, 1.2), (1.7, 2.4)), along((1.9, 1.2), (1.85, 1.7))
    for rest, is_one in (([], False), ([piece(short)], False), ([piece(upper, 0.4 * STRENGTH)], True)):
        assert another_stem(line, STRENGTH, WIDTH_PX, [piece(foot), *rest], CAMERA) is is_one
    assert not another_stem(line, STRENGTH, WIDTH_PX, [piece(foot, 0.4 * STRENGTH), piece(upper)], CAMERA)
