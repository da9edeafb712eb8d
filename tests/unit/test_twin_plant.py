"""The growing rod: growth, bending, stiffening, circumnutation, and that it goes on exactly where it was."""

from __future__ import annotations

import io

import numpy as np
import pytest

from flora_common.errors import BadInput
from flora_common.light_schedule import parse_schedule
from flora_twin.grow import grow, grow_many
from flora_twin.parameters import NAMES, SPREAD, PlantParameters, draw_individual
from flora_twin.plant import LONG_SEGMENT_CM, STEP_S, Plants

CALM = PlantParameters(
    nutation_per_cm_h=0.0, wander_per_cm_h=0.0, growth_noise=0.0, growth_rhythm=0.0, leaf_azimuth_rad=0.0
)


def steps(hours: float) -> int:
    return round(hours * 3600 / STEP_S)


def test_plants_grow_from_a_seedling_to_about_21_cm_in_72_h_slowly_first_and_fast_later() -> None:
    tracks = grow_many(range(16), "6h", 72)
    tips = np.array([track.points_cm[:, -1, 1] for track in tracks])
    assert tips[:, 0] == pytest.approx(6.5, rel=0.15)
    # The last two hours hold more than one turn of circumnutation.
    final = tips[:, -24:].mean(axis=1)
    assert final.mean() == pytest.approx(21.0, abs=1.5)
    assert np.all((final > 15.0) & (final < 27.0))
    assert final.std() > 0.7
    gained = tips.mean(axis=0)
    early, late = gained[12 * 24] - gained[0], gained[-1] - gained[-12 * 24]
    assert late > 1.3 * early


def test_growth_late_is_about_seven_cm_a_day() -> None:
    plants = Plants([1], [CALM])
    for _ in range(steps(72)):
        plants.step(0.0, 0.0)
    assert plants.growth_cm_per_day()[0] == pytest.approx(7.4, abs=0.6)


@pytest.mark.parametrize(("left", "right", "sign"), [(1.0, 0.0, -1.0), (0.0, 1.0, 1.0)])
def test_each_plant_bends_to_the_lamp_that_is_lit(left: float, right: float, sign: float) -> None:
    plants = Plants(range(8))
    for _ in range(steps(8)):
        plants.step(left, right)
    assert np.all(sign * plants.tip_cm()[:, 0] > 1.0)


def test_left_and_right_mirror_each_other_without_noise_and_in_the_mean_with_it() -> None:
    calm = Plants([1, 1], [CALM, CALM])
    noisy = Plants([*range(24), *range(24)])
    right = np.repeat([0.0, 1.0], 24)
    for _ in range(steps(12)):
        calm.step([1.0, 0.0], [0.0, 1.0])
        noisy.step(1.0 - right, right)
    x = calm.tip_cm()[:, 0]
    assert x[0] == pytest.approx(-x[1], abs=1e-12)
    tips = noisy.tip_cm()[:, 0]
    assert tips[:24].mean() == pytest.approx(-tips[24:].mean(), abs=0.4)


def test_the_swing_of_the_paper_and_the_curve_that_stays() -> None:
    """Wahby et al. 2018, section on reality: 7.4 cm right at 15.4 cm after 37 h, in the middle in under 2 h."""
    plants = Plants([5], [CALM.with_values(initial_length_cm=9.5)])
    for _ in range(steps(37)):
        plants.step(0.0, 1.0)
    x, y, _ = plants.tip_cm()[0]
    assert x == pytest.approx(7.4, abs=1.2)
    assert y == pytest.approx(15.4, abs=1.2)
    base_before = at_height(plants, 4.0)
    needed = 0
    while plants.tip_cm()[0, 0] > 0.8:
        plants.step(1.0, 0.0)
        needed += 1
        assert needed < steps(3), "the tip did not come back to the middle within 3 h"
    assert needed > steps(0.4)
    assert at_height(plants, 4.0) == pytest.approx(base_before, abs=0.25)
    for _ in range(steps(30)):
        plants.step(1.0, 0.0)
    assert plants.tip_cm()[0, 0] < -2.0
    assert at_height(plants, 4.0) > 0.75 * base_before > 0.3


def test_mature_stem_keeps_its_shape_to_rounding() -> None:
    plants = Plants([2], [CALM.with_values(initial_length_cm=40.0, initial_lean_rad=0.3)])
    before = plants.centreline_cm()[0, :50].copy()
    for _ in range(steps(12)):
        plants.step(0.0, 1.0)
    assert np.abs(plants.centreline_cm()[0, :50] - before).max() < 1e-6


def test_circumnutation_has_the_period_that_the_plant_was_given() -> None:
    for seed in (1, 4):
        individual = draw_individual(seed)
        track = grow(seed, "both", 72)
        x = track.points_cm[-480:, -1, 0]
        x = x - np.convolve(np.pad(x, 20, mode="edge"), np.ones(41) / 41, mode="valid")
        spectrum = np.abs(np.fft.rfft(x * np.hanning(len(x)), 16 * len(x))) ** 2
        period_min = 5.0 / np.fft.rfftfreq(16 * len(x))[1:][np.argmax(spectrum[1:])]
        assert period_min == pytest.approx(individual.nutation_period_min, rel=0.06)


def test_circumnutation_is_small_in_seedlings_and_turns_anticlockwise_seen_from_above() -> None:
    plants = Plants([3], [CALM.with_values(nutation_per_cm_h=0.15)])
    tips = []
    for _ in range(steps(72)):
        plants.step(0.0, 0.0)
        tips.append(plants.tip_cm()[0])
    tip = np.array(tips)
    early, late = np.ptp(tip[: steps(6), 0]) / 2, np.ptp(tip[-steps(3) :, 0]) / 2
    assert early < 0.25
    assert 0.4 < late < 2.0
    x, z = tip[-steps(6) :, 0], tip[-steps(6) :, 2]
    x, z = x - x.mean(), z - z.mean()
    # Seen from above with x to the right, z points down the page: anticlockwise is from +x towards -z.
    assert (x[:-1] * z[1:] - z[:-1] * x[1:]).mean() < 0


