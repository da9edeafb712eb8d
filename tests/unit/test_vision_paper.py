"""The published method, step by step, on drawn pictures whose answer is known."""

from __future__ import annotations

import math
from typing import get_args

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from flora_common.errors import BadInput, BadPicture
from flora_common.runs import CameraSection
from flora_common.vision import paper
from flora_common.vision.paper import PaperSettings, PaperTracker
from flora_common.vision.picture import decode_picture
from flora_common.vision.reading import PictureOutcome, bad_picture
from flora_common.vision.setup import from_pictures

CAMERA = CameraSection((819.5, 1100.0), 18.0)
FULL = (1232, 1640)


def scene(*lines: tuple[tuple[float, float], tuple[float, float], int], green: int = 30) -> np.ndarray:
    """A full-size picture: dark cloth and bright green lines ((x, y), (x, y), width), drawn to 1/16 px."""
    picture = np.full((*FULL, 3), green, dtype=np.uint8)
    for a, b, width in lines:
        ends = [tuple(round(v * 16) for v in end) for end in (a, b)]
        cv2.line(picture, ends[0], ends[1], (60, 220, 60), width, cv2.LINE_AA, 4)
    return picture


def bar(x0: int, y0: int, x1: int, y1: int, picture: np.ndarray | None = None) -> np.ndarray:
    """An upright rectangle of plant, edges included."""
    picture = scene() if picture is None else picture
    picture[y0 : y1 + 1, x0 : x1 + 1] = (60, 220, 60)
    return picture


def reduced(picture: np.ndarray, reduction: int = 4) -> np.ndarray:
    data = cv2.imencode(".png", picture)[1].tobytes()
    return decode_picture(data, where="drawn", reduction=reduction)  # type: ignore[arg-type]


EMPTY = from_pictures([reduced(scene()), reduced(scene(green=45))])
HALF_REDUCED_PX_CM = 2.0 / CAMERA.px_per_cm


def tracker(**changed: object) -> PaperTracker:
    return PaperTracker(EMPTY, CAMERA, PaperSettings(**changed))  # type: ignore[arg-type]


# --- whole pictures ---------------------------------------------------------------------------------------------


def test_upright_stem_is_found_within_half_a_reduced_pixel() -> None:
    reading = tracker().read(reduced(bar(816, 700, 823, 1099)))
    assert (reading.outcome, reading.quality) == ("ok", 1.0)
    assert reading.points_cm is not None
    height_cm = (1100 - 700) / CAMERA.px_per_cm
    assert np.all(np.abs(reading.points_cm[:, 0]) <= HALF_REDUCED_PX_CM + 1e-9)
    assert np.abs(reading.points_cm[1:7, 0]).max() < 1e-9  # smoothing lets the tip pull at points 8 and 9
    assert reading.points_cm[9, 1] == pytest.approx(height_cm, abs=HALF_REDUCED_PX_CM)
    assert np.allclose(np.diff(reading.points_cm[:, 1]), reading.points_cm[9, 1] / 9)
    assert tuple(reading.points_cm[0]) == (0.0, 0.0)


@pytest.mark.parametrize("lean", [-0.5, -0.2, 0.2, 0.5])
def test_leaning_stem_is_found_within_half_a_reduced_pixel(lean: float) -> None:
    ax, ay = CAMERA.anchor_px
    top = ay - 400
    reading = tracker().read(reduced(scene(((ax - 40 * lean, ay + 40), (ax + lean * 400, top), 8))))
    assert reading.points_cm is not None
    assert (reading.outcome, reading.quality) == ("ok", 1.0)
    x, y = reading.points_cm[1:8].T  # the last two feel the round end of the drawn line
    assert np.abs(x - lean * y).max() <= HALF_REDUCED_PX_CM


def test_moving_tip_is_followed() -> None:
    follow = tracker()
    ax, ay = CAMERA.anchor_px
    for x in range(-200, 201, 40):
        reading = follow.read(reduced(scene(((ax, ay), (ax + x, ay - 450), 8))))
        assert reading.outcome == "ok"
        assert reading.points_cm is not None
        # A drawn line ends in a half circle 4 px wide; the tip is its farthest or highest pixel.
        assert reading.points_cm[9] == pytest.approx([x / 18.0, 25.0], abs=8.5 / 18.0)


def test_empty_setup_and_the_states_it_was_seen_in_hold_no_stem() -> None:
    for green in (30, 37, 45):
        reading = tracker().read(reduced(scene(green=green)))
        assert (reading.outcome, reading.quality, reading.points_cm) == ("no_stem", 0.0, None)
        assert reading.reason


def test_no_stem_keeps_the_previous_tip() -> None:
    follow = tracker()
    follow.read(reduced(bar(816, 700, 823, 1099)))
    before = follow.tip_px
    assert follow.read(reduced(scene())).outcome == "no_stem"
    assert follow.tip_px == before


