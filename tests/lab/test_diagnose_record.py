"""Records are looked over before anything is compared: stems that no plant can have left, frozen pictures, gaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose_runs import STEP_S, change_of, run_of, turns
from hypothesis import given, settings
from hypothesis import strategies as st

from flora_lab.diagnose.record import GAP_H, cleaned, without
from flora_lab.simulator.measured import MeasuredRun


def moved(run: MeasuredRun, rows: list[int], by_cm: tuple[float, float]) -> MeasuredRun:
    points = run.points_cm.copy()
    points[rows, 1:] += np.array(by_cm)
    return replace(run, points_cm=points)


def frozen(run: MeasuredRun, first: int, hours: float) -> MeasuredRun:
    points = run.points_cm.copy()
    rows = round(hours * 3600.0 / STEP_S)
    points[first : first + rows + 1] = points[first]
    return replace(run, points_cm=points)


def hidden(before: MeasuredRun, after: MeasuredRun) -> list[int]:
    return np.flatnonzero(before.is_measured & ~after.is_measured).tolist()


@pytest.mark.parametrize(
    ("by_cm", "row"), [((1.5, 0.0), 100), ((-4.0, -6.0), 37), ((0.0, -3.0), 200), ((0.0, 30.0), 9)]
)
def test_a_stem_that_was_found_wrongly_is_left_out_and_told(by_cm: tuple[float, float], row: int) -> None:
    wrong = moved(run_of(1), [row], by_cm)
    clean, notes = cleaned(wrong)
    assert hidden(wrong, clean) == [row]
    (note,) = notes
    assert note.startswith("plant1: 1 stem lay far from")
    assert "left out" in note
    rest = np.arange(len(wrong)) != row
    assert clean.points_cm[rest].tobytes() == wrong.points_cm[rest].tobytes()


@pytest.mark.parametrize("seed", [0, 1, 3, 5])
def test_a_turn_to_the_light_that_is_photographed_seldom_is_no_wrong_stem(seed: int) -> None:
    """The tip is farther from those about it the longer ago these were."""
    turning = run_of(seed, hours=48.0, step_s=1800.0)
    assert cleaned(turning) == (turning, [])
    wrong = moved(turning, [48], (0.0, 50.0))
    assert hidden(wrong, cleaned(wrong)[0]) == [48]


def test_several_of_them_are_counted() -> None:
    wrong = moved(run_of(1), [40, 41, 90, 250], (2.0, -1.0))
    clean, notes = cleaned(wrong)
    assert hidden(wrong, clean) == [40, 41, 90, 250]
    assert notes[0].startswith("plant1: 4 stems lay")


def test_a_camera_that_hangs_is_told_with_its_hours() -> None:
    stuck = frozen(run_of(2), 60, 5.0)
    clean, notes = cleaned(stuck)
    assert hidden(stuck, clean) == list(range(61, 121))  # the first of them was seen
    (note,) = notes
    assert "for 5.0 h the very same stem" in note


def test_a_stem_that_is_the_same_for_a_while_is_left_alone() -> None:
    short = frozen(run_of(2), 60, 1.0)
    clean, notes = cleaned(short)
    assert clean is short
    assert notes == []


@pytest.mark.parametrize(("rows", "is_told"), [(5, False), (7, True), (36, True)])
def test_gaps_are_told_when_they_are_long(rows: int, is_told: bool) -> None:
    gap = np.zeros(289, dtype=np.bool_)
    gap[100 : 100 + rows] = True
    run = without(run_of(3), gap)
    clean, notes = cleaned(run)
    assert clean is run
    assert bool(notes) == is_told == (rows * STEP_S / 3600.0 > GAP_H)
    if is_told:
        assert f"no stem for {rows * STEP_S / 3600.0:.1f} h at a time" in notes[0]
        assert f"{100.0 * rows / 289:.1f} % of all are missing" in notes[0]


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.5, 1.0))
def test_healthy_plants_are_not_cut_however_fast(seed: int, slower: float) -> None:
    run = run_of(seed, change=change_of({"time_scale": {"factor": slower}}))
    clean, notes = cleaned(run)
    assert clean is run
    assert notes == []


@pytest.mark.parametrize("period_h", [1.2, 1.64, 2.6])
def test_a_swinging_tip_is_not_cut(period_h: float) -> None:
    run = run_of(4, swing=(period_h, 3.0))
    assert np.abs(np.diff(run.points_cm[:, -1, 0])).max() > 0.6
    clean, notes = cleaned(run)
    assert clean is run
    assert notes == []


@pytest.mark.parametrize("turns_h", [0.75, 1.5])
def test_a_tip_that_was_found_wrongly_is_left_out_however_fast_the_stem_swings(turns_h: float) -> None:
    run = run_of(6, light=turns(24.0, turns_h))
    rows = [50, 73, 120, 121, 200, 260]
    points = run.points_cm.copy()
    points[rows, -1, 0] += np.array([1.0, -1.2, 1.5, 1.5, -2.0, 1.1])
    clean, notes = cleaned(replace(run, points_cm=points))
    assert hidden(run, clean) == rows
    assert notes[0].startswith("plant6: 6 stems lay")


def test_the_first_and_the_last_stem_stay() -> None:
    run = run_of(5)
    clean, _ = cleaned(moved(run, [0, len(run) - 1], (3.0, 0.0)))
    assert clean.is_measured[[0, -1]].all()
    everything = without(run, np.ones(len(run), dtype=np.bool_))
    assert everything.is_measured.sum() == 2
    assert cleaned(everything)[1] == [f"{run.name}: no stem for 23.9 h at a time; 99.3 % of all are missing"]


def test_what_was_given_stays_as_it_was() -> None:
    wrong = moved(run_of(1), [100], (2.0, 0.0))
    before = wrong.points_cm.tobytes()
    cleaned(wrong)
    assert wrong.points_cm.tobytes() == before