def test_cycles_differ_by_the_measured_jitter() -> None:
    plants = Plants([7], [PlantParameters()])
    draws = []
    for cycle in range(400):
        plants._cycle[0] = cycle
        plants._start_cycle(0)
        draws.append(float(plants._stretch[0]))
    assert np.std(draws) == pytest.approx(0.045, rel=0.15)


def test_light_takes_time_to_act() -> None:
    plants = Plants([1], [CALM])
    for _ in range(3):
        plants.step(1.0, 0.0)
    soon = -plants.tip_cm()[0, 0]
    for _ in range(steps(1)):
        plants.step(1.0, 0.0)
    assert 0.0 <= soon < 0.03 * -plants.tip_cm()[0, 0]


def test_a_plant_alone_and_in_a_batch_give_the_same_numbers() -> None:
    seeds = [3, 11, 40]
    together = Plants(seeds)
    alone = [Plants([seed]) for seed in seeds]
    for k in range(steps(30)):
        light = (1.0, 0.0) if k % 200 < 100 else (0.0, 1.0)
        together.step(*light)
        for plant in alone:
            plant.step(*light)
    for i, plant in enumerate(alone):
        assert np.array_equal(together.line_cm(i), plant.line_cm(0))
        assert np.array_equal(together.leaf_nodes_cm[i], plant.leaf_nodes_cm[0])


def test_a_restored_plant_goes_on_byte_for_byte_over_splits_and_noise_blocks() -> None:
    straight = Plants([9, 10])
    for k in range(700):
        straight.step(1.0, 0.2 * (k % 3))
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **straight.state())  # type: ignore[arg-type]
    file.seek(0)
    with np.load(file) as archive:
        resumed = Plants.from_state({name: archive[name] for name in archive.files})
    for _ in range(700):
        straight.step(0.0, 1.0)
        resumed.step(0.0, 1.0)
    for name, values in straight.state().items():
        assert values.tobytes() == resumed.state()[name].tobytes(), name


def test_segments_stay_short_and_tangents_unit_and_leaf_nodes_are_carried_along() -> None:
    plants = Plants(range(5))
    nodes = plants.leaf_nodes_cm
    for k in range(steps(80)):
        plants.step(*((1.0, 0.0) if k % 500 < 250 else (0.0, 1.0)))
        assert np.all(np.diff(plants.leaf_nodes_cm[0]) > 0)
    steps_cm = np.linalg.norm(np.diff(plants.centreline_cm(), axis=1), axis=2)
    assert steps_cm.max() <= LONG_SEGMENT_CM + 1e-9
    assert steps_cm.sum(axis=1) == pytest.approx(plants.length_cm)
    assert np.all(plants.leaf_nodes_cm > nodes)
    assert np.all(plants.leaf_nodes_cm[:, 1] < plants.length_cm)


def test_half_the_step_gives_the_same_plant() -> None:
    coarse, fine = Plants([1], [CALM]), Plants([1], [CALM])
    for k in range(steps(48)):
        light = (1.0, 0.0) if k % 216 < 108 else (0.0, 1.0)
        coarse.step(*light, STEP_S)
        fine.step(*light, STEP_S / 2)
        fine.step(*light, STEP_S / 2)
    assert np.abs(coarse.tip_cm() - fine.tip_cm()).max() < 0.15


def test_no_two_plants_are_alike_and_rates_spread_as_stated() -> None:
    drawn = np.stack([draw_individual(seed).as_array() for seed in range(400)])
    assert len(np.unique(drawn, axis=0)) == 400
    mean = PlantParameters().as_array()
    for name, spread in SPREAD.items():
        ratio = np.log(drawn[:, NAMES.index(name)] / mean[NAMES.index(name)])
        assert ratio.mean() == pytest.approx(0.0, abs=4 * spread / 20)
        assert ratio.std() == pytest.approx(spread, rel=0.2)
    period = drawn[:, NAMES.index("nutation_period_min")]
    assert period.mean() == pytest.approx(98.6, abs=2.0)
    assert period.std() == pytest.approx(12.8, rel=0.15)
    assert draw_individual(5) == draw_individual(5)


def test_track_has_the_form_of_measured_runs() -> None:
    track = grow(2, "right 2h, left", 5, every_s=300.0)
    assert len(track.time_s) == 61
    assert np.all(track.points_cm[:, 0] == 0.0)
    assert track.light[0] == "right"
    assert track.light[24] == "right"
    assert track.light[25] == "left"
    assert np.isfinite(track.points_cm).all()


@pytest.mark.parametrize("text", ["", "6", "0h", "lefft 2h, right", "left, right", "left -1h, right", "6h,"])
def test_schedules_that_cannot_be_read_are_told_in_one_line(text: str) -> None:
    with pytest.raises(BadInput, match="schedule"):
        parse_schedule(text)


def test_parameters_that_do_not_exist_are_told() -> None:
    with pytest.raises(BadInput, match="did you mean `stiffening_cm`"):
        PlantParameters().with_values(stifening_cm=4.0)
    with pytest.raises(BadInput, match="finite"):
        PlantParameters().with_values(stiffening_cm=float("nan"))


def at_height(plants: Plants, y_cm: float) -> float:
    line = plants.line_cm(0)
    return float(np.interp(y_cm, line[:, 1], line[:, 0]))