def test_restarted_tracker_goes_on_from_the_stored_tip() -> None:
    pictures = [reduced(bar(816, 700, 823, 1099, bar(1000, y, 1100, y + 30))) for y in (720, 710, 704, 700, 696)]
    through = tracker()
    expected = [through.read(p) for p in pictures]
    stored = expected[1].tip_px
    again = tracker()
    again.tip_px = stored
    for picture, reading in zip(pictures[2:], expected[2:], strict=True):
        found = again.read(picture)
        assert np.array_equal(found.points_cm, reading.points_cm)  # type: ignore[arg-type]
        assert found.outcome == reading.outcome


def test_previous_tip_decides_between_highest_and_furthest() -> None:
    # A stem, and at two thirds of its height a leaf reaching far to the right: h is the stem's top, c the leaf's end.
    picture = reduced(bar(824, 800, 1150, 810, bar(816, 700, 823, 1099)))
    chosen = {}
    for name, previous in (("none", None), ("at the top", (820.0, 705.0)), ("at the leaf", (1140.0, 805.0))):
        follow = tracker()
        follow.tip_px = previous
        reading = follow.read(picture)
        assert reading.tip_px is not None
        chosen[name] = (reading.tip_choice, round(reading.tip_px[0]) > 1100)
    assert chosen == {"none": ("h", False), "at the top": ("h", False), "at the leaf": ("c", True)}


def test_same_distance_takes_the_furthest() -> None:
    x, y = np.array([0.0, 30.0]), np.array([-40.0, -30.0])  # h = (0, -40), c = (30, -30)
    assert paper.choose_tip(x, y, (0.0, 0.0), (0.0, 0.0)) == (0, "h")
    halfway = (15.0, -35.0)
    assert paper.choose_tip(x, y, (0.0, 0.0), halfway) == (1, "c")


def test_jump_is_named_and_measured() -> None:
    follow = tracker(jump_cm=3.0)
    follow.read(reduced(bar(816, 700, 823, 1099)))
    reading = follow.read(reduced(bar(816, 620, 823, 1099)))
    assert reading.outcome == "jumped"
    assert "4.4 cm" in reading.reason
    assert reading.points_cm is not None
    assert follow.read(reduced(bar(816, 620, 823, 1099))).outcome == "ok"


def test_tip_on_the_edge_is_named() -> None:
    assert tracker().read(reduced(bar(816, 0, 823, 1099))).outcome == "touches_edge"
    window = (700.0, 640.0, 900.0, 1232.0)
    assert tracker(window_px=window).read(reduced(bar(816, 600, 823, 1099))).outcome == "touches_edge"
    assert tracker(window_px=window).read(reduced(bar(816, 660, 823, 1099))).outcome == "ok"


def test_what_lies_outside_the_window_or_below_the_anchor_is_no_stem() -> None:
    lit = bar(100, 100, 200, 200)
    lit = bar(600, 1104, 1000, 1200, lit)
    assert tracker(window_px=(400.0, 300.0, 1200.0, 1231.0)).read(reduced(lit)).outcome == "no_stem"
    mask = tracker().stem_mask(reduced(lit))
    assert mask[25:50, 25:50].all()
    assert not mask[275:].any()


def test_a_gap_lowers_the_quality_and_is_interpolated() -> None:
    ax, ay = CAMERA.anchor_px
    picture = scene(((ax, ay), (ax + 200, ay - 400), 8))
    picture[int(ay) - 300 : int(ay) - 150] = 30
    reading = tracker().read(reduced(picture))
    assert reading.points_cm is not None
    assert 0.5 <= reading.quality <= 0.8
    x, y = reading.points_cm[1:8].T
    assert np.abs(x - y / 2).max() <= HALF_REDUCED_PX_CM


def test_component_guard_is_off_as_published_and_drops_specks_when_asked() -> None:
    speck = bar(1300, 300, 1303, 303, bar(816, 700, 823, 1099))
    assert tracker().read(reduced(speck)).tip_px == (1301.5, 301.5)
    guarded = tracker(smallest_component_px=3).read(reduced(speck))
    assert guarded.tip_px is not None
    assert abs(guarded.tip_px[0] - 819.5) <= 2.0
    assert guarded.stem_pixels == 2 * 100


def test_theta_2_means_the_same_at_both_camera_sizes() -> None:
    small = reduced(scene(((820, 1100), (900, 700), 8)))
    large_camera = CameraSection((819.5 * 2 + 0.5, 2200.5), 36.0, 3280, 2464)
    large = PaperTracker(EMPTY, large_camera, PaperSettings(reduction=8))
    a, b = tracker().read(small), large.read(small)
    assert np.allclose(a.points_cm, b.points_cm, atol=1e-9)  # type: ignore[arg-type]


def test_dark_stem_before_bright_wall_is_found_too() -> None:
    bright = from_pictures([np.full_like(reduced(scene()), 200)])
    picture = np.full_like(reduced(scene()), 200)
    picture[175:275, 204:206] = 100
    assert PaperTracker(bright, CAMERA).read(picture).outcome == "ok"


# --- single equations, against a literal transcription ------------------------------------------------------------


def test_threshold_is_strict_on_both_sides() -> None:
    low, high = np.float32(100 / 255), np.float32(150 / 255)
    for level in range(256):
        literal = (level < 100 - 51) or (level > 150 + 51)
        found = paper.outside_setup(np.array([level / 255], np.float32), low, high, 0.2)  # type: ignore[arg-type]
        assert bool(found[0]) == literal, level


