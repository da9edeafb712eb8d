"""Tracks without what was wrong in the record of them: a camera that was not level or was knocked, clocks apart."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_common.geometry import resample_by_height, turned_right
from flora_common.runs import LIGHTS, Light, track_text
from flora_common.shapes import STEM_POINTS
from flora_lab.diagnose.inputs import Runs
from flora_lab.diagnose.joint import Found
from flora_lab.diagnose.knocks import Knock, turned_back
from flora_lab.effects.effect import Change
from flora_lab.run_tracks import RunTrack

FOLDER: Final = "corrected"


def names_of(runs: Runs, found: Found) -> list[str]:
    """What the corrected tracks are called, one of each run; none where nothing in the record is to be corrected."""
    if not any(runs.knocks) and not any(cause.effect.is_of_the_record for cause in found.hypothesis.causes):
        return []
    return [f"{number:02d}-{run.file.stem}.csv" for number, run in enumerate(runs.tracks, start=1)]


def write(folder: Path, runs: Runs, found: Found) -> None:
    """Write corrected tracks into a new folder, if anything in the record is to be corrected.

    Covariates are left out: what they were at another time is not known.
    """
    names = names_of(runs, found)
    if not names:
        return
    change = found.hypothesis.change(found.coordinates)
    folder.mkdir()
    for name, run, knocks in zip(names, runs.tracks, runs.knocks, strict=True):
        (folder / name).write_text(corrected_text(run, change, knocks), encoding="utf-8")


def corrected_text(run: RunTrack, change: Change, knocks: Sequence[Knock] = ()) -> str:
    """A track as it would have been recorded rightly."""
    track = run.track
    hours = (track.time_s - track.time_s[0]) / 3600.0
    points = turned_back(track.points_cm / change.scale, track.time_s, knocks)
    turned = turned_right(points, -change.turned_rad(hours))
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
