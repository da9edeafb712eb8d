"""The photographs: the plant is where the truth says, and only there."""

from __future__ import annotations

from dataclasses import astuple, replace

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from flora_common.arrays import Float32Array, FloatArray
from flora_common.errors import BadInput
from flora_twin.box import CAMERA, camera_section
from flora_twin.parameters import NAMES, draw_individual
from flora_twin.render import Exposure, Lighting, Studio, Subject
from flora_twin.render.foliage import plant, stem_mesh
from flora_twin.render.mesh import Leaf
from flora_twin.render.painter import paint
from flora_twin.render.sensor import Sensor
from flora_twin.render.shading import Lit, shade
from flora_twin.render.shadows import over_plant
from flora_twin.strips import OFF, LampLight, light_name, read_strips, strip_bytes
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


def test_the_papers_threshold_finds_most_of_the_stem_in_view_at_a_quarter_of_the_size(
    world: World, studio: Studio
) -> None:
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
    seen = np.interp(fine, truth.centreline_cm[:, 1], studio.visible(world.subject())) > 0.9
    assert near[seen].mean() > 0.85  # in a blade's shadow the stem may be too dark for it
    empty = quarter(studio.picture(lights[0], Exposure(), None, (2, 0)))
    assert not ((empty < low - 0.2) | (empty > high + 0.2)).any()


@pytest.mark.parametrize(("seed", "hours"), [(4, 20.0), (6, 60.0), (9, 72.0), (31, 45.0)])
def test_the_true_centreline_is_the_middle_of_the_drawn_stem(studio: Studio, seed: int, hours: float) -> None:
    grown = World(seed)
    grown.set_strips(strip_bytes(LEFT, OFF))
    grown.advance_to(hours * 3600.0)
    line = CAMERA.project(grown.subject().centreline_cm)
    alone = paint(stem_mesh(grown.subject(), CAMERA.position_cm), white_stem(grown.subject()), CAMERA, None)
    assert alone is not None
    cover = np.zeros((CAMERA.height_px, CAMERA.width_px), np.float32)
    cover[alone.window] = alone.cover[..., 1]
    off = off_middle(cover, line[2:-3])
    assert np.abs(off).max() < 0.12  # px; a pixel is half a millimetre
    assert abs(off.mean()) < 0.02


def test_the_photographed_stem_lies_about_the_true_centreline(studio: Studio) -> None:
    # Without lamps light comes from above, and without leaves both sides of an upright stem are lit alike.
    nothing = {"leaf_scale": 1e-3, "petiole_radius_cm": 1e-3, "bud_scale": 1e-3, "initial_lean_rad": 0.0}
    grown = World(12, parameters=draw_individual(12).with_values(**nothing))
    lit, subject = Lighting(OFF, OFF), grown.subject()
    with_plant = np.mean([studio.picture(lit, Exposure(), subject, (0, i)).astype(float) for i in range(6)], axis=0)
    without = np.mean([studio.picture(lit, Exposure(), None, (1, i)).astype(float) for i in range(6)], axis=0)
    line = CAMERA.project(subject.centreline_cm)
    first = int(np.argmax(studio.visible(subject) > 0.95)) + 2
    gain = np.clip(with_plant - without - 8.0, 0.0, None)[..., 1].astype(np.float32)
    off = off_middle(gain, line[first:-4])
    assert len(off) > 10
    assert abs(np.median(off)) < 0.05


@pytest.mark.parametrize("plants", [5, pytest.param(12, marks=pytest.mark.slow)])
def test_nothing_of_the_bud_reaches_a_millimetre_past_the_tip(plants: int) -> None:
    for seed in range(40, 40 + plants):
        grown = World(seed)
        grown.set_strips(strip_bytes(LEFT, OFF))
        grown.advance_to(30 * 3600.0)
        foliage = plant(grown.subject(), CAMERA.position_cm)
        tip, before = foliage.line_cm[-1], foliage.line_cm[-2]
        along = (tip - before) / np.linalg.norm(tip - before)
        bud = foliage.mesh.corners_cm[foliage.mesh.owner >= foliage.bud_owner].reshape(-1, 3)
        assert ((bud - tip) @ along).max() < 0.10
        assert np.linalg.norm(bud - tip, axis=1).min() < 0.30  # round the tip, not somewhere else
        assert ((stem_mesh(grown.subject(), CAMERA.position_cm).corners_cm - tip) @ along).max() < 0.01


@pytest.mark.parametrize("plants", [6, pytest.param(12, marks=pytest.mark.slow)])
def test_leaves_hide_some_of_the_stem_and_hardly_ever_the_tip(studio: Studio, plants: int) -> None:
    hidden, tips = [], []
    for seed in range(200, 200 + plants):
        grown = World(seed)
        for hours, lights in ((36.0, (LEFT, OFF)), (60.0, (OFF, LEFT))):
            grown.set_strips(strip_bytes(*lights))
            grown.advance_to(hours * 3600.0)
            seen = studio.visible(grown.subject())
            height = grown.subject().centreline_cm[:, 1]
            assert seen[height < 0.05].max() < 0.9  # the pot's cloth hides the foot
            assert seen[(height > 0.8) & (height < 1.5)].mean() > 0.9  # and no more than that
            hidden.append(1.0 - seen[height > 0.8].mean())
            tips.append(seen[-1])
    assert np.mean(np.array(hidden) > 0.03) > 0.4
    assert max(hidden) < 0.5
    assert np.mean(np.array(tips) > 0.5) > 0.9


