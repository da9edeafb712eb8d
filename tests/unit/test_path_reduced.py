"""Large pictures are looked at in a part of their size, and told in px of their own."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from path_fakes import CAMERA, HEIGHT, WIDTH, drawn, tip_error_mm

from flora_common.errors import BadInput, BadPicture
from flora_common.runs import CameraSection
from flora_common.vision.lamp_states import from_background
from flora_common.vision.path.reduced import WIDEST_STEM_PX, reduced
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.path.tracker import PathTracker
from flora_common.vision.picture import REDUCTIONS, Picture, Reduction, reduce_picture

TWICE = CameraSection(
    anchor_px=((CAMERA.anchor_px[0] + 0.5) * 2 - 0.5, (CAMERA.anchor_px[1] + 0.5) * 2 - 0.5),
    px_per_cm=2 * CAMERA.px_per_cm,
    width_px=2 * WIDTH,
    height_px=2 * HEIGHT,
)
LEANING = np.column_stack([2.0 * np.linspace(0, 1, 50) ** 2, np.linspace(0, 11, 50)])


def photograph(line_cm: np.ndarray | None, seed: int) -> Picture:
    """A picture of ``CAMERA``."""
    rng = np.random.default_rng(seed)
    grain = np.random.default_rng(1).normal(60.0, 5.0, (HEIGHT, WIDTH, 3))
    picture = np.clip(grain + rng.normal(0.0, 1.5, grain.shape), 0, 255).astype(np.uint8)
    return picture if line_cm is None else drawn(picture, line_cm)


def twice(picture: Picture) -> Picture:
    """As ``TWICE`` takes it; averaged over squares of two by two it is what it was."""
    return picture.repeat(2, axis=0).repeat(2, axis=1)


def tracker(settings: PathSettings) -> PathTracker:
    reduction = reduced(TWICE, settings).reduction
    empty = [reduce_picture(twice(photograph(None, 100 + k)), reduction) for k in range(2)]
    return PathTracker(from_background(empty), TWICE, settings)


def test_a_picture_of_twice_the_size_tells_the_same_stem_in_its_own_px() -> None:
    small = PathTracker(from_background([photograph(None, 100 + k) for k in range(2)]), CAMERA)
    large = tracker(PathSettings())
    assert large.seen.reduction == 2
    for k in range(3):
        line = LEANING + np.column_stack([0.05 * k * np.linspace(0, 1, 50) ** 2, np.zeros(50)])
        told = small.read(photograph(line, k), 300.0 * k)
        found = large.read(reduce_picture(twice(photograph(line, k)), 2), 300.0 * k)
        assert found.outcome == told.outcome == "ok"
        assert tip_error_mm(found, line) < 3.0
        assert np.allclose(found.points_cm, told.points_cm, atol=1e-6)
        assert found.line_px is not None
        assert np.allclose(found.line_px, (np.asarray(told.line_px) + 0.5) * 2 - 0.5, atol=1e-4)
        assert found.tip_px == pytest.approx(tuple(found.line_px[-1]))
        assert np.allclose(found.line_px[0], TWICE.anchor_px, atol=3.0)


def test_of_another_size_nothing_is_read_and_nothing_remembered() -> None:
    one = tracker(PathSettings())
    one.read(reduce_picture(twice(photograph(LEANING, 0)), 2), 0.0)
    before = one.memory
    assert before is not None
    with pytest.raises(BadPicture, match="expected 480x400"):
        one.read(twice(photograph(LEANING, 1)), 300.0)
    assert one.memory is before
    full = tracker(PathSettings(reduction=1))
    full.memory = msgspec.json.decode(msgspec.json.encode(before), type=type(before))
    assert full.memory is None  # its px are other ones
    with pytest.raises(BadInput, match="known at 480x400 px"):
        PathTracker(from_background([photograph(None, 1)]), TWICE, PathSettings(reduction=1))


@pytest.mark.parametrize(
    ("px_per_cm", "size_px", "widest_cm", "reduction"),
    [
        (18.4, (1640, 1232), 0.6, 1),
        (36.0, (3280, 2464), 0.6, 1),  # the widest stem would have 10.8 px
        (36.8, (3280, 2464), 0.6, 2),
        (55.0, (4608, 2592), 0.6, 2),
        (75.0, (6000, 4000), 0.6, 4),
        (148.0, (6000, 4000), 0.6, 8),
        (148.0, (3000, 2000), 0.6, 4),  # a picture keeps 400 px
        (40.0, (640, 480), 0.6, 1),
        (75.0, (6000, 4000), 0.25, 1),  # thin stems need all there is
    ],
)
def test_pictures_are_as_small_as_the_widest_stem_lets_them_be(
    px_per_cm: float, size_px: tuple[int, int], widest_cm: float, reduction: Reduction
) -> None:
    camera = CameraSection((800.0, 700.0), px_per_cm, *size_px)
    seen = reduced(camera, PathSettings(widest_stem_cm=widest_cm))
    assert seen.reduction == reduction
    assert seen.camera.px_per_cm * reduction == pytest.approx(px_per_cm)
    assert seen.widest_px >= WIDEST_STEM_PX or reduction == 1


@pytest.mark.parametrize("reduction", REDUCTIONS)
def test_places_in_reduced_pictures_are_those_in_full_ones(reduction: Reduction) -> None:
    window = (100.0, 50.0, 1500.0, 1100.0)
    camera = CameraSection((801.3, 1003.8), 31.7, 1641, 1233)
    seen = reduced(camera, PathSettings(reduction=reduction, window_px=window))
    assert seen.reduction == reduction
    assert (seen.camera.width_px, seen.camera.height_px) == (math.ceil(1641 / reduction), math.ceil(1233 / reduction))
    assert seen.full_px(np.array(seen.camera.anchor_px)) == pytest.approx(camera.anchor_px)
    assert seen.settings.window_px is not None
    assert seen.full_px(np.array(seen.settings.window_px)) == pytest.approx(window)
    # one reduced pixel stands for a square whose middle is its centre
    assert seen.full_px(np.array([0.0, 0.0])) == pytest.approx(((reduction - 1) / 2,) * 2)
