"""Gaps in a record: what shone in them is not known, and nothing that is said of a plant may hang on it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnose_runs import LAMPS, LAW, TYPICAL, known, run_of, turns, write_run

from flora_common.arrays import Array
from flora_lab.diagnose import verdict
from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.record import without
from flora_lab.diagnose.restarts import LEAST_H, lost_from, restarts_of, short_gaps
from flora_lab.diagnose.scene import Lanes, Scene
from flora_lab.effects.effect import Change
from flora_lab.run_tracks import load_run
from flora_lab.simulator.measured import MeasuredRun, in_steps
from flora_lab.threads import one_blas_thread

PER_H = 12
EVERY = 3


def with_gap(run: MeasuredRun, folder: Path, *gaps_h: tuple[float, float]) -> MeasuredRun:
    """The run, read again from a track that lacks the rows between some hours."""
    row_h = np.arange(len(run)) / PER_H
    lost = np.any([(row_h > start) & (row_h < stop) for start, stop in gaps_h], axis=0)
    return in_steps(load_run(write_run(folder, without(run, lost))))


def placed(run: MeasuredRun) -> MeasuredRun:
    """With lamps: a bare track does not tell where they hang."""
    return replace(run, lamps=LAMPS)


def quiet(light: Array, seed: int = 3) -> MeasuredRun:
    """A typical plant to which nothing happens by chance."""
    return run_of(seed, light=light, hours=24.0, chance={}, traits=TYPICAL)


def test_a_run_begins_anew_after_a_long_gap_in_which_lamps_changed(tmp_path: Path) -> None:
    run = with_gap(quiet(turns(24.0, 6.0)), tmp_path, (10.0, 13.5))
    (again,) = restarts_of(run, len(run) - 1, EVERY)
    assert again.blind_from == 10 * PER_H + 1
    assert again.step % EVERY == 0
    assert 13.5 * PER_H <= again.step - 1 < 13.5 * PER_H + EVERY + 1
    assert again.stem_cm == pytest.approx(run.points_cm[again.step], abs=0.05)
    assert short_gaps(run, len(run) - 1) == []


@pytest.mark.parametrize(
    ("gaps_h", "why"),
    [
        (((11.8, 12.2),), "short"),
        (((7.0, 10.0),), "no lamp changed, and none does so fast"),
        (((1.0, 1.01),), "no gap"),
    ],
)
def test_it_goes_on_where_it_is_known_what_shone(tmp_path: Path, gaps_h: tuple[tuple[float, float]], why: str) -> None:
    run = with_gap(quiet(turns(24.0, 6.0)), tmp_path, *gaps_h)
    assert restarts_of(run, len(run) - 1, EVERY) == [], why


def test_lamps_that_change_often_may_have_changed_twice_in_a_gap(tmp_path: Path) -> None:
    run = with_gap(quiet(turns(24.0, 1.0)), tmp_path, (8.1, 10.1))
    assert not run.unseen[0].changes
    assert len(restarts_of(run, len(run) - 1, EVERY)) == 1


def test_a_run_that_has_no_sound_stem_after_a_gap_ends_there(tmp_path: Path) -> None:
    run = with_gap(quiet(turns(24.0, 6.0)), tmp_path, (17.0, 23.9))
    assert restarts_of(run, len(run) - 1, EVERY) == []
    assert lost_from(run, []) == 17 * PER_H + 1
    assert not Scene(run, LAW).is_seen[17 * PER_H + 1 :].any()


@pytest.mark.parametrize("kept", [slice(0, None, 2), slice(1, None, 2), slice(2, None, 4)])
def test_photographs_more_seldom_after_a_gap_tell_where_the_plant_stands(tmp_path: Path, kept: slice) -> None:
    """No three in a row are there: a rig that went on with another interval, or a stem that is found now and then."""
    whole = quiet(turns(24.0, 6.0))
    hidden = np.zeros(len(whole), dtype=np.bool_)
    hidden[13 * PER_H + 1 :] = True
    hidden[13 * PER_H + 1 :][kept] = False
    run = with_gap(without(whole, hidden), tmp_path, (10.0, 13.5))
    (again,) = restarts_of(run, len(run) - 1, EVERY)
    near = np.flatnonzero(run.is_measured)
    assert np.abs(near - again.step).min() <= 1
    assert again.stem_cm == pytest.approx(whole.points_cm[again.step], abs=0.15)
    assert lost_from(run, [again]) == len(run)


def test_what_follows_a_gap_is_compared_with_the_stem_that_was_there(tmp_path: Path) -> None:
    """The lamp changed at the end of the gap, where it is taken to have changed in the middle."""
    light = turns(24.0, 24.0)
    light[round(13.4 * PER_H) :] = light[0, ::-1]
    run = placed(with_gap(quiet(light), tmp_path, (7.0, 13.5)))
    lanes = Lanes(TYPICAL[None], np.zeros((1, 2)), [Change()])
    off: list[float] = []
    for scene in (Scene(run, LAW), Scene(replace(run, unseen=()), LAW)):
        left, _ = scene.tips(TYPICAL, np.zeros(2), Change())
        after = left[round(13.6 * PER_H) :]
        off.append(float(np.nanmax(np.abs(after))))
        assert np.isfinite(scene.simulated(lanes)).all()
    assert off[0] < 0.5
    assert off[1] > 4.0 * off[0]


def test_rows_between_a_gap_and_the_new_start_are_not_compared(tmp_path: Path) -> None:
    scene = Scene(placed(with_gap(quiet(turns(24.0, 6.0)), tmp_path, (10.0, 13.5))), LAW)
    (again,) = scene.restarts
    assert not scene.is_seen[again.blind_from : again.step + 2].any()
    assert scene.is_seen[[again.blind_from - 1, again.step + 2]].all()
    left, simulated = scene.tips(TYPICAL, np.zeros(2), Change())
    assert np.isnan(left[again.blind_from - 1 : again.step + 1]).all()
    assert np.isfinite(simulated).all()


def test_the_law_goes_on_remembering_over_a_gap(tmp_path: Path) -> None:
    """Where the simulation was right before a gap, it is as right after one: clock and lamps are not forgotten."""
    run = quiet(turns(24.0, 6.0))
    whole, cut = Scene(run, LAW), Scene(placed(with_gap(run, tmp_path, (10.5, 13.4))), LAW)
    assert len(cut.restarts) == 1
    lanes = Lanes(TYPICAL[None], np.zeros((1, 2)), [Change()])
    apart = np.abs(whole.points(lanes, every=1)[:, 0] - cut.points(lanes, every=1)[:, 0])
    assert apart[: 10 * PER_H].max() < 1e-4  # a track tells so many digits
    assert apart[16 * PER_H :].max() < 0.15


def test_plants_that_part_later_are_those_that_were_always_apart(tmp_path: Path) -> None:
    """To the bit, over a gap too, and wherever between two told rows they part."""
    scene = Scene(placed(with_gap(quiet(turns(24.0, 6.0)), tmp_path, (10.5, 13.4))), LAW)
    assert len(scene.restarts) == 1
    since = np.array([0, 0, 7, 100, scene.restarts[0].step, 200, scene.steps])
    steps = np.arange(scene.steps)[:, None]
    pushes = np.where(steps >= since, 0.02 * np.random.default_rng(1).standard_normal((scene.steps, len(since))), 0.0)
    drives = {"bias": pushes * (np.arange(len(since)) > 0)}
    lanes = Lanes(np.repeat(TYPICAL[None], len(since), axis=0), np.zeros((len(since), 2)), [Change()] * len(since))
    apart = scene.points(lanes, drives)
    assert np.array_equal(scene.points(lanes, drives, since=since), apart)
    assert np.array_equal(apart[:, -1], apart[:, 0])
    assert not np.array_equal(apart[:, 1], apart[:, 0])


def test_what_gaps_leave_unknown_is_as_large_as_it_may_be(tmp_path: Path) -> None:
    light = turns(24.0, 6.0)
    run = placed(with_gap(quiet(light), tmp_path, (11.74, 12.21)))
    scene = Scene(run, LAW)
    (gap,) = short_gaps(run, scene.steps)
    assert (gap.stop - gap.start) / PER_H <= LEAST_H
    columns = scene.answers(TYPICAL, Change()).to_gaps
    assert columns.shape == (scene.size, 1)
    lanes = Lanes(TYPICAL[None], np.zeros((1, 2)), [Change()])
    early = run.light.copy()
    early[gap.start : gap.stop] = gap.after
    as_taken = scene.simulated(lanes)[0]
    moved = scene.of_points(scene.points(lanes, lights=[early[: scene.steps]]))[0] - as_taken
    # Half a gap early is the square root of three standard deviations of a time that is anywhere in it.
    assert np.abs(moved).max() > 0.1
    assert np.abs(np.abs(moved) - np.sqrt(3.0) * np.abs(columns[:, 0])).max() < 0.25 * np.abs(moved).max()


def test_a_new_start_may_lean_or_bend_a_little(tmp_path: Path) -> None:
    scene = Scene(placed(with_gap(quiet(turns(24.0, 6.0)), tmp_path, (10.0, 13.5))), LAW)
    columns = scene.answers(TYPICAL, Change()).to_gaps
    (again,) = scene.restarts
    before = scene.time_h[scene.window] < again.step / PER_H - 0.5
    assert columns.shape == (scene.size, 2)
    assert not columns[before].any()
    sideways = np.abs(columns[~before & (scene.feature != 1)])
    assert (sideways.max(axis=0) > np.array([0.1, 0.02])).all()


def test_nothing_is_wrong_with_healthy_plants_of_which_hours_were_not_seen(tmp_path: Path) -> None:
    runs = [
        placed(with_gap(run_of(seed, hours=24.0), tmp_path, gap)) for seed, gap in ((70, (7.2, 12.5)), (71, (3, 5)))
    ]
    scenes = [Scene(run, LAW) for run in runs]
    assert sum(len(scene.restarts) for scene in scenes) == 2
    with one_blas_thread():
        explanation = Explainer(scenes, known()).explain()
        left = verdict.left_of(explanation, known())
    assert not explanation.accepted
    assert not left.is_much
