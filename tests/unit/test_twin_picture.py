"""The photographs: the plant is where the truth says, and only there."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from flora_common.errors import BadInput
from flora_common.geometry import FloatArray
from flora_twin.box import CAMERA, camera_section
from flora_twin.render import Exposure, Lighting, Studio
from flora_twin.strips import FULL_WHITE, OFF, LampLight, light_name, read_strips, strip_bytes
from flora_twin.world import World

Picture = npt.NDArray[np.uint8]
LEFT = LampLight(0.35, 0.45, 1.0)


@pytest.fixture(scope="module")
def world() -> World:
    grown = World(4)
    grown.set_strips(strip_bytes(LEFT, OFF))
    grown.set_flash(True)
    grown.advance_to(50 * 3600.0)
    return grown


@pytest.fixture(scope="module")
def studio() -> Studio:
    return Studio(4)


def read(jpeg: bytes) -> Picture:
    return np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR), dtype=np.uint8)


def green_at(picture: Picture, pixels: FloatArray) -> FloatArray:
    x, y = np.rint(pixels).astype(int).T
    return picture[y, x, 1].astype(np.float64)


def test_camera_geometry_is_that_of_the_paper() -> None:
    section = camera_section()
    assert (section.width_px, section.height_px) == (1640, 1232)
    # 62.2 degrees at 74 cm are 89.3 cm across.
    assert section.px_per_cm == pytest.approx(1640 / 89.27, rel=1e-3)
    assert section.anchor_px[0] == pytest.approx(819.5)
    assert 616 < section.anchor_px[1] < 1232
    tip = CAMERA.project(np.array([[5.0, 20.0, 0.0]]))
    assert CAMERA.to_picture_plane_cm(tip)[0] == pytest.approx([5.0, 20.0])


def test_pixels_along_the_true_centreline_are_bright_with_a_plant_and_dark_without(world: World) -> None:
    with_plant = read(world.photograph(20_000.0)[0])
    world.set_planted(False)
    without = read(world.photograph(20_000.0)[0])
    assert world.truth() is None
    world.set_planted(True)
    truth = world.truth()
    assert truth is not None
    line = truth.centreline_px[truth.centreline_cm[:, 1] > 0.5]
    gain = green_at(with_plant, line) - green_at(without, line)
    assert np.percentile(gain, 5) > 51  # 0.2 of full scale, the threshold of the paper's method
    away = line + np.array([60.0, 0.0])
    inside = np.abs(green_at(with_plant, away) - green_at(without, away)) < 40
    assert inside.mean() > 0.6  # leaves may hang there
    far = np.abs(with_plant[:400, 300:1300].astype(int) - without[:400, 300:1300])
    assert np.percentile(far, 99.9) < 25


def test_the_papers_threshold_finds_the_whole_stem_at_a_quarter_of_the_size(world: World, studio: Studio) -> None:
    def quarter(picture: Picture) -> FloatArray:
        return cv2.resize(picture[..., 1], None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA) / 255.0

    lights = [Lighting(LEFT, OFF), Lighting(OFF, LEFT), Lighting(OFF, OFF)]
    setup = [quarter(studio.picture(light, Exposure(), None, (0, i))) for i, light in enumerate(lights * 2)]
    low, high = np.min(setup, axis=0), np.max(setup, axis=0)
    seen = quarter(studio.picture(lights[0], Exposure(), world.subject(), (1, 0)))
    plant = (seen < low - 0.2) | (seen > high + 0.2)
    truth = world.truth()
    assert truth is not None
    fine = np.linspace(0.5, truth.height_cm - 0.2, 120)
    x_cm = np.interp(fine, truth.centreline_cm[:, 1], truth.centreline_cm[:, 0])
    ax, ay = CAMERA.anchor_px
    columns = np.rint((ax + x_cm * CAMERA.px_per_cm) / 4 - 0.375).astype(int)
    rows = np.rint((ay - fine * CAMERA.px_per_cm) / 4 - 0.375).astype(int)
    near = plant[rows, columns] | plant[rows, columns - 1] | plant[rows, columns + 1]
    assert near.mean() > 0.97
    empty = quarter(studio.picture(lights[0], Exposure(), None, (2, 0)))
    assert not ((empty < low - 0.2) | (empty > high + 0.2)).any()


def test_leaves_grow_and_are_large_enough_to_matter(world: World) -> None:
    young, old = World(4).truth(), world.truth()
    assert young is not None
    assert old is not None
    assert max(leaf["length_cm"] for leaf in young.leaves) < max(leaf["length_cm"] for leaf in old.leaves)
    assert len(old.leaves) == 5
    assert max(leaf["length_cm"] for leaf in old.leaves) > 4.0


def test_without_flash_the_picture_is_dim(world: World, studio: Studio) -> None:
    lit = studio.picture(Lighting(OFF, OFF, flash=True), Exposure(), world.subject(), (0,))
    dim = studio.picture(Lighting(OFF, OFF, flash=False), Exposure(), world.subject(), (0,))
    assert dim.mean() < 0.3 * lit.mean()
    assert np.percentile(dim, 99) < 40


def test_a_lit_lamp_saturates_and_tints_its_side(studio: Studio) -> None:
    picture = studio.picture(Lighting(LEFT, OFF), Exposure(), None, (0,))
    left, right = CAMERA.project(CAMERA.box.lamps_cm)
    x, y = np.rint(left).astype(int)
    assert picture[y - 15 : y + 15, x - 15 : x + 15, 1].min() > 250
    near = picture[y - 10 : y + 10, x + 110 : x + 150].mean(axis=(0, 1))
    assert near[0] > near[2] + 15  # blue over red
    x, y = np.rint(right).astype(int)
    assert picture[y - 15 : y + 15, x - 15 : x + 15, 1].mean() < 200


def test_exposure_and_gains_act(studio: Studio) -> None:
    light = Lighting(OFF, OFF)
    plain = studio.picture(light, Exposure(), None, (0,)).mean(axis=(0, 1))
    longer = studio.picture(light, Exposure(exposure_us=40_000.0), None, (0,)).mean(axis=(0, 1))
    redder = studio.picture(light, Exposure(colour_gains=(3.0, 1.6)), None, (0,)).mean(axis=(0, 1))
    assert longer == pytest.approx(plain * np.sqrt(2.0), rel=0.06)
    assert redder[2] > 1.15 * plain[2]
    assert redder[1] == pytest.approx(plain[1], rel=0.01)


def test_pictures_follow_from_seed_and_tick_alone(world: World, studio: Studio) -> None:
    light, subject = Lighting(LEFT, OFF), world.subject()
    first = studio.photograph(light, Exposure(), subject, (7,))
    studio.photograph(light, Exposure(), None, (8,))
    assert studio.photograph(light, Exposure(), subject, (7,)) == first
    assert Studio(4).photograph(light, Exposure(), subject, (7,)) == first
    assert studio.photograph(light, Exposure(), subject, (8,)) != first


def test_two_pictures_at_one_time_differ_only_by_noise(world: World) -> None:
    a, b = (read(world.photograph(20_000.0)[0]).astype(int) for _ in range(2))
    assert 0.3 < np.abs(a - b).mean() < 4.0


def test_metadata_are_named_as_picamera2_names_them(world: World) -> None:
    _, metadata = world.photograph(20_000.0, 2.0, (1.8, 1.5))
    assert metadata["ExposureTime"] == pytest.approx(20_000, abs=19)
    assert metadata["AnalogueGain"] == pytest.approx(2.0, rel=0.01)
    assert metadata["DigitalGain"] == 1.0
    assert metadata["ColourGains"] == [1.8, 1.5]
    assert metadata["SensorTimestamp"] == round(world.time_s * 1e9)


@pytest.mark.parametrize("settings", [(0.0, 1.0), (1e9, 1.0), (20_000.0, 0.5), (20_000.0, float("nan"))])
def test_settings_that_no_camera_takes_are_refused(world: World, settings: tuple[float, float]) -> None:
    with pytest.raises(BadInput, match="must lie in"):
        world.photograph(*settings)


def test_strip_bytes_are_read_in_the_order_of_the_chain() -> None:
    grb = bytes([255, 0, 0] * 144 + [0, 0, 51] * 144)
    left, right = read_strips(grb)
    assert (left.red, left.green, left.blue) == (0.0, 1.0, 0.0)
    assert (right.red, right.green, right.blue) == (0.0, 0.0, pytest.approx(0.2))
    assert right.bending > left.bending  # plants bend to blue, hardly to green
    assert FULL_WHITE.bending == pytest.approx(1.0)
    assert strip_bytes(left, right) == grb
    assert light_name(left, right) == "both"
    assert light_name(OFF, right) == "right"
    with pytest.raises(BadInput, match="864"):
        read_strips(grb[:-1])
