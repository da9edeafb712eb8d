"""What is drawn lies where it should, and the photograph itself is left alone."""

from __future__ import annotations

import numpy as np
import pytest

from flora_common.runs import CameraSection
from flora_common.shapes import Obstacle, Target
from flora_common.vision import draw

CAMERA = CameraSection((199.5, 279.5), 10.0, 400, 300)


def grey(width: int = 400, height: int = 300) -> np.ndarray:
    return np.full((height, width, 3), 90, dtype=np.uint8)


def changed(picture: np.ndarray) -> np.ndarray:
    return np.any(picture != 90, axis=2)


def test_cm_are_placed_with_y_up_at_any_size_of_the_picture() -> None:
    full, half = draw.CmToPx(CAMERA, 400), draw.CmToPx(CAMERA, 200)
    assert full([(0, 0), (3, 5)]).tolist() == [[199.5, 279.5], [229.5, 229.5]]
    assert half([(0, 0), (3, 5)]).tolist() == [[99.5, 139.5], [114.5, 114.5]]


def test_input_is_not_drawn_upon() -> None:
    before = grey()
    draw.overlay(
        before,
        CAMERA,
        points_cm=[(0, 0), (1, 9)],
        obstacle=Obstacle(-5, 12),
        target=Target(5, 18),
        light="left",
        caption="x",
    )
    assert not changed(before).any()


def test_stem_runs_through_its_points() -> None:
    points = np.column_stack([np.linspace(0, 5, 10), np.linspace(0, 20, 10)])
    drawn = changed(draw.overlay(grey(), CAMERA, points_cm=points))
    for x, y in np.rint(draw.CmToPx(CAMERA, 400)(points)).astype(int):
        assert drawn[y, x]
    assert not drawn[:70].any()
    assert not drawn[:, :190].any()


def test_obstacle_is_translucent_within_its_edges() -> None:
    picture = draw.overlay(grey(), CAMERA, obstacle=Obstacle(-6.3, 12.5, 7.0, 3.0))
    box = changed(picture)[:260]
    rows, columns = np.nonzero(box)
    to_px = draw.CmToPx(CAMERA, 400)([(-9.8, 14.0), (-2.8, 11.0)])
    assert columns.min() == pytest.approx(to_px[0, 0], abs=2)
    assert columns.max() == pytest.approx(to_px[1, 0], abs=2)
    assert rows.min() == pytest.approx(to_px[0, 1], abs=2)
    assert rows.max() == pytest.approx(to_px[1, 1], abs=2)
    middle = picture[155, 136]
    assert middle.tolist() == [123, 123, 123]  # 0.55 * 150 + 0.45 * 90


def test_target_is_a_red_disc_of_its_radius() -> None:
    picture = draw.overlay(grey(), CAMERA, target=Target(-5.12, 17.9, 2.0))
    red = (picture[:, :, 2] > picture[:, :, 0]) & (np.arange(300)[:, None] < 260)
    assert np.sqrt(red.sum() / np.pi) == pytest.approx(20.0, abs=1.5)  # the outline adds its own width
    rows, columns = np.nonzero(red)
    assert columns.mean() == pytest.approx(199.5 - 51.2, abs=0.7)
    assert rows.mean() == pytest.approx(279.5 - 179, abs=0.7)


@pytest.mark.parametrize(
    ("light", "left", "right"),
    [("left", True, False), ("right", False, True), ("both", True, True), ("dark", False, False)],
)
def test_lamp_circles_are_filled_where_the_lamp_shines(light: str, left: bool, right: bool) -> None:
    picture = draw.overlay(grey(), CAMERA, light=light)  # type: ignore[arg-type]
    radius = round(400 * 0.022)
    yellow = np.all(picture == draw.YELLOW, axis=2)
    assert bool(yellow[2 * radius, 2 * radius]) == left
    assert bool(yellow[2 * radius, 399 - 2 * radius]) == right
    assert changed(picture)[2 * radius, radius - 2 : radius + 3].any()  # the ring is there either way


def test_places_far_outside_and_not_finite_do_no_harm() -> None:
    for points in ([(0, 0), (1e9, -1e9)], [(0, 0), (np.nan, np.inf)]):
        assert draw.overlay(grey(), CAMERA, points_cm=points).shape == (300, 400, 3)
    away = CameraSection((-15_000.0, 20_000.0), 900.0, 400, 300)
    draw.overlay(grey(), away, obstacle=Obstacle(400, 400), target=Target(-400, 400))


def test_long_caption_is_shrunk_to_the_width() -> None:
    drawn = grey(120, 60)
    draw.draw_caption(drawn, "a caption that is far too long for so small a picture, é")
    assert changed(drawn).any()
    assert drawn.shape == (60, 120, 3)


def test_contact_sheet_places_pictures_row_by_row() -> None:
    tiles = [np.full((10 + i, 20, 3), 10 * (i + 1), np.uint8) for i in range(5)]
    sheet = draw.contact_sheet(tiles, columns=2)
    assert sheet.shape == (3 * 14, 40, 3)
    assert [int(sheet[(i // 2) * 14 + 5, (i % 2) * 20 + 10, 0]) for i in range(5)] == [10, 20, 30, 40, 50]
    half = draw.contact_sheet(tiles[:1], columns=4, captions=["x"], tile_width_px=10)
    assert half.shape == (5, 10, 3)
    for pictures, columns, captions in (([], 2, None), (tiles, 0, None), (tiles, 2, ["x"])):
        with pytest.raises(ValueError, match=r"contact sheet|captions"):
            draw.contact_sheet(pictures, columns=columns, captions=captions)
