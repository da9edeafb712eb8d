"""The path method's numerical tools: thinning, smoothing splines, the belief on a stem's length."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from flora_common.vision.path import length, spline
from flora_common.vision.path.length import LengthState
from flora_common.vision.path.survey import median
from flora_common.vision.path.thinning import neighbour_offsets, thin


def neighbours(skeleton: np.ndarray) -> np.ndarray:
    """For each set pixel, how many of its eight neighbours are set; 0 elsewhere."""
    padded = np.pad(skeleton, 1).ravel()
    at = np.flatnonzero(padded)
    out = np.zeros(padded.size, int)
    out[at] = padded[at[:, None] + neighbour_offsets(skeleton.shape[1] + 2)[None, :]].sum(axis=1)
    return out.reshape(skeleton.shape[0] + 2, -1)[1:-1, 1:-1]


@pytest.mark.parametrize("seed", range(6))
def test_thinning_keeps_what_hangs_together_and_leaves_lines_of_one_pixel(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mask = np.zeros((120, 160), np.uint8)
    for _ in range(6):
        ends = rng.integers(10, 110, (2, 2)).tolist()
        cv2.line(mask, ends[0], ends[1], 1, int(rng.integers(1, 12)))
    skeleton = thin(mask)
    assert not (skeleton & (1 - mask)).any()
    assert cv2.connectedComponents(skeleton)[0] == cv2.connectedComponents(mask)[0]
    whole = skeleton[:-1, :-1] & skeleton[1:, :-1] & skeleton[:-1, 1:] & skeleton[1:, 1:]
    assert not whole.any()
    assert skeleton.sum() < 0.6 * mask.sum()


@pytest.mark.xfail(strict=True, reason="the published rules take a diagonal that is two pixels thick away as a whole")
def test_a_diagonal_of_an_even_number_of_pixels_is_not_lost() -> None:
    y, x = np.mgrid[0:120, 0:120]
    mask = ((np.abs(x - y) <= 3) & (x > 10) & (x < 110) & (y > 10) & (y < 110)).astype(np.uint8)
    mask |= np.roll(mask, 1, axis=1)
    assert thin(mask).sum() > 80


def test_thinning_of_a_cross_has_one_branching_in_its_middle_and_four_ends() -> None:
    mask = np.zeros((81, 81), np.uint8)
    mask[37:44, 5:76] = 1
    mask[5:76, 37:44] = 1
    count = neighbours(thin(mask))
    rows, columns = np.nonzero(count > 2)
    assert np.abs(np.stack([rows, columns]) - 40).max() <= 2
    assert (count == 1).sum() == 4


def test_a_thinned_bar_runs_along_its_middle_up_to_half_a_width_from_its_ends() -> None:
    mask = np.zeros((40, 100), np.uint8)
    mask[15:24, 10:90] = 1
    rows, columns = np.nonzero(thin(mask))
    assert np.abs(rows[5:-5] - 19).max() <= 1
    assert columns.min() <= 10 + 6
    assert columns.max() >= 89 - 6


def test_a_spline_is_exact_on_a_cubic_when_roughness_is_free() -> None:
    s = np.linspace(0.0, 100.0, 60)
    u = s / 100.0
    places = np.column_stack([3 * u**3 - 2 * u + 1, -4 * u**3 + u**2])
    smoother = spline.Smoother(s, knot_step=20.0, roughness=1e3)
    found = smoother.fit(places, np.full(60, 1e4))
    assert smoother.places(found) == pytest.approx(places, abs=1e-4)


def test_a_smooth_spline_crosses_a_gap_in_a_parabola_and_says_how_unsure_it_is() -> None:
    s = np.linspace(0.0, 100.0, 101)
    u = s / 100.0
    truth = np.column_stack([10 * u * (1 - u), 100 * u])
    weights = np.where((s > 40) & (s < 70), 0.0, 4.0)
    smoother = spline.Smoother(s, knot_step=10.0, roughness=0.1)
    found = smoother.fit(truth, weights)
    assert np.abs(smoother.places(found) - truth).max() < 0.05
    deviation = smoother.deviation(found)
    assert deviation[55] > 1.4 * deviation[30]
    assert deviation[(s > 42) & (s < 68)].min() > deviation[(s > 10) & (s < 30)].max()


def test_the_deviation_of_a_spline_agrees_with_random_trials() -> None:
    rng = np.random.default_rng(3)
    s = np.linspace(0.0, 60.0, 80)
    truth = np.column_stack([0.1 * s, s])
    weights = np.full(80, 1.0 / 0.5**2)
    smoother = spline.Smoother(s, knot_step=12.0, roughness=1e3)
    fits = [smoother.fit(truth + rng.normal(0.0, 0.5, truth.shape), weights) for _ in range(400)]
    at = [0, 22, 40, 79]
    spread = np.stack([smoother.places(f)[at, 0] for f in fits]).std(axis=0)
    assert smoother.deviation(fits[0])[at] == pytest.approx(spread, rel=0.15)


def test_the_basis_sums_to_one_everywhere() -> None:
    assert spline.basis(np.linspace(0.0, 50.0, 77), 10.0, 8).sum(axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize("count", [1, 6, 7])
def test_the_median_by_sorting_is_that_of_numpy(count: int) -> None:
    whole = np.random.default_rng(count).integers(-90, 90, (4, 5, count)).astype(np.int16)
    assert median(whole).tobytes() == np.median(whole, axis=-1).tobytes()
    assert median(whole[0, 0].astype(np.float32)) == pytest.approx(np.median(whole[0, 0]))


def test_length_converges_to_a_steady_growth_and_its_rate() -> None:
    rng = np.random.default_rng(1)
    state = None
    for i in range(289):
        hours = i / 12.0
        state = length.measured(state, 300.0 * i, 5.0 + 0.3 * hours + rng.normal(0, 0.02), 0.02, hidden=False)
    assert state is not None
    assert state.length_cm == pytest.approx(5.0 + 0.3 * 24.0, abs=0.04)
    assert state.rate_cm_per_h == pytest.approx(0.3, abs=0.12)
    assert state.length_var < 0.02**2


def test_a_hidden_tip_is_a_lower_bound() -> None:
    known = LengthState(0.0, 10.0, rate_cm_per_h=0.2, length_var=1e-4)
    shorter = length.measured(known, 3600.0, 6.0, 0.05, hidden=True)
    assert shorter == length.predicted(known, 3600.0)
    assert shorter.length_cm == pytest.approx(10.2)
    seen = length.measured(known, 3600.0, 9.95, 0.05, hidden=False)
    assert 9.9 < seen.length_cm < 10.05
    longer = length.measured(known, 3600.0, 10.5, 0.05, hidden=True)
    assert longer.length_cm == pytest.approx(10.5, abs=0.06)


@pytest.mark.parametrize(("read_cm", "believed_after"), [(12.0, 3), (8.0, 8)])
def test_a_length_that_is_read_again_and_again_is_believed_a_longer_one_sooner(
    read_cm: float, believed_after: int
) -> None:
    state = LengthState(0.0, 10.0, rate_cm_per_h=0.2, length_var=1e-4)
    for i in range(1, believed_after):
        state = length.measured(state, 300.0 * i, read_cm, 0.02, hidden=False)
        assert state.length_cm == pytest.approx(10.0, abs=0.4)
    state = length.measured(state, 300.0 * believed_after, read_cm, 0.02, hidden=False)
    assert state.length_cm == read_cm


def test_a_misread_length_hardly_changes_the_belief() -> None:
    known = LengthState(0.0, 10.0, rate_cm_per_h=0.2, length_var=1e-4)
    for wrong in (4.0, 18.0):
        after = length.measured(known, 3600.0, wrong, 0.05, hidden=False)
        assert after.length_cm == pytest.approx(10.2, abs=0.1)


def test_a_belief_grows_older_with_time_and_never_backwards() -> None:
    known = LengthState(1000.0, 10.0, rate_cm_per_h=0.2, length_var=1e-4)
    assert length.predicted(known, 1000.0) == known
    assert length.predicted(known, 0.0) == known
    later = [length.predicted(known, 1000.0 + 3600.0 * h) for h in (1, 2, 4)]
    assert [round(s.length_cm, 6) for s in later] == [10.2, 10.4, 10.8]
    assert known.length_var < later[0].length_var < later[1].length_var < later[2].length_var
