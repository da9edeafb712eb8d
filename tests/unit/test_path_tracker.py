"""The path method over a sequence of small drawn pictures."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from path_fakes import ANCHOR, CAMERA, HEIGHT, SCALE, WIDTH, tip_error_mm

from flora_common.errors import BadPicture
from flora_common.vision.lamp_states import EmptySetup, from_background
from flora_common.vision.path import apex_error, doubts
from flora_common.vision.path import tracker as tracker_module
from flora_common.vision.path.apex_error import LIMITS_CM
from flora_common.vision.path.guide import Way
from flora_common.vision.path.likeness import USUAL, Likeness, SetupLikeness
from flora_common.vision.path.memory import DOUBTS_BELIEVED, Memory
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.path.survey import Survey, Surveyor
from flora_common.vision.path.tracker import PathTracker
from flora_common.vision.reading import StemReading

_GRAIN = np.random.default_rng(11).normal(0.0, 90.0, (HEIGHT, WIDTH))
BOARD = np.clip(70.0 + cv2.GaussianBlur(_GRAIN, (0, 0), 6.0), 25, 160)[:, :, None] * np.array([1.05, 1.0, 0.95])


def photograph(
    line_cm: np.ndarray | None, number: int = 0, *, leaf: bool = False, board: np.ndarray = BOARD
) -> np.ndarray:
    """The board with a stem along these points, cm from the anchor, y up; none if None."""
    picture = board + np.random.default_rng(number).normal(0.0, 1.5, BOARD.shape)
    picture = np.clip(picture, 0, 255).astype(np.uint8)
    if line_cm is not None:
        px = np.array(ANCHOR) + line_cm * np.array([SCALE, -SCALE])
        points = np.rint(16 * px).astype(np.int32)
        cv2.polylines(picture, [points], False, (60, 200, 90), 5, cv2.LINE_AA, 4)
        if leaf:
            x, y = (round(v) for v in px[len(px) // 2])
            cv2.ellipse(picture, (x + 30, y), (30, 18), 0, 0, 360, (70, 180, 80), -1, cv2.LINE_AA)
    return picture


def swaying(tip_x_cm: float, height_cm: float = 13.0) -> np.ndarray:
    s = np.linspace(0.0, 1.0, 60)
    return np.column_stack([tip_x_cm * s**2, height_cm * s])


def tracker(settings: PathSettings | None = None) -> PathTracker:
    setup = from_background([photograph(None, number=1000 + k) for k in range(2)])
    return PathTracker(setup, CAMERA, settings)


def read_all(one: PathTracker, lines: list[np.ndarray | None], first: int = 0) -> list[StemReading]:
    return [one.read(photograph(line, first + k), 300.0 * (first + k)) for k, line in enumerate(lines)]


def sway(i: int) -> np.ndarray:
    return swaying(3.0 * math.sin(i / 6), 11.0 + 0.02 * i)


def same(a: StemReading, b: StemReading) -> bool:
    assert a.points_cm is not None
    assert b.points_cm is not None
    assert a.line_px is not None
    assert b.line_px is not None
    return a.points_cm.tobytes() == b.points_cm.tobytes() and a.line_px.tobytes() == b.line_px.tobytes()


def test_a_swaying_stem_is_followed_to_a_fraction_of_a_millimetre() -> None:
    lines = [sway(i) for i in range(12)]
    readings = read_all(tracker(), lines)
    assert [r.outcome for r in readings] == ["ok"] * 12
    # the drawn line ends round, half a width further
    assert max(tip_error_mm(r, line) for r, line in zip(readings, lines, strict=True)) < 3.0
    last = readings[-1]
    assert last.uncertainty_mm is not None
    assert last.uncertainty_mm.shape == (10,)
    assert (last.uncertainty_mm > 0).all()
    assert last.quality > 0.9
    assert not last.folded
    assert last.stem_pixels > 500


def test_the_same_pictures_give_the_same_bytes_and_stored_memory_goes_on_where_it_was() -> None:
    lines = [sway(i) for i in range(8)]
    one, two = tracker(), tracker()
    whole, again = read_all(one, lines), read_all(two, lines)
    assert all(same(a, b) for a, b in zip(whole, again, strict=True))
    half = tracker()
    read_all(half, lines[:4])
    stored = msgspec.json.encode(half.memory)
    resumed = tracker()
    resumed.memory = msgspec.json.decode(stored, type=Memory)
    rest = read_all(resumed, lines[4:], first=4)
    assert all(same(a, b) for a, b in zip(whole[4:], rest, strict=True))
    assert resumed.memory == one.memory


def test_looks_may_be_made_in_any_order() -> None:
    lines = [sway(i) for i in range(4)]
    one, two = tracker(), tracker()
    sights = {k: one.look(photograph(lines[k], k)) for k in (3, 1, 0, 2)}
    apart = [one.follow(sights[k], 300.0 * k) for k in range(4)]
    in_turn = [two.follow(two.look(photograph(lines[k], k)), 300.0 * k) for k in range(4)]
    assert all(same(a, b) for a, b in zip(apart, in_turn, strict=True))
    one.memory = None
    glances = {k: one.glance(photograph(lines[k], k)) for k in (3, 1, 0, 2)}
    apart = [one.read_on(glances[k], 300.0 * k) for k in range(4)]
    assert all(same(a, b) for a, b in zip(apart, read_all(tracker(), lines), strict=True))


def test_points_are_even_in_height_or_along_the_stem() -> None:
    line = swaying(6.0)
    by_height = tracker(PathSettings(points="y")).read(photograph(line), 0.0).points_cm
    by_arc = tracker(PathSettings(points="arc")).read(photograph(line), 0.0).points_cm
    assert by_height is not None
    assert by_arc is not None
    assert tuple(by_height[0]) == tuple(by_arc[0]) == (0.0, 0.0)
    assert np.diff(by_height[:, 1]) == pytest.approx(by_height[-1, 1] / 9, abs=1e-6)
    steps = np.hypot(*np.diff(by_arc, axis=0).T)
    assert steps == pytest.approx(steps.mean(), rel=0.01)
    assert np.ptp(np.hypot(*np.diff(by_height, axis=0).T)) > 0.05


def test_a_hook_is_folded() -> None:
    t = np.linspace(0.0, math.pi * 0.95, 40)
    hook = np.concatenate([swaying(0.0, 9.0), np.column_stack([1.8 - 1.8 * np.cos(t), 9.0 + 1.8 * np.sin(t)])[1:]])
    reading = tracker().read(photograph(hook), 0.0)
    assert reading.outcome == "ok"
    assert reading.folded
    assert tip_error_mm(reading, hook) < 4.0


def test_a_stem_that_leaves_the_picture_touches_the_edge() -> None:
    reading = tracker().read(photograph(swaying(1.0, 20.0)), 0.0)
    assert reading.outcome == "touches_edge"


def test_no_stem_where_there_is_none_and_nothing_is_remembered() -> None:
    one = tracker()
    reading = one.read(photograph(None, 5), 0.0)
    assert (reading.outcome, reading.points_cm, one.memory) == ("no_stem", None, None)


def test_a_jump_is_told_and_believed_when_it_stays() -> None:
    one = tracker()
    read_all(one, [swaying(-2.0)] * 3)
    moved = read_all(one, [swaying(3.0)] * 4, first=3)
    assert [r.outcome for r in moved] == ["jumped", "jumped", "jumped", "ok"]
    assert "cm from the one before" in moved[0].reason


@pytest.mark.parametrize(("leapt_cm", "outcome"), [(0.9, "ok"), (1.3, "jumped")])
def test_a_tip_leaps_no_farther_than_plants_move_in_five_minutes(leapt_cm: float, outcome: str) -> None:
    """No tip of the virtual box moves by more than 0.8 cm."""
    one = tracker()
    assert [r.outcome for r in read_all(one, [swaying(0.0)] * 4)] == ["ok"] * 4
    assert one.read(photograph(swaying(leapt_cm), 4), 4 * 300.0).outcome == outcome


def test_a_stem_that_goes_elsewhere_and_comes_back_to_its_tip_jumped() -> None:
    one = tracker()
    read_all(one, [swaying(0.0)] * 4)
    bulged = swaying(0.0) + np.column_stack([1.8 * np.sin(np.linspace(0.0, math.pi, 60)) ** 2, np.zeros(60)])
    reading = one.read(photograph(bulged, 4), 4 * 300.0)
    assert (reading.outcome, reading.reason) == ("jumped", "a part of the stem is 1.8 cm from where it was")


def test_one_jump_is_forgotten() -> None:
    one = tracker()
    read_all(one, [swaying(-2.0)] * 3)
    readings = read_all(one, [swaying(3.0), swaying(-2.0), swaying(-2.0)], first=3)
    assert [r.outcome for r in readings] == ["jumped", "ok", "ok"]
    assert one.memory is not None
    assert one.memory.doubts == 0


SPOILT = {
    "black": np.zeros_like,
    "grey": lambda good: np.full_like(good, 120),
    "white": lambda good: np.full_like(good, 255),
    "moved": lambda good: np.roll(good, (23, 31), (0, 1)),
    "upside down": lambda good: np.ascontiguousarray(good[::-1, ::-1]),
    "blurred": lambda good: np.asarray(cv2.GaussianBlur(good, (0, 0), 18.0)),
    "noise": lambda good: np.random.default_rng(0).integers(0, 256, good.shape, dtype=np.uint8),
    "lower half lost": lambda good: np.where(np.arange(HEIGHT)[:, None, None] < 200, good, np.uint8(128)),
}


@pytest.mark.parametrize("kind", SPOILT)
@pytest.mark.parametrize("followed", [False, True])
def test_a_picture_that_does_not_show_the_setup_is_bad_and_leaves_no_trace(kind: str, followed: bool) -> None:
    one = tracker()
    read_all(one, [sway(i) for i in range(3 if followed else 0)])
    before = one.memory
    reading = one.read(SPOILT[kind](photograph(sway(3), 3)), 900.0)
    assert reading.outcome == "bad_picture"
    assert reading.points_cm is None
    assert reading.reason
    assert one.memory == before
    after = one.read(photograph(sway(4), 4), 1200.0)
    assert after.outcome == "ok"
    assert tip_error_mm(after, sway(4)) < 3.0


def test_a_leaf_beside_the_stem_changes_no_outcome() -> None:
    reading = tracker().read(photograph(swaying(2.0), leaf=True), 0.0)
    assert reading.outcome == "ok"
    assert tip_error_mm(reading, swaying(2.0)) < 3.0


def test_a_hand_that_reaches_in_to_the_stem_is_told() -> None:
    picture = photograph(swaying(1.0))
    cv2.line(picture, (0, 150), (250, 190), (90, 130, 190), 70)
    reading = tracker().read(picture, 0.0)
    assert reading.outcome in ("occluded", "bad_picture")


PLAIN = np.full_like(BOARD, 70.0)


def darker(picture: np.ndarray, where: np.ndarray) -> np.ndarray:
    """As a soft, wide thing leaves it that stands before the board."""
    cover = cv2.GaussianBlur(where.astype(np.float32), (0, 0), 30.0)[:, :, None]
    return np.clip(picture * (1.0 - 0.5 * cover), 0, 255).astype(np.uint8)


def test_what_stands_wide_and_soft_before_a_plain_board_makes_a_first_picture_doubted() -> None:
    arm = np.zeros((HEIGHT, WIDTH))
    arm[:220, :150] = 1.0
    dark = [darker(photograph(sway(k), k, board=PLAIN), arm) for k in range(4)]
    plain = from_background([photograph(None, 1000, board=PLAIN)])
    one = PathTracker(plain, CAMERA)
    readings = [one.read(picture, 300.0 * k) for k, picture in enumerate(dark)]
    assert [r.outcome for r in readings] == ["occluded", "occluded", "ok", "ok"], "what stays is part of the setup"
    assert "something large stands before it" in readings[0].reason
    known = PathTracker(plain, CAMERA)
    known.read(photograph(sway(-1), 9, board=PLAIN), -300.0)
    assert known.read(dark[0], 0.0).outcome == "ok", "a stem that was seen before is known"


def test_light_that_changes_everywhere_is_even() -> None:
    like = from_background([photograph(None, 1)])
    assert likeness(like, darker(photograph(None, 2), np.ones((HEIGHT, WIDTH)))).uneven < 5.0


def test_pictures_of_another_kind_raise_and_change_nothing() -> None:
    one = tracker()
    read_all(one, [sway(0)])
    before = one.memory
    for wrong in (np.zeros((10, 10, 3), np.uint8), np.zeros((HEIGHT, WIDTH), np.uint8)):
        with pytest.raises(BadPicture):
            one.read(wrong, 300.0)
    assert one.memory == before


def surveyed(setup: EmptySetup, picture: np.ndarray) -> Survey:
    return Surveyor(setup, CAMERA, PathSettings()).survey(picture)


def likeness(setup: EmptySetup, picture: np.ndarray) -> Likeness:
    return SetupLikeness(setup, ANCHOR[1]).of(surveyed(setup, picture))


def test_likeness_tells_the_setup_from_others() -> None:
    like = from_background([photograph(None, 1)])
    good = likeness(like, photograph(swaying(1.0), 2))
    assert good.correlation > 0.95
    assert good.gain == pytest.approx(1.0, abs=0.05)
    assert good.elsewhere < 0.2
    blurred = likeness(like, np.asarray(cv2.GaussianBlur(photograph(swaying(1.0), 2), (0, 0), 12.0)))
    assert blurred.gain < 0.6
    other = likeness(like, np.ascontiguousarray(photograph(None, 3)[::-1]))
    assert other.correlation < 0.3
    assert other.elsewhere > 0.7


def test_a_torn_picture_differs_in_one_band_and_where_plant_stands_nothing_is_expected() -> None:
    like = from_background([photograph(None, 1)])
    torn = photograph(None, 2)
    torn[200:300] = np.roll(torn[200:300], 40, axis=1)
    found = likeness(like, torn)
    assert found.correlation > 0.9
    assert found.worst_band < 0.5
    survey = surveyed(like, torn)
    plant = np.zeros_like(survey.plant)
    plant[45:80] = 1
    hidden = SetupLikeness(like, ANCHOR[1]).of(replace(survey, plant=plant))
    assert hidden.worst_band > 0.8


POLE = np.tile(np.full((1, WIDTH, 1), 70.0), (HEIGHT, 1, 3))
POLE[:, 60:75] = 160.0
POLE[300:306] = 140.0


@pytest.mark.parametrize(("right_px", "down_px"), [(0.0, 12.0), (9.0, 0.0), (-30.0, 20.0), (60.0, -60.0)])
def test_a_camera_that_has_moved_is_told_by_how_much_though_a_pole_is_like_itself(
    right_px: float, down_px: float
) -> None:
    like = from_background([photograph(None, 1, board=POLE)])
    matrix = np.array([[1.0, 0.0, right_px], [0.0, 1.0, down_px]])
    moved = np.asarray(cv2.warpAffine(photograph(swaying(2.0), 2, board=POLE), matrix, (WIDTH, HEIGHT), borderMode=2))
    found = likeness(like, moved)
    assert WIDTH * found.moved == pytest.approx(math.hypot(right_px, down_px), abs=3.0)
    assert "camera has moved" in USUAL.unmet(0.0, found)
    stays = likeness(like, photograph(swaying(2.0), 2, board=POLE))
    assert WIDTH * stays.moved < 1.0
    assert not USUAL.unmet(0.0, stays)


@pytest.mark.parametrize(
    "covered", [(9.0, 0.0, -6.0), (-9.0, -9.0, -9.0)], ids=["of another colour", "a little darker"]
)
@pytest.mark.parametrize("ahead_cm", [0.15, 1.6])
def test_what_stands_before_the_board_where_the_first_picture_s_stem_ends_may_hide_more(
    covered: tuple[float, float, float], ahead_cm: float
) -> None:
    line = swaying(2.0)[:41]
    picture = photograph(line, 5)
    hand = picture.copy()
    x, y = (round(v) for v in np.array(ANCHOR) + line[-1] * np.array([SCALE, -SCALE]))
    patch = np.s_[y - round((ahead_cm + 1.85) * SCALE) : y - round(ahead_cm * SCALE), x - 35 : x + 35]
    hand[patch] = np.clip(photograph(None, 5)[patch] + np.array(covered), 0, 255).astype(np.uint8)
    first = tracker().read(hand, 0.0)
    assert (first.outcome, first.reason) == ("occluded", doubts.HIDES_MORE)
    assert tracker().read(picture, 0.0).outcome == "ok"


@pytest.mark.parametrize("noise", [0.0, 4.0, 8.0])
def test_noise_is_no_structure(noise: float) -> None:
    rng = np.random.default_rng(5)
    bare = [np.clip(90 + rng.normal(0, noise, (HEIGHT, WIDTH, 3)), 0, 255).astype(np.uint8) for _ in range(2)]
    like = from_background(bare[:1])
    assert replace(likeness(like, bare[1]), uneven=0.0) == Likeness()


class Saying:
    """A perceptron that says what it is told to."""

    def __init__(self) -> None:
        self.off = np.zeros(len(LIMITS_CM))

    def chances(self, views: np.ndarray) -> np.ndarray:
        assert views.shape[0] == 2
        return self.off


def test_what_surrounds_an_end_decides_whether_and_how_far_it_is_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a first picture alone; of a plant that was plain once, over an hour."""
    saying = Saying()
    monkeypatch.setattr(apex_error, "perceptron", lambda: saying)
    plain = tracker().read(photograph(swaying(1.0)), 0.0)
    saying.off = np.array([0.05, 0.03, 0.02, 0.01])
    less_so = tracker().read(photograph(swaying(1.0)), 0.0)
    saying.off = np.array([0.4, 0.3, 0.2, 0.1])
    hidden = tracker().read(photograph(swaying(1.0)), 0.0)
    assert (plain.outcome, less_so.outcome) == ("ok", "ok")
    assert (hidden.outcome, hidden.reason) == ("occluded", doubts.HIDDEN_END)
    said = []
    for reading in (plain, less_so, hidden):
        assert reading.uncertainty_mm is not None
        said.append(float(reading.uncertainty_mm[-1]))
    own_mm = said[0]
    for off, mm in (([0.05, 0.03, 0.02, 0.01], said[1]), ([0.4, 0.3, 0.2, 0.1], said[2])):
        assert mm == pytest.approx(math.hypot(own_mm, 10.0 * apex_error.error_cm(np.array(off))), rel=0.02)

    followed = tracker()
    saying.off = np.zeros(len(LIMITS_CM))
    followed.read(photograph(swaying(1.0)), 0.0)
    saying.off = np.array([0.4, 0.3, 0.2, 0.1])
    outcomes = [followed.read(photograph(swaying(1.0), k), 1200.0 * k).outcome for k in range(1, 10)]
    assert outcomes[0] == "ok"
    assert outcomes[-1] == "occluded"


