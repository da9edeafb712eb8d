"""Tracks without what was wrong in the record of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnose_runs import QUIET, change_of, run_of, turns, write_run

from flora_lab.diagnose import corrected_tracks
from flora_lab.diagnose.hypothesis import Cause, Hypothesis
from flora_lab.diagnose.inputs import Runs
from flora_lab.diagnose.joint import Found
from flora_lab.effects.catalogue import BY_NAME
from flora_lab.effects.effect import RUN_H, Change
from flora_lab.run_tracks import RunTrack, load_run
from flora_lab.simulator.measured import MeasuredRun, in_steps


def shown(run: MeasuredRun, change: Change) -> MeasuredRun:
    """As a camera that is rolled, turns, and has the wrong scale shows it."""
    hours = run.time_s / 3600.0
    turn = np.radians(change.turn_deg + change.drift_deg * hours / RUN_H)
    x, y = run.points_cm[..., 0], run.points_cm[..., 1]
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    points = change.scale * np.stack([x * cos + y * sin, y * cos - x * sin], axis=-1)
    return replace(run, points_cm=points)


def mended(folder: Path, run: MeasuredRun, change: Change) -> RunTrack:
    track = load_run(write_run(folder, run))
    path = folder / "mended.csv"
    path.write_text(corrected_tracks.corrected_text(track, change), encoding="utf-8")
    return load_run(path)


@pytest.mark.parametrize(
    "change",
    [
        Change(turn_deg=4.0, scale=1.08),
        Change(turn_deg=-6.0),
        Change(scale=0.85),
        Change(drift_deg=20.0),
        Change(turn_deg=2.0, drift_deg=-9.0, scale=1.1),
    ],
)
def test_a_track_comes_back_as_it_would_have_been_seen_rightly(tmp_path: Path, change: Change) -> None:
    right = run_of(1, chance=QUIET)
    wrong = shown(right, change)
    assert np.abs(wrong.points_cm[:, -1] - right.points_cm[:, -1]).max() > 0.4
    back = mended(tmp_path, wrong, change).track
    assert back.points_cm[:, -1] == pytest.approx(right.points_cm[:, -1], abs=1e-3)
    assert back.points_cm == pytest.approx(right.points_cm, abs=0.05)  # points between are at other heights
    heights = back.points_cm[:, :, 1]
    assert np.diff(heights, axis=1) == pytest.approx(np.repeat(heights[:, -1:] / 9.0, 9, axis=1), abs=2e-3)
    assert back.time_s.tolist() == right.time_s.tolist()


def test_what_the_catalogue_calls_a_rolled_camera_is_taken_back(tmp_path: Path) -> None:
    """Names and signs are those of the finder: what it would name is what is undone."""
    right = run_of(2, chance=QUIET)
    change = change_of({"camera_roll": {"angle_deg": 5.0}, "camera_scale": {"factor": 1.1}})
    back = mended(tmp_path, shown(right, change), change)
    assert back.track.points_cm[:, -1] == pytest.approx(right.points_cm[:, -1], abs=1e-3)


@pytest.mark.parametrize("offset_h", [-0.75, 0.5, 1.0])
def test_lights_are_told_when_they_shone(tmp_path: Path, offset_h: float) -> None:
    run = run_of(3, light=turns(24.0, 4.0), chance=QUIET)
    change = change_of({"clock_offset": {"offset_h": offset_h}})
    late = in_steps(mended(tmp_path, run, change)).light
    by = round(offset_h * 12)
    rows = np.arange(24, len(late) - 24)
    assert late[rows].tolist() == run.light[rows - by].tolist()


def test_a_clock_that_runs_wrong_is_set_right_ever_more(tmp_path: Path) -> None:
    run = run_of(3, light=turns(24.0, 4.0), chance=QUIET)
    change = change_of({"clock_skew": {"per_hour": 0.05}})
    late = in_steps(mended(tmp_path, run, change)).light
    switches = [np.flatnonzero(np.diff(light[:, 0]) != 0.0) + 1 for light in (run.light, late)]
    hours = switches[0] / 12.0
    assert switches[1] / 12.0 == pytest.approx(hours / 0.95, abs=0.1)


def runs_of(tmp_path: Path) -> Runs:
    tracks = [load_run(write_run(tmp_path / "runs", run_of(seed, chance=QUIET))) for seed in (1, 2)]
    return Runs(tuple(tracks), tuple(in_steps(track) for track in tracks), (), ((),) * len(tracks))


def found_of(name: str, *coordinates: float) -> Found:
    return Found(Hypothesis((Cause(BY_NAME[name]),)), np.array(coordinates), np.zeros((2, 9)), np.zeros((2, 2)))


def test_only_what_is_wrong_in_the_record_is_corrected(tmp_path: Path) -> None:
    runs = runs_of(tmp_path)
    corrected_tracks.write(tmp_path / "plant", runs, found_of("sag", 0.7))
    assert not (tmp_path / "plant").exists()
    assert corrected_tracks.names_of(runs, found_of("sag", 0.7)) == []
    corrected_tracks.write(tmp_path / "camera", runs, found_of("camera_scale", np.log(1.1)))
    files = sorted((tmp_path / "camera").iterdir())
    assert [file.name for file in files] == ["01-plant1.csv", "02-plant2.csv"]
    assert [file.name for file in files] == corrected_tracks.names_of(runs, found_of("camera_scale", np.log(1.1)))
    for file, run in zip(files, runs.tracks, strict=True):
        assert load_run(file).track.points_cm[:, -1] == pytest.approx(run.track.points_cm[:, -1] / 1.1, abs=1e-3)
