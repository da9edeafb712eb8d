"""Tracks without what was wrong in the record of them: a camera that was not level, clocks that were apart."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_common.geometry import resample_by_height
from flora_common.runs import LIGHTS, Light, track_text
from flora_common.shapes import STEM_POINTS
from flora_lab.diagnose.inputs import Runs
from flora_lab.diagnose.joint import Found
from flora_lab.effects.effect import Change
from flora_lab.run_tracks import RunTrack

OF_THE_RECORD: Final = ("camera", "clock")


def write(folder: Path, runs: Runs, found: Found) -> None:
    """Write corrected tracks into a new folder, if anything in the record is to be corrected.

    Covariates are left out: what they were at another time is not known.
    """
    if not any(cause.effect.where in OF_THE_RECORD for cause in found.hypothesis.causes):
        return
    change = found.hypothesis.change(found.coordinates)
    folder.mkdir()
    for number, run in enumerate(runs.tracks, start=1):
        (folder / f"{number:02d}-{run.file.stem}.csv").write_text(corrected_text(run, change), encoding="utf-8")


def corrected_text(run: RunTrack, change: Change) -> str:
    """A track as it would have been recorded rightly."""
    track = run.track
    hours = (track.time_s - track.time_s[0]) / 3600.0
    turn = -change.turned_rad(hours)
    points = track.points_cm / change.scale
    x, y = points[..., 0], points[..., 1]
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    # Angles are measured from the vertical, positive to the right: turning by them is clockwise.
    turned = np.stack([x * cos + y * sin, y * cos - x * sin], axis=-1)
    stems = np.stack([resample_by_height(stem, STEM_POINTS) for stem in turned])
    return track_text(track.time_s, _lights(track.light, hours, change), stems)


def _lights(lights: tuple[Light, ...], hours: Array, change: Change) -> list[Light]:
    """What really shone before each row."""
    then = hours - change.late_h - change.late_per_h * hours
    rows = np.clip(np.searchsorted(hours, then, side="left"), 1 if len(hours) > 1 else 0, len(hours) - 1)
    told = [lights[row] for row in rows.tolist()]
    told[0] = lights[0]
    assert all(light in LIGHTS for light in told)
    return told