def test_a_blade_keeps_the_light_off_what_is_behind_it_and_softly_so() -> None:
    blade = Leaf(np.array([0.0, 5.0, 0.0]), np.eye(3)[0], np.eye(3)[2] * -1.0, 4.0, 0.0, 0.0, np.full(3, 0.4))
    places = np.array([[1.3, y, 0.0] for y in (4.0, 6.0)] + [[1.3, 3.0, z] for z in np.arange(0.0, 4.0, 0.05)])
    none = np.full(len(places), -1)
    passed = over_plant([blade], places, none, np.array([1.3, 60.0, 0.0]), 4.0)
    assert (passed[0] < 0.30).all()  # below the blade
    assert (passed[1] == 1.0).all()  # above it
    green = passed[2:, 1]
    assert (np.diff(green) >= 0.0).all()  # from the blade's middle to open light
    assert green[0] < 0.30
    assert green[-1] == 1.0
    assert 4 <= ((green > 0.30) & (green < 0.95)).sum() <= 12  # the penumbra of a light of 8 cm: some 3 mm wide
    assert passed[0, 1] > passed[0, 0]  # what comes through a blade is green
    own = over_plant([blade], places, np.zeros(len(places), dtype=int), np.array([1.3, 60.0, 0.0]), 4.0)
    assert (own == 1.0).all()


def test_a_leaf_between_lamp_and_stem_darkens_the_stem(world: World) -> None:
    foliage = plant(world.subject(), CAMERA.position_cm)
    lit = Lit(np.ones(3), (None, None))
    shaded = shade(foliage, lit, 0.0, CAMERA.position_cm, CAMERA.box)
    bare = replace(foliage, blades=[])
    open_sky = shade(bare, lit, 0.0, CAMERA.position_cm, CAMERA.box)
    stem = foliage.mesh.owner == -1
    assert (shaded <= open_sky + 1e-9).all()
    assert (shaded[stem] < 0.85 * open_sky[stem]).mean() > 0.02


def test_looks_are_drawn_after_growth_and_motion() -> None:
    # Values of the seeds before plants had looks: runs made with a seed must keep their plant.
    assert draw_individual(7).leaf_hue == pytest.approx(-0.09512493459434923)
    assert draw_individual(7).nutation_period_min == pytest.approx(81.7939998636845)
    looks = [astuple(draw_individual(seed))[NAMES.index("leaf_droop_rad") :] for seed in range(6)]
    assert len(set(looks)) == 6


def test_no_two_boxes_look_alike(studio: Studio) -> None:
    other = Studio(5)
    one, two = (s.picture(Lighting(OFF, OFF), Exposure(), None, (0,)).astype(float) for s in (studio, other))
    assert np.abs(cv2.blur(one, (5, 5)) - cv2.blur(two, (5, 5)))[:900].mean() > 2.0
    qualities = {Sensor(8, 8, seed).jpeg_quality for seed in range(30)}
    assert min(qualities) >= 85
    assert max(qualities) <= 93
    assert len(qualities) > 4


def white_stem(subject: Subject) -> FloatArray:
    return np.ones((len(stem_mesh(subject, CAMERA.position_cm).owner), 3))


def off_middle(picture: Float32Array, line_px: FloatArray) -> FloatArray:
    """How far the middle of what is bright lies beside each point of a line, in px."""
    tangent = np.gradient(line_px, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    step = np.linspace(-6.0, 6.0, 97)
    at = (line_px[:, None] + step[None, :, None] * across[:, None]).astype(np.float32)
    profile = cv2.remap(picture, at[..., 0], at[..., 1], cv2.INTER_LINEAR).astype(np.float64)
    return np.asarray((profile * step).sum(axis=1) / profile.sum(axis=1), dtype=np.float64)


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

    def photographed(one: Studio, shown: Subject | None, tick: int) -> bytes:
        return one.sensor.encode(one.picture(light, Exposure(), shown, (tick,)))

    first = photographed(studio, subject, 7)
    photographed(studio, None, 8)
    assert photographed(studio, subject, 7) == first
    assert photographed(Studio(4), subject, 7) == first
    assert photographed(studio, subject, 8) != first


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
    assert LampLight(1.0, 1.0, 1.0).bending == pytest.approx(1.0)
    assert strip_bytes(left, right) == grb
    assert light_name(left, right) == "both"
    assert light_name(OFF, right) == "right"
    with pytest.raises(BadInput, match="864"):
        read_strips(grb[:-1])