def test_the_first_three_whole_pictures_are_looked_at_closely(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twenty minutes and more apart, so that each is looked at whole; the first two are doubtful starts."""
    looks: list[float] = []
    really = tracker_module.closely

    def closely(*given: Any) -> tuple[Way, ...]:
        looks.append(time_s)
        return really(*given)

    monkeypatch.setattr(tracker_module, "closely", closely)
    one, known = tracker(), []
    for k in range(8):
        time_s = 1260.0 * k
        one.read(photograph(swaying(-2.0), k), time_s)
        known += [one.memory is not None]
    assert known == [False, False, *[True] * 6]
    assert looks == [1260.0 * k for k in range(2 + 3)]


def test_what_an_end_looked_like_says_nothing_of_another_place_that_is_believed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    saying, one = Saying(), tracker()
    monkeypatch.setattr(apex_error, "perceptron", lambda: saying)
    saying.off = np.array([0.9, 0.9, 0.8, 0.7])
    assert {r.outcome for r in read_all(one, [swaying(-2.0)] * 6)} == {"occluded"}
    saying.off = np.zeros(len(LIMITS_CM))
    moved = [one.follow(one.look(photograph(swaying(3.0), k)), 300.0 * k) for k in range(6, 10)]
    assert [r.outcome for r in moved] == ["jumped", "jumped", "jumped", "ok"]


def test_a_doubtful_start_is_believed_where_the_next_ones_are_no_clearer_and_begins_anew_where_it_is_told_to(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Dim:
        def unmet(self, changed: float, likeness: Likeness) -> str:
            return "dim"

    monkeypatch.setattr(tracker_module, "OF_THE_FIRST", Dim())
    one = tracker()
    outcomes = [one.read(photograph(swaying(1.0), k), 300.0 * k).outcome for k in range(DOUBTS_BELIEVED)]
    assert outcomes == ["occluded"] * (DOUBTS_BELIEVED - 1) + ["ok"]
    one.memory = None
    again = one.read(photograph(swaying(1.0), 9), 3000.0)
    assert (again.outcome, again.reason) == ("occluded", "dim")
