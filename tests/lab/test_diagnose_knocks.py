"""A camera or a pot that was knocked is told, and what comes after is turned back; what a plant does is no knock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose_runs import STEP_S, run_of, turns

from flora_common.geometry import turned_right
from flora_lab.diagnose.knocks import Knock, knocks_of, turned_back
from flora_lab.diagnose.record import without
from flora_lab.simulator.measured import MeasuredRun


def knocked(run: MeasuredRun, *knocks: tuple[int, float]) -> MeasuredRun:
    """A run whose stems are turned from some rows on, by degrees to the right."""
    points = run.points_cm
    for row, angle_deg in knocks:
        points = turned_right(points, np.where(np.arange(len(run)) >= row, np.radians(angle_deg), 0.0))
    return replace(run, points_cm=points)


def test_knocks_are_told_with_hour_and_angle_and_turned_back() -> None:
    rng = np.random.default_rng(20)
    missed = 0
    for seed in range(40):
        run, row = run_of(seed), int(rng.integers(10, 270))
        angle_deg = float(rng.uniform(5.0, 15.0) * rng.choice([-1.0, 1.0]))
        found = knocks_of(knocked(run, (row, angle_deg)))
        if not found:
            missed += 1
            continue
        (knock,) = found
        assert knock.hour_h == pytest.approx(row * STEP_S / 3600.0)
        assert knock.angle_deg == pytest.approx(angle_deg, abs=1.5)
        back = turned_back(knocked(run, (row, angle_deg)).points_cm, run.time_s, [knock])
        assert np.degrees(np.abs(np.arctan2(*back[-1, -1]) - np.arctan2(*run.points_cm[-1, -1]))) < 1.5
    assert missed <= 4  # a knock while the lamps change is seen in a stem that bends


@pytest.mark.parametrize("seed", range(20))
def test_what_a_plant_does_is_no_knock(seed: int) -> None:
    """Nor is it where it is photographed seldom, or turns from lamp to lamp in an hour."""
    assert knocks_of(run_of(seed)) == ()
    assert knocks_of(run_of(seed, hours=48.0, step_s=1800.0)) == ()
    assert knocks_of(run_of(seed, light=turns(24.0, 1.0))) == ()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("upper", [5, 8])
def test_a_stem_that_is_pushed_or_breaks_is_no_knock(seed: int, upper: int) -> None:
    """Only what is above a place moves."""
    run = run_of(seed)
    points = run.points_cm.copy()
    foot = points[150:, upper - 1 : upper]
    points[150:, upper:] = foot + turned_right(points[150:, upper:] - foot, np.full(len(run) - 150, 0.5))
    assert knocks_of(replace(run, points_cm=points)) == ()


def test_several_are_told_in_order_of_time() -> None:
    found = knocks_of(knocked(run_of(3), (60, 6.0), (130, 12.0), (200, -9.0)))
    assert [round(knock.hour_h) for knock in found] == [5, 11, 17]
    assert [knock.angle_deg for knock in found] == pytest.approx([6.0, 12.0, -9.0], abs=1.0)


def test_a_plant_that_turned_while_no_stem_was_found_was_not_knocked() -> None:
    run = knocked(run_of(2), (110, 10.0))
    rows = np.arange(len(run))
    assert len(knocks_of(without(run, (rows > 106) & (rows < 111)))) == 1
    assert knocks_of(without(run, (rows > 90) & (rows < 111))) == ()


def test_a_run_of_few_stems_tells_no_knock() -> None:
    run = knocked(run_of(1, hours=1.5), (10, 20.0))
    assert len(run) < 24
    assert knocks_of(run) == ()


def test_a_knock_says_when_how_far_and_to_which_side() -> None:
    assert Knock(3600.0, 43.95, -10.2).words == "44.0 h after its start by 10.2 degrees to the left"
