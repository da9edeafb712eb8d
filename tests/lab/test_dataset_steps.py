"""``flora-lab dataset``: every step on a few stems, with values worked out by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flora_common.arrays import FloatArray
from flora_common.tracks import Track
from flora_lab.dataset.generic import roughness, smoothest, translated, translations, windows
from flora_lab.dataset.loading import measured
from flora_lab.dataset.noise import extents_ratio, local_statistics, noisy_points, noisy_sequences
from flora_lab.dataset.pairs import change, changed, mirrored, no_jump, paired
from flora_lab.dataset.recipe import GenericSettings, NoiseSettings, SparseSettings
from flora_lab.dataset.sparse import in_dense_areas
from flora_lab.dataset.stems import LEFT, RIGHT, Stems, joined
from flora_lab.run_tracks import RunTrack


def stems_with_tips(
    tips: list[tuple[float, float]],
    *,
    run: list[int] | None = None,
    light: list[int] | None = None,
    row: list[int] | None = None,
) -> Stems:
    """Straight stems from the anchor to these tips: point i of 2..10 at (i - 1) / 9 of the way."""
    count = len(tips)
    runs = np.array(run or [0] * count, dtype=np.int32)
    return Stems(
        np.array(tips, dtype=np.float64).reshape(-1, 1, 2) * (np.arange(1, 10) / 9.0)[None, :, None],
        np.array(light or [LEFT] * count, dtype=np.int32),
        runs,
        np.array(row if row is not None else range(count), dtype=np.int32),
        runs.copy(),
        np.zeros(count, dtype=np.int32),
        np.zeros(count, dtype=np.bool_),
    )


# Removal of sparse areas


def test_an_area_is_dense_with_enough_runs_and_enough_tips() -> None:
    tips = [(0.5, 0.5), (1.5, 1.5), (0.1, 1.9), (2.5, 0.5), (2.6, 0.5), (2.7, 0.5), (-0.1, 0.5), (-0.2, 0.5)]
    run = [0, 1, 1, 0, 0, 0, 0, 1]
    stems = stems_with_tips(tips, run=run)
    # Squares of 2 cm: the first three tips share one with both runs; three of one run are in the next; two across zero.
    kept = in_dense_areas(stems, SparseSettings(cell_cm=2.0, min_runs=2, min_tips=3))
    assert kept.tolist() == [True, True, True, False, False, False, False, False]
    fewer = in_dense_areas(stems, SparseSettings(cell_cm=2.0, min_runs=2, min_tips=2))
    assert fewer.tolist() == [True, True, True, False, False, False, True, True]
    one_run = in_dense_areas(stems, SparseSettings(cell_cm=2.0, min_runs=1, min_tips=3))
    assert one_run.tolist() == [True] * 6 + [False] * 2


def test_a_single_run_is_not_asked_for_a_second_one() -> None:
    stems = stems_with_tips([(0.5, 0.5), (0.6, 0.5), (9.0, 9.0)])
    assert in_dense_areas(stems, SparseSettings(min_runs=2, min_tips=2)).tolist() == [True, True, False]


# Noise


def test_eq_9_to_11_mean_and_deviation_of_the_nearest_other_tips() -> None:
    tips = np.array([(0.0, 0.0), (1.0, 0.0), (3.0, 4.0), (100.0, 0.0)])
    mean, deviation = local_statistics(tips, np.zeros(4, dtype=np.int32), 2)
    # The two nearest others of the first are (1, 0) and (3, 4): mean (2, 2), deviation (1, 2).
    assert mean[0].tolist() == [2.0, 2.0]
    assert deviation[0].tolist() == [1.0, 2.0]
    # of the third: (1, 0) and (0, 0)
    assert mean[2].tolist() == [0.5, 0.0]
    assert deviation[2].tolist() == [0.5, 0.0]


def test_eq_9_looks_at_tips_under_the_same_light_only() -> None:
    tips = np.array([(0.0, 0.0), (0.1, 0.0), (5.0, 2.0), (7.0, 7.0)])
    mean, deviation = local_statistics(tips, np.array([LEFT, RIGHT, LEFT, RIGHT], dtype=np.int32), 100)
    assert mean.tolist() == [[5.0, 2.0], [7.0, 7.0], [0.0, 0.0], [0.1, 0.0]]
    assert deviation.tolist() == [[0.0, 0.0]] * 4


def test_eq_9_of_equally_far_tips_the_earlier_ones_count() -> None:
    tips = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)])
    mean, _ = local_statistics(tips, np.zeros(5, dtype=np.int32), 2)
    assert mean[0].tolist() == [0.5, 0.5]
    assert mean[4].tolist() == [0.5, 0.0]  # the first is nearest; the second and fourth are equally far


def test_eq_9_a_tip_alone_under_its_light_has_no_noise() -> None:
    mean, deviation = local_statistics(np.array([(3.0, 4.0), (0.0, 1.0)]), np.array([LEFT, RIGHT], dtype=np.int32), 100)
    assert mean.tolist() == [[3.0, 4.0], [0.0, 1.0]]
    assert (deviation == 0.0).all()


def test_eq_9_blocks_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    tips = np.random.default_rng(0).normal(size=(57, 2))
    light = np.arange(57, dtype=np.int32) % 2
    whole = local_statistics(tips, light, 7)
    monkeypatch.setattr("flora_lab.dataset.noise._BLOCK_CELLS", 100)
    pieces = local_statistics(tips, light, 7)
    assert np.array_equal(whole[0], pieces[0])
    assert np.array_equal(whole[1], pieces[1])


def test_eq_15_extents_relative_to_the_tips() -> None:
    points = stems_with_tips([(0.0, 2.0), (9.0, 20.0)]).points_cm
    ratio = extents_ratio(points)
    assert ratio[:, 0] == pytest.approx(np.arange(1, 10) / 9)
    points[1, 3] = (-2.0, 10.0)
    ratio = extents_ratio(points)
    assert ratio[3, 0] == pytest.approx(2.0 / 9.0)
    assert ratio[3, 1] == pytest.approx((10.0 - 8.0 / 9.0) / 18.0)
    assert ratio[8].tolist() == [1.0, 1.0]


def test_eq_15_where_the_tip_has_no_extent() -> None:
    assert extents_ratio(stems_with_tips([(0.0, 2.0), (0.0, 20.0)]).points_cm)[:, 0].tolist() == [0.0] * 9


@pytest.mark.parametrize(
    ("mean", "tip", "middle"),
    [
        # x: tip 9, mu 10, sigma 2, draw 1; omega 0.1, omega_2 0.5 in the middle, where x is 4 and the draw -1.
        # offset: tip + 0.1 (10 - 9) + 0.1 * 2 * 1; middle + 0.5 (tip' - tip) - 0.1 * (0.1 * 2 * 0.5)
        ("offset", 9.3, 4.0 + 0.15 - 0.01),
        ("zero", 9.2, 4.0 + 0.1 - 0.01),
        # as printed: tip + 10 + 0.2; middle + (middle + 0.5 * 10.2) - 0.01
        ("printed", 19.2, 4.0 + 4.0 + 5.1 - 0.01),
    ],
)
def test_eq_12_to_16_by_hand(mean: str, tip: float, middle: float) -> None:
    points = np.zeros((1, 9, 2))
    points[0, 8], points[0, 3] = (9.0, 9.0), (4.0, 4.0)
    omega_2 = np.zeros((9, 2))
    omega_2[8], omega_2[3] = 1.0, 0.5
    draws = np.zeros((1, 9, 2))
    draws[0, 8], draws[0, 3] = (1.0, 0.0), (-1.0, 0.0)
    out = noisy_points(
        points,
        np.array([[10.0, 9.0]]),
        np.array([[2.0, 2.0]]),
        omega_2,
        draws,
        omega=0.1,
        mean=mean,  # type: ignore[arg-type]
    )
    assert out[0, 8, 0] == pytest.approx(tip)
    assert out[0, 3, 0] == pytest.approx(middle)
    if mean != "printed":  # in y the mean is the tip itself and the draws are 0: nothing moves
        assert out[0, :, 1].tolist() == points[0, :, 1].tolist()


def test_noisy_sequences_have_the_deviation_that_omega_gives_them() -> None:
    draw = np.random.default_rng(5)
    stems = stems_with_tips([(x, 10.0 + y) for x, y in draw.normal(size=(2000, 2))])
    made = noisy_sequences(stems, NoiseSettings(theta_3=1999, omega=0.1, mean="zero"), seed=3)
    assert [int(part.sequence[0]) for part in made] == [1, 2, 3]
    for part in made:
        moved = part.tips_cm - stems.tips_cm
        assert moved.mean(axis=0) == pytest.approx([0.0, 0.0], abs=0.01)
        assert moved.std(axis=0) == pytest.approx(0.1 * stems.tips_cm.std(axis=0), rel=0.05)
        assert part.light.tolist() == stems.light.tolist()
    assert not np.allclose(made[0].points_cm, made[1].points_cm)


def test_more_noisy_sequences_leave_the_first_ones_as_they_are_and_another_seed_does_not() -> None:
    stems = stems_with_tips([(0.0, 5.0), (1.0, 6.0), (0.5, 7.0)])
    one = noisy_sequences(stems, NoiseSettings(sequences=1), seed=1)
    two = noisy_sequences(stems, NoiseSettings(sequences=2), seed=1)
    other = noisy_sequences(stems, NoiseSettings(sequences=1), seed=2)
    assert np.array_equal(one[0].points_cm, two[0].points_cm)
    assert not np.array_equal(one[0].points_cm, other[0].points_cm)


# The generic model


def test_eq_17_gives_the_papers_64_translations() -> None:
    shifts = translations((-3, -4, -5, -6), 1.0)
    assert shifts.shape == (64, 2)
    assert len(np.unique(shifts, axis=0)) == 64
    assert sorted(np.unique(np.abs(shifts)).tolist()) == pytest.approx([1e-6, 1e-5, 1e-4, 1e-3])
    assert np.allclose(shifts.sum(axis=0), 0.0)
    assert np.array_equal(translations((-3,), 65.0), 0.065 * np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)]))


def test_eq_17_moves_every_point_by_the_same() -> None:
    stems = stems_with_tips([(1.0, 5.0), (2.0, 6.0), (3.0, 7.0)])
    first, second = translated(stems, np.array([False, True, True]), np.array([(0.5, -0.25), (0.0, 1.0)]), 4)
    assert (first.points_cm - stems.points_cm[1:]).reshape(-1, 2) == pytest.approx(np.tile((0.5, -0.25), (18, 1)))
    assert first.sequence.tolist() == [4, 4]
    assert second.sequence.tolist() == [5, 5]
    assert second.row.tolist() == [1, 2]


def test_windows_are_unbroken_and_under_one_light() -> None:
    light = [LEFT, LEFT, LEFT, RIGHT, RIGHT, RIGHT, RIGHT, LEFT, LEFT, LEFT]
    row = [0, 1, 2, 3, 4, 5, 6, 7, 9, 10]
    stems = stems_with_tips([(0.0, 5.0)] * 10, light=light, row=row)
    # 0-2 left; 3-5 right; 6 is right alone; 7 is left alone, then a gap; 8 and 9 are too few.
    assert windows(stems, 3).tolist() == [0, 3]
    assert windows(stems, 2).tolist() == [0, 3, 5, 8]


def test_roughness_is_nothing_for_a_steady_movement_and_two_for_one_to_and_fro() -> None:
    steady = [(0.0, 5.0), (1.0, 5.0), (2.0, 5.0), (3.0, 5.0)]
    to_and_fro = [(0.0, 5.0), (1.0, 5.0), (0.0, 5.0), (1.0, 5.0)]
    still = [(0.0, 5.0)] * 4
    points = np.stack([stems_with_tips(tips).points_cm for tips in (steady, to_and_fro, still)])
    rough, way = roughness(points)
    # Each step is 1 cm at the tip and i/9 of it at point i: length sqrt(sum of (i/9)^2) = sqrt(285)/9.
    assert way == pytest.approx([3 * np.sqrt(285) / 9, 3 * np.sqrt(285) / 9, 0.0])
    # to and fro: two changes of twice the velocity over three velocities
    assert rough == pytest.approx([0.0, 4.0 / 3.0, np.inf])


def test_the_smoothest_movements_are_chosen_and_rest_is_none() -> None:
    still = [(0.0, 5.0), (0.001, 5.0), (0.002, 5.0), (0.003, 5.0)]
    smooth = [(0.0, 5.0), (1.0, 5.0), (2.0, 5.0), (3.0, 5.0)]
    rough = [(0.0, 5.0), (2.0, 5.0), (0.0, 5.0), (2.0, 5.0)]
    tips = still + rough + smooth
    stems = stems_with_tips(tips, run=[0] * 4 + [1] * 4 + [2] * 4)
    one = smoothest(stems, GenericSettings(share=0.01, window_h=1.0), 900.0)
    assert one.tolist() == [False] * 8 + [True] * 4
    two = smoothest(stems, GenericSettings(share=0.67, window_h=1.0), 900.0)
    assert two.tolist() == [False] * 4 + [True] * 8
    # the one at rest goes less far than the median and is never taken
    assert smoothest(stems, GenericSettings(share=1.0, window_h=1.0), 900.0).tolist() == two.tolist()
    assert not smoothest(stems, GenericSettings(window_h=5.0), 900.0).any()


# Mirroring, pairs, and what is removed


def test_mirroring_exchanges_left_and_right_and_the_lamps() -> None:
    stems = stems_with_tips([(9.0, 18.0)], light=[RIGHT])
    other = mirrored(stems)
    assert other.tips_cm.tolist() == [[-9.0, 18.0]]
    assert other.light.tolist() == [LEFT]
    assert other.mirrored.tolist() == [True]


def test_pairs_hold_the_stem_its_light_and_the_next_stem_in_units() -> None:
    stems = stems_with_tips([(0.0, 9.0), (9.0, 18.0), (18.0, 27.0)], light=[RIGHT, LEFT, LEFT])
    pairs = paired(stems, unit_cm=10.0)
    assert len(pairs) == 2
    assert pairs.inputs.dtype == pairs.outputs.dtype == np.float32
    assert pairs.inputs[0] == pytest.approx([v for i in range(1, 10) for v in (0.0, 0.1 * i)] + [1.0])
    assert pairs.outputs[0] == pytest.approx([v for i in range(1, 10) for v in (0.1 * i, 0.2 * i)])
    assert np.array_equal(pairs.inputs[1, :18], pairs.outputs[0])
    assert pairs.inputs[:, 18].tolist() == [1.0, 0.0]
    assert pairs.row.tolist() == [0, 1]


def test_pairs_never_cross_runs_gaps_sequences_or_the_mirror() -> None:
    stems = stems_with_tips([(0.0, float(i)) for i in range(1, 7)], run=[0, 0, 1, 1, 1, 1], row=[0, 1, 2, 3, 5, 6])
    assert paired(stems, 1.0).row.tolist() == [0, 2, 5]
    part = stems_with_tips([(0.0, 1.0), (0.0, 2.0)])
    later = stems_with_tips([(0.0, 3.0), (0.0, 4.0)], row=[2, 3])
    assert paired(joined([part, later]), 1.0).row.tolist() == [0, 1, 2]
    assert paired(joined([part, later.copy_as(1, later.points_cm)]), 1.0).row.tolist() == [0, 2]
    assert paired(joined([part, mirrored(later)]), 1.0).row.tolist() == [0, 2]


def test_the_end_of_one_run_is_not_paired_with_the_middle_of_the_next() -> None:
    """Only rows 0 of the first and 1 of the second are left: neighbours by number, not by plant."""
    track = Track(np.array([0.0, 300.0]), ("left", "left"), stems_of_a_track(), {})
    runs = [RunTrack(name, name, Path(name), name, track) for name in ("a", "b")]
    stems = measured(runs, 300.0)
    assert paired(stems, 1.0).run.tolist() == [0, 1]
    assert len(paired(stems.take(np.array([True, False, False, True])), 1.0)) == 0


def stems_of_a_track() -> FloatArray:
    return np.stack([np.outer(np.arange(10) / 9.0, tip) for tip in ((0.0, 8.0), (0.1, 8.1))])


def test_duplicates_are_pairs_of_two_equal_stems() -> None:
    stems = stems_with_tips([(0.0, 9.0), (0.0, 9.0), (0.0, 9.1), (0.0, 9.1)])
    pairs = paired(stems, 1.0)
    assert changed(pairs).tolist() == [False, True, False]
    assert changed(pairs, tolerance=0.11).tolist() == [False, False, False]
    assert changed(pairs, tolerance=0.09).tolist() == [False, True, False]


def test_jumps_are_changes_of_more_than_20_times_the_mean() -> None:
    # Tips move 1 cm in each of 38 steps, then once by 22 or 50 cm. The stem moves by 5/9 of its tip in the mean.
    steady = [(float(i), 5.0) for i in range(39)]
    for jump, mean_tip in ((22.0, 60.0 / 39.0), (50.0, 88.0 / 39.0)):
        pairs = paired(stems_with_tips([*steady, (38.0 + jump, 5.0)]), 1.0)
        assert change(pairs).mean() == pytest.approx(5.0 / 9.0 * mean_tip, rel=1e-6)
        far = jump > 20.0 * mean_tip
        assert far == (jump == 50.0)
        assert no_jump(pairs, 20.0).tolist() == [True] * 38 + [not far]
