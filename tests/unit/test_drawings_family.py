"""The drawn family of photographs: the same for the same seed, true to its own truth, and complete."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest

from drawings import damaged, drawn_run, goods, make_world
from drawings.camera import SHAKE_PX
from drawings.damage import END_MARK, KINDS
from drawings.good import Good, decoded, stem_share
from drawings.growth import light_at
from drawings.hiding import HIDDEN_CM, TIP_HIDDEN_CM, inside
from drawings.leaves import SHAPES
from drawings.stem import Canvas, Lit, draw_strip
from drawings.textures import BOARDS
from flora_common.arrays import FloatArray
from flora_common.geometry import distance_to_polyline_cm
from flora_common.runs import LIGHTS

SMALL = 410, 308
HOUR_S = 3600.0


def test_a_seed_gives_the_same_run_whatever_the_interval_and_another_seed_another() -> None:
    coarse, fine, other = (
        drawn_run(s, hours=4.0, every_s=e, size_px=SMALL) for s, e in ((5, 7200), (5, 3600), (6, 7200))
    )
    assert list(coarse.background) == list(fine.background)
    assert coarse.camera == fine.camera != other.camera
    wide, narrow = list(coarse.frames()), list(fine.frames())
    assert [f.time_s for f in wide] == [0.0, 7200.0, 14400.0]
    for one, same in zip(wide, narrow[::2], strict=True):
        assert one.jpeg == same.jpeg
        assert one.light == same.light
        assert np.array_equal(one.centreline_cm, same.centreline_cm)
    assert wide[1].jpeg != next(iter(other.frames())).jpeg
    assert [f.jpeg for f in coarse.frames()] == [f.jpeg for f in wide]


def test_pictures_have_the_size_the_camera_says_and_the_background_shows_every_lamp_state() -> None:
    run = drawn_run(8, hours=1.0, every_s=HOUR_S, size_px=SMALL)
    pictures = [decoded(data) for data in (*run.background, *(f.jpeg for f in run.frames()))]
    assert {p.shape for p in pictures if p is not None} == {(run.camera.height_px, run.camera.width_px, 3)}
    states = [np.mean(np.stack(pictures[2 * k : 2 * k + 2]), axis=0) for k in range(len(LIGHTS))]
    left, right, dark, both = (state.mean() for state in states)
    assert dark < min(left, right) < max(left, right) < both


@pytest.mark.parametrize("seed", range(4))
def test_the_stem_grows_at_its_tip_and_keeps_its_foot(seed: int) -> None:
    growth = make_world(seed, size_px=SMALL).plant.growth
    postures = [growth.at(h * HOUR_S) for h in (0, 24, 48, 72)]
    lengths = [p.length_cm for p in postures]
    assert 3.0 <= lengths[0] <= 7.0
    assert 12.0 <= lengths[-1] <= 25.0
    assert lengths == sorted(lengths)
    for posture in postures:
        assert len(posture.line_cm) >= 60
        assert posture.line_cm[0].tolist() == [0.0, 0.0]
        steps = np.hypot(*np.diff(posture.line_cm, axis=0).T)
        assert np.allclose(steps, posture.along_cm[1], rtol=1e-6)
    old = postures[2].line_cm[postures[2].along_cm < lengths[2] - growth.zone_cm - 0.2]
    assert distance_to_polyline_cm(old, postures[3].line_cm).max() < 0.01
    minutes = np.array([growth.at(48 * HOUR_S + 60.0 * m).line_cm[-1] for m in range(60)])
    assert np.hypot(*np.diff(minutes, axis=0).T).max() < 0.1


def test_the_tip_turns_to_the_lit_lamp() -> None:
    turned = []
    for seed in range(12):
        world = make_world(seed, size_px=SMALL)
        growth = world.plant.growth
        if growth.hook_rad or growth.nod_rad:
            continue
        ends = [start_s for start_s, _ in world.schedule[1:] if start_s <= 72 * HOUR_S]
        for before_s, after_s in pairwise(ends):
            side = -1.0 if light_at(world.schedule, after_s) == "left" else 1.0
            change = growth.at(after_s).heading_rad[-1] - growth.at(before_s).heading_rad[-1]
            turned.append(side * change)
    assert len(turned) > 20
    assert np.median(turned) > 0.1


def test_a_strip_lies_evenly_about_its_line_and_ends_where_the_line_ends() -> None:
    turn = np.linspace(0, 3.6, 200)  # folds back past its own beginning's direction
    line = np.column_stack([80.3 + 40 * np.cos(turn), 90.7 - 40 * np.sin(turn)])
    canvas = Canvas.empty(10, 20, 170, 160)
    even = Lit(np.array([0.0, 0.0, 1.0]), np.ones(3, np.float32), np.ones((2, 2), np.float32), 0.0)
    draw_strip(canvas, line, np.full(200, 3.4), np.ones((200, 3), np.float32), [even])
    tangent = np.gradient(line, axis=0)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]]) / np.hypot(*tangent.T)[:, None]
    across = np.arange(-7, 7.01, 0.05)
    at = (line[8:-8, None] + across[:, None] * normal[8:-8, None]).astype(np.float32) - (10, 20)
    cover = cv2.remap(canvas.cover, at[..., 0].astype(np.float32), at[..., 1].astype(np.float32), cv2.INTER_LINEAR)
    width = cover.sum(axis=1) * 0.05
    middle = (cover * across).sum(axis=1) / cover.sum(axis=1)
    assert np.abs(width - 6.8).max() < 0.25
    assert np.abs(middle).max() < 0.12
    assert abs(float(np.mean(middle))) < 0.02  # the chords of a bend this tight lie 0.013 px inside it
    ahead = tangent[-1] / np.hypot(*tangent[-1])
    beyond = (line[-1] + np.arange(-6, 6.01, 0.05)[:, None] * ahead - (10, 20)).astype(np.float32)
    along = cv2.remap(canvas.cover, beyond[:, :1], beyond[:, 1:], cv2.INTER_LINEAR)
    assert abs(float(along.sum()) * 0.05 - 6.0) < 0.1


@pytest.mark.parametrize("seed", [0, 1, 3, 5])
def test_the_photograph_shows_the_stem_where_the_truth_says(seed: int) -> None:
    world = make_world(seed, size_px=(820, 616))
    posture = world.plant.growth.at(40 * HOUR_S)
    light = light_at(world.schedule, posture.time_s)
    shots = [
        world.camera.photograph(np.random.default_rng(1), light, *a) for a in ((world.plant, posture), (None, None))
    ]
    assert np.array_equal(shots[0].shake_px, shots[1].shake_px)
    with_plant, without = (decoded(s.jpeg) for s in shots)
    assert with_plant is not None
    assert without is not None
    change = np.abs(with_plant.astype(int) - without).max(axis=2)
    scale = world.section.px_per_cm
    line = posture.line_cm * (scale, -scale) + world.section.anchor_px + shots[0].shake_px
    seen = line[posture.along_cm > 1.0]
    on_stem = change[np.rint(seen[:, 1]).astype(int), np.rint(seen[:, 0]).astype(int)]
    assert np.median(on_stem) > 3 * max(2.0, float(np.median(change[: change.shape[0] // 4])))
    frame = world.frame(posture.time_s)
    assert np.abs(frame.centreline_cm - posture.line_cm).max() <= SHAKE_PX / scale + 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_leaves_never_hide_too_much_of_the_stem(seed: int) -> None:
    plant = make_world(seed, size_px=SMALL).plant
    for hour in (3, 27, 51, 69):
        posture = plant.growth.at(hour * HOUR_S)
        hidden = np.zeros(len(posture.line_cm), bool)
        for put in plant.placed(posture):
            if put.before:
                hidden |= inside(posture.line_cm, put.upper_cm) | inside(posture.line_cm, put.lower_cm)
        assert _longest(hidden) * posture.along_cm[1] <= HIDDEN_CM
        assert np.hypot(*(posture.line_cm[~hidden] - posture.line_cm[-1]).T).min() <= TIP_HIDDEN_CM


def _longest(hidden: FloatArray) -> int:
    longest = run = 0
    for one in hidden:
        run = run + 1 if one else 0
        longest = max(longest, run)
    return longest


@pytest.mark.parametrize("board", BOARDS)
def test_every_board_can_be_drawn(board: str) -> None:
    world = make_world(11, size_px=SMALL, board=board)
    picture = decoded(world.frame(30 * HOUR_S).jpeg)
    assert picture is not None
    assert picture.std() > 3
    assert world.camera.scene.board == board


@pytest.mark.parametrize("shape", SHAPES)
def test_every_leaf_can_be_drawn_and_hangs_on_its_stem(shape: str) -> None:
    world = make_world(12, size_px=SMALL, shapes=(shape,))
    posture = world.plant.growth.at(60 * HOUR_S)
    placed = [p for p in world.plant.placed(posture) if p.leaf.blade.shape == shape]
    assert len(placed) >= 2
    feet = np.array([p.petiole_cm[0] for p in placed])
    assert distance_to_polyline_cm(feet, posture.line_cm).max() < 0.01
    assert decoded(world.frame(60 * HOUR_S).jpeg) is not None


@pytest.fixture(scope="module")
def good() -> list[Good]:
    return goods(drawn_run(3, hours=72.0, every_s=24 * HOUR_S, size_px=SMALL), 3)


def test_damage_of_every_kind_and_the_same_for_the_same_seed(good: list[Good]) -> None:
    once, again = (list(damaged(7, len(KINDS), good)) for _ in range(2))
    assert [d.kind for d in once] == list(KINDS)
    for a, b in zip(once, again, strict=True):
        assert a.data == b.data
        assert a.has_stem == b.has_stem
    other = list(damaged(8, len(KINDS), good))
    assert sum(a.data != b.data for a, b in zip(once, other, strict=True)) >= len(KINDS) - 3


def test_damage_says_what_is_left(good: list[Good]) -> None:
    shape = (good[0].camera.height_px, good[0].camera.width_px, 3)
    for spoilt in damaged(9, 3 * len(KINDS), good):
        picture = decoded(spoilt.data)
        if spoilt.kind in {"black", "white", "grey", "no plant", "foreign", "nothing", "text"}:
            assert not spoilt.has_stem
            assert spoilt.truth_cm is None
        if spoilt.kind in {"nothing", "text"} or picture is None:
            assert picture is None
            assert not spoilt.has_stem
        if spoilt.kind in {"noisy", "blurred", "dark", "moved", "two plants", "fogged", "png"}:
            assert spoilt.has_stem
        if spoilt.truth_cm is not None:
            assert picture is not None
            assert picture.shape == shape
        if spoilt.kind in {"turned", "other size"}:
            assert spoilt.truth_cm is None
            assert picture is not None
            assert picture.shape != shape
        if spoilt.kind == "moved":
            assert spoilt.truth_cm is not None
            by_px = (spoilt.truth_cm - good[spoilt.source].centreline_cm) * good[spoilt.source].camera.px_per_cm
            assert np.ptp(by_px, axis=0).max() < 1e-9
            assert 10 <= float(np.hypot(*by_px[0])) <= 100
        if spoilt.kind == "png":
            assert spoilt.data.startswith(b"\x89PNG")


def test_a_stem_lost_with_the_end_of_the_file_counts_as_lost(good: list[Good]) -> None:
    for picture in good:
        assert stem_share(picture.jpeg, picture) == 1.0
        assert stem_share(picture.empty, picture) < 0.6
        early = picture.jpeg[: len(picture.jpeg) // 4] + END_MARK
        assert decoded(early) is not None
        assert stem_share(early, picture) < 0.1
