"""What the empty setup looks like, and what a picture shows beside it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from flora_common.errors import BadInput, BadPicture
from flora_common.runs import CameraSection
from flora_common.vision.lamp_states import EmptySetup, coarse_code, from_background, from_frames, log_code
from flora_common.vision.path.evidence import PlantFinder
from flora_common.vision.path.likeness import USUAL
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.path.survey import plant_score

WIDTH, HEIGHT = 480, 360
CAMERA = CameraSection(anchor_px=(240.0, 340.0), px_per_cm=20.0, width_px=WIDTH, height_px=HEIGHT)
_COARSE = np.random.default_rng(5).uniform(0.5, 1.0, (45, 60)).astype(np.float32)
BOARD = 110.0 * cv2.resize(_COARSE, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)[:, :, None] * np.ones(3, np.float32)
LAMPS = {
    "left": np.linspace(1.5, 0.6, WIDTH)[None, :, None] * np.array([0.8, 1.0, 1.2]),
    "right": np.linspace(0.6, 1.5, WIDTH)[None, :, None] * np.array([1.2, 1.0, 0.8]),
}


def photograph(
    light: str, *, exposure: float = 1.0, stem: tuple[tuple[int, int], tuple[int, int]] | None = None, number: int = 0
) -> np.ndarray:
    """The board under a lamp, with a green line on it or none."""
    surface = BOARD.copy()
    if stem is not None:
        cv2.line(surface, stem[0], stem[1], (60.0, 190.0, 100.0), 5, cv2.LINE_AA)
    noise = np.random.default_rng(number).normal(0.0, 1.0, surface.shape)
    return np.clip(np.rint(exposure * surface * LAMPS[light] + noise), 0, 255).astype(np.uint8)


def finder(settings: PathSettings | None = None, camera: CameraSection = CAMERA) -> PlantFinder:
    setup = from_background([photograph(light, number=k) for k, light in enumerate(("left", "right") * 2)])
    return PlantFinder(setup, camera, settings or PathSettings())


STEM = ((240, 340), (250, 120))


def test_lamp_states_are_told_apart_by_their_looks() -> None:
    order = ["left", "right", "right", "left", "left"]
    setup = from_background([photograph(light, number=k) for k, light in enumerate(order)])
    assert (len(setup.states), sorted(s.pictures for s in setup.states), setup.pictures) == (2, [2, 3], 5)
    assert (setup.made_by, setup.size_px) == ("background", (WIDTH, HEIGHT))
    left = max(setup.states, key=lambda state: state.pictures)
    found, size = setup.nearest(coarse_code(photograph("left", number=9, stem=STEM)))
    assert found is left
    assert size < 3


def test_jitter_of_the_exposure_makes_no_states_of_its_own() -> None:
    pictures = [photograph("left", exposure=e, number=k) for k, e in enumerate((1.0, 0.95, 1.05, 0.98, 1.03))]
    assert len(from_background(pictures).states) == 1


def test_a_setup_without_pictures_or_of_two_sizes_is_refused() -> None:
    with pytest.raises(BadPicture, match="no background pictures"):
        from_background([])
    with pytest.raises(BadPicture, match="background picture 2: 100x50 px, the first has 480x360"):
        from_background([photograph("left"), np.zeros((50, 100, 3), np.uint8)])
    with pytest.raises(BadPicture, match="no background"):
        EmptySetup([], "frames")


def learnt() -> np.ndarray:
    """The code of the setup learnt from a plant that swings about a foot that stands still."""
    frames = [photograph("left", stem=None, number=k).astype(np.float32) for k in range(24)]
    for k, frame in enumerate(frames):
        tint = np.array([60.0, 190.0, 100.0]) * LAMPS["left"][0, 240]
        foot, tip = (240, 290), (round(240 + 110 * np.sin(k / 3.7)), 100)
        cv2.line(frame, (240, 340), foot, tint.tolist(), 5, cv2.LINE_AA)
        cv2.line(frame, foot, tip, tint.tolist(), 5, cv2.LINE_AA)
    pictures = [np.clip(np.rint(f), 0, 255).astype(np.uint8) for f in frames]
    return from_frames(pictures, anchor_px=(240.0, 340.0), widest_px=12.0).code


def test_the_empty_setup_is_learnt_where_the_plant_moved_and_below_at_its_foot() -> None:
    off = np.abs(learnt().astype(int) - log_code(photograph("left", number=99)).astype(int)).max(axis=2)
    off = cv2.blur(off.astype(np.float32), (3, 3))
    assert off[100:260, 120:360].mean() < 3.0
    assert np.quantile(off[100:260, 120:360], 0.99) < 8.0
    foot = off[295:335, 236:245]
    assert foot.mean() < 16.0  # the stem itself differs by some 60


def test_too_few_frames_to_learn_from_are_refused() -> None:
    with pytest.raises(BadPicture, match="4 frames are too few"):
        from_frames([photograph("left")] * 4, anchor_px=(240.0, 340.0), widest_px=12.0)


@pytest.mark.parametrize("light", ["left", "right"])
def test_a_stem_is_evidence_under_either_lamp_and_the_board_is_not(light: str) -> None:
    found = finder().find(photograph(light, stem=STEM, exposure=1.06, number=50))
    x0, y0 = found.origin_px
    on = [found.plant[y - y0, round(240 + 10 * (340 - y) / 220) - x0] for y in range(130, 330, 10)]
    assert min(on) > 4.0 * 5.0
    away = found.plant[:, np.abs(np.arange(found.plant.shape[1]) + x0 - 245) > 14]
    assert (away > 0).mean() < 0.01
    assert found.changed < 0.001
    assert not found.empty


def test_a_shadow_is_no_plant() -> None:
    picture = photograph("left", stem=STEM, number=50).astype(np.float32)
    shade = np.ones((HEIGHT, WIDTH), np.float32)
    cv2.line(shade, (280, 340), (290, 120), 0.75, 7)
    shade = cv2.GaussianBlur(shade, (0, 0), 2.0)
    found = finder().find(np.rint(picture * shade[..., None]).astype(np.uint8))
    x0, y0 = found.origin_px
    rows = np.arange(140, 320, 4)
    columns = np.rint(280 + 10 * (340 - rows) / 220).astype(int)
    stem_columns = np.rint(240 + 10 * (340 - rows) / 220).astype(int)
    inside = columns - x0 < found.plant.shape[1]
    shadow = found.plant[rows[inside] - y0, columns[inside] - x0]
    stem = found.plant[rows - y0, stem_columns - x0]
    assert np.median(shadow) < 0.35 * np.median(stem)


def test_a_picture_moved_by_half_a_pixel_has_no_more_evidence_on_the_board() -> None:
    rough = np.random.default_rng(8).uniform(0.4, 1.0, (HEIGHT, WIDTH)).astype(np.float32)
    rough = 110.0 * cv2.GaussianBlur(rough, (0, 0), 1.2)[:, :, None] * np.ones(3, np.float32)
    empty = np.rint(rough).astype(np.uint8)
    with_stem = rough.copy()
    cv2.line(with_stem, *STEM, (60.0, 190.0, 100.0), 5, cv2.LINE_AA)
    matrix = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, -0.5]])
    moved = cv2.warpAffine(with_stem, matrix, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REPLICATE)
    plants = PlantFinder(from_background([empty]), CAMERA, PathSettings())
    still, shifted = (plants.find(np.rint(p).astype(np.uint8)) for p in (with_stem, moved))
    assert shifted.changed < 0.001
    assert (shifted.plant > 0).mean() < 1.5 * (still.plant > 0).mean() + 0.005


def test_what_differs_everywhere_is_told() -> None:
    picture = photograph("left", number=50)
    patches = np.random.default_rng(2).integers(0, 256, (20, 15, 3), dtype=np.uint8)
    picture[:200, :150] = patches.repeat(10, axis=0).repeat(10, axis=1)
    assert finder().find(picture).changed > 4.0 * USUAL.changed


@pytest.mark.parametrize("noise", [22.0, 40.0])
def test_noise_of_a_dark_board_is_no_change_and_a_change_on_the_bright_one_beside_it_is(noise: float) -> None:
    """In logarithmic code noise of the dark is several times that of the bright; the second is a poor camera's."""
    surface = np.full((HEIGHT, WIDTH, 3), 120.0, np.float32)
    surface[:, : WIDTH // 2] = 6.0

    def taken(number: int) -> np.ndarray:
        off = cv2.GaussianBlur(np.random.default_rng(number).normal(0.0, noise, surface.shape), (0, 0), 2.5)
        return np.clip(np.rint(surface + off), 0, 255).astype(np.uint8)

    plants = PlantFinder(from_background([taken(1)]), CAMERA, PathSettings())
    picture = taken(2)
    off = np.abs(coarse_code(picture).astype(int) - coarse_code(taken(1))).max(axis=2)
    assert (off[:, : WIDTH // 8] > 40).mean() > 0.02
    assert plants.find(picture).changed < 0.2 * USUAL.changed
    picture[40:140, 300:460] = 255 - picture[40:140, 300:460]
    picture[40:140, 300:460] //= 3
    assert plants.find(picture).changed > 4.0 * USUAL.changed


def test_a_window_limits_where_the_plant_is_looked_for_and_an_impossible_one_is_refused() -> None:
    found = finder(PathSettings(window_px=(200, 200, 300, 340))).find(photograph("left", stem=STEM))
    x0, y0 = found.origin_px
    assert x0 >= 200
    assert y0 >= 200
    assert x0 + found.plant.shape[1] <= 301
    with pytest.raises(BadInput, match="no pixel of the 480x360 px picture"):
        finder(PathSettings(window_px=(200, 350, 300, 359)))
    with pytest.raises(BadInput, match="make its pictures anew"):
        finder(camera=CameraSection(anchor_px=(240.0, 340.0), px_per_cm=20.0, width_px=640, height_px=360))
    with pytest.raises(BadPicture, match="picture is 100x100 px, expected 480x360"):
        finder().find(np.zeros((100, 100, 3), np.uint8))


def test_evidence_is_the_same_to_the_last_byte_wherever_in_memory_it_lies() -> None:
    """OpenCV's own magnitude is not: a track that was cut off and resumed differed in the fourth digit."""
    difference = np.random.default_rng(0).normal(0.0, 10.0, (61, 71, 3)).astype(np.float32)
    told, between = set(), []
    for k in range(200):
        told.add(plant_score(difference).tobytes())
        between.append(np.zeros(1000 + 16 * (k % 37), np.uint8))
    assert len(told) == 1