def test_smoothing_follows_the_three_passes() -> None:
    s = {i: (math.sin(2.1 * i), float(i * i)) for i in range(1, 11)}
    points = np.array([s[i] for i in range(1, 11)])
    for members in ((2, 4, 6, 8), (3, 5, 7, 9), (2, 4, 6, 8)):
        for i in members:
            s[i] = (0.5 * (s[i - 1][0] + s[i + 1][0]), 0.5 * (s[i - 1][1] + s[i + 1][1]))
    assert np.array_equal(paper.smooth(points), np.array([s[i] for i in range(1, 11)]))


coordinates = st.lists(st.tuples(st.integers(0, 60), st.integers(1, 60)), min_size=1, max_size=60, unique=True)


@given(coordinates, st.floats(0.3, 20.0), st.tuples(st.integers(-80, 80), st.integers(-80, 80)))
def test_tip_and_points_follow_the_equations(
    pixels: list[tuple[int, int]], theta_2: float, previous: tuple[int, int]
) -> None:
    P = [(float(x), float(-y)) for x, y in pixels]  # picture y runs down: stem pixels lie above the anchor
    ax, ay = anchor = (30.25, 0.0)
    x, y = np.array(P).T
    index, choice = paper.choose_tip(x, y, anchor, previous)
    g = P[index]
    rise = max(abs(ay - yp) for _, yp in P)
    reach = max(abs(ax - xp) + abs(ay - yp) for xp, yp in P)
    if choice == "h":
        assert abs(ay - g[1]) == rise
    else:
        assert abs(ax - g[0]) + abs(ay - g[1]) == pytest.approx(reach)
    points, seen = paper.ten_points(x, y, anchor, g, theta_2)
    assert np.isfinite(points).all()
    for i in range(2, 10):
        height = ay + (i - 1) / 9 * (g[1] - ay)
        near = [xp for xp, yp in P if abs(yp - height) < theta_2 - 1e-9]
        rim = [yp for _, yp in P if abs(abs(yp - height) - theta_2) <= 1e-9]
        assert points[i - 1, 1] == pytest.approx(height)
        if rim:
            continue  # a tie that rounding decides
        assert bool(seen[i - 1]) == bool(near)
        if near:
            assert points[i - 1, 0] == pytest.approx(sum(near) / len(near))
        else:
            assert min(ax, x.min()) - 1e-9 <= points[i - 1, 0] <= max(ax, x.max()) + 1e-9
    assert tuple(points[0]) == anchor
    assert tuple(points[9]) == g


# --- nonsense at the door ------------------------------------------------------------------------------------------

SMALL = CameraSection((9.0, 14.0), 2.0, 20, 16)


@settings(max_examples=150)
@given(hnp.arrays(np.uint8, (16, 20, 3)), hnp.arrays(np.uint8, (2, 16, 20, 3)), st.integers(0, 3))
def test_random_pictures_give_finite_stems(picture: np.ndarray, background: np.ndarray, guard: int) -> None:
    follow = PaperTracker(
        from_pictures(background), SMALL, PaperSettings(reduction=1, theta_1=0.05, smallest_component_px=guard)
    )
    for _ in range(2):
        reading = follow.read(picture)
        assert reading.outcome in get_args(PictureOutcome)
        assert 0.0 <= reading.quality <= 1.0
        if reading.points_cm is None:
            assert reading.outcome == "no_stem"
        else:
            assert reading.points_cm.shape == (10, 2)
            assert np.isfinite(reading.points_cm).all()
            assert tuple(reading.points_cm[0]) == (0.0, 0.0)
            assert reading.points_cm[9, 1] > 0


@given(
    st.sampled_from([np.uint8, np.int16, np.float32, np.bool_]),
    st.lists(st.integers(0, 5), min_size=0, max_size=4),
)
def test_arrays_of_any_kind_raise_bad_picture_only(dtype: type, shape: list[int]) -> None:
    follow = PaperTracker(from_pictures([np.zeros((16, 20, 3), np.uint8)]), SMALL, PaperSettings(reduction=1))
    with pytest.raises(BadPicture):
        follow.read(np.zeros(shape, dtype))
    assert follow.tip_px is None


def test_wrong_size_setup_and_empty_window_are_told() -> None:
    with pytest.raises(BadInput, match="setup matrices are for 410x308 px, pictures are 20x16 px at 1/1"):
        PaperTracker(EMPTY, SMALL, PaperSettings(reduction=1))
    with pytest.raises(BadInput, match="no pixel of the 1640x1232 px picture lies both"):
        tracker(window_px=(0.0, 1150.0, 1640.0, 1232.0))
    with pytest.raises(BadPicture, match="picture is 20x16 px, expected 410x308"):
        tracker().read(np.zeros((16, 20, 3), np.uint8))


def test_bad_picture_is_an_outcome_without_a_stem() -> None:
    reading = bad_picture("x.jpg: is empty (0 bytes)")
    assert (reading.outcome, reading.points_cm, reading.quality) == ("bad_picture", None, 0.0)
