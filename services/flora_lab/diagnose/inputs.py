"""Which runs a diagnosis is about, and which it learns from, read and looked over."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from flora_common.arrays import Array
from flora_common.counted import counted
from flora_common.errors import BadInput
from flora_common.runs import LampsSection
from flora_lab.diagnose import record
from flora_lab.diagnose.knocks import Knock, knocks_of, turned_back
from flora_lab.diagnose.scene import TEMPERATURE, Scene
from flora_lab.run_tracks import RunTrack, load_runs
from flora_lab.simulator.interface import History, Simulator
from flora_lab.simulator.measured import MeasuredRun, in_steps, step_of
from flora_lab.simulator.terms import NEUTRAL, ExtendedLaw

SHORTEST_H: Final = 6.0
LONGEST_H: Final = 1000.0
"""What is compared grows with the square of it; a clock that jumps by months makes a run as long."""
FEWEST_REFERENCES: Final = 3
TRACK_SUFFIXES: Final = (".csv", ".tsv")


@dataclass(frozen=True, slots=True)
class Runs:
    """Some runs in equal steps.

    Attributes:
        tracks: as they were read.
        measured: cleaned, turned back after knocks, in equal steps.
        notes: what was found in the records.
        knocks: of each run.
    """

    tracks: tuple[RunTrack, ...]
    measured: tuple[MeasuredRun, ...]
    notes: tuple[str, ...]
    knocks: tuple[tuple[Knock, ...], ...]

    def scenes(self, usual_c: float | None, terms: Array = NEUTRAL) -> list[Scene]:
        """Ready to be compared with plants that are used to this temperature, and have these terms, shape (26,)."""
        return [Scene(run, ExtendedLaw(run.lamps or LampsSection(), terms), usual_c) for run in self.measured]

    @property
    def knocked(self) -> list[str]:
        """In which runs the camera or the pot was knocked, when and how far."""
        return [
            f"{run.name} {knock.words}"
            for run, knocks in zip(self.measured, self.knocks, strict=True)
            for knock in knocks
        ]

    def usual_temperature_c(self) -> float | None:
        """Mean temperature, where all runs tell it."""
        told = [run.covariates.get(TEMPERATURE) for run in self.measured]
        known = [values for values in told if values is not None and np.isfinite(values).any()]
        return float(np.nanmean(np.concatenate(known))) if known and len(known) == len(told) else None


def read_runs(paths: Sequence[Path], note: Callable[[str], None] = lambda _: None) -> Runs:
    """Runs, cleaned and in equal steps.

    Raises:
        BadInput: see :func:`flora_lab.run_tracks.load_runs`; or a run that is too short, or has too few stems, to tell
            anything.
    """
    tracks = load_runs(paths)
    if all(track.lamps is None for track in tracks) and tracks:
        lamps = LampsSection()
        note(
            f"no run.toml tells where the lamps hang: taken to be {lamps.distance_cm:g} cm to either side, "
            f"{lamps.height_cm:g} cm high"
        )
    measured, notes, knocks = [], [], []
    for track in tracks:
        run, found = record.cleaned(in_steps(track, step_of(track.track.time_s)))
        if run.hours < SHORTEST_H:
            raise BadInput(
                f"{track.file}: is {run.hours:.1f} h long; at least {SHORTEST_H:g} h are needed (time_s is in seconds)"
            )
        if run.hours > LONGEST_H:
            raise BadInput(
                f"{track.file}: goes on for {run.hours:,.0f} h; {LONGEST_H:,.0f} h are compared at most. "
                "If a clock was set meanwhile, leave out the rows before or after"
            )
        pairs = run.is_measured[1:] & run.is_measured[:-1]
        if not pairs.any() or not Scene(run, ExtendedLaw(run.lamps or LampsSection())).size:
            raise BadInput(f"{track.file}: no hour of it has enough photographs of a stem that moves; leave it out")
        knocks.append(knocks_of(run))
        measured.append(replace(run, points_cm=turned_back(run.points_cm, run.time_s, knocks[-1])))
        notes += found
    return Runs(tuple(tracks), tuple(measured), tuple(notes), tuple(knocks))


def read_holdout(paths: Sequence[Path], measured: Runs) -> Runs | None:
    """Runs to judge by; None where there are none.

    Raises:
        BadInput: see :func:`read_runs`; or one that is also to be diagnosed: it would judge what was fitted to it.
    """
    if not paths:
        return None
    held_out = read_runs(paths)
    _check_others(held_out, measured, "a run that is held out cannot be")
    return held_out


def check_unseen(runs: Runs | None, learned_from: Collection[str]) -> None:
    """Whether a simulator has not been learned from runs that it is to be compared with.

    Args:
        runs: these runs.
        learned_from: SHA-256 of the tracks that it was learned from.

    Raises:
        BadInput: it has seen one of them, and would explain or judge itself.
    """
    for track in () if runs is None else runs.tracks:
        if track.sha256 in learned_from:
            raise BadInput(f"{track.file}: the simulator was learned from this run; take one that it has not seen")


def told_again(runs: Runs, extended_by: Collection[str]) -> str:
    """A sentence where a simulator was extended by what runs told that it is now compared with; else empty.

    Args:
        runs: these runs.
        extended_by: SHA-256 of the tracks that it was extended by.
    """
    again = sum(track.sha256 in extended_by for track in runs.tracks)
    if not again:
        return ""
    which = "this very run" if len(runs.tracks) == 1 else f"{again} of these {len(runs.tracks)} runs"
    return f"the simulator was extended by what {which} told: what it explains of that is no confirmation"


def check_known(simulator: Simulator[Any], runs: Runs | None) -> None:
    """Whether a simulator can be run beside runs at all, before anything that takes its time.

    Raises:
        BadInput: it does not know one's step, or lamps that shone in it.
    """
    for track, run in () if runs is None else zip(runs.tracks, runs.measured, strict=True):
        first = History(run.points_cm[:1, None], run.light[:0, None], run.step_s, {})
        for row in np.sort(np.unique(run.light, axis=0, return_index=True)[1]).tolist():
            try:
                simulator.step(simulator.watch(first), run.light[row : row + 1], run.step_s)
            except BadInput as problem:
                where = f"{track.file} at time_s {run.time_s[row + 1]:g}"
                told = f"{where}: {problem}; for such runs give --reference without --simulator"
                raise BadInput(told) from problem


def read_reference(folder: Path, measured: Runs) -> Runs:
    """All runs and tracks in a folder, to learn from.

    Raises:
        BadInput: too few, or one that is also to be diagnosed: it would be explained by itself.
    """
    if not folder.is_dir():
        raise BadInput(f"{folder}: is no folder; --reference takes a folder of runs or tracks to learn from")
    shown = (p for p in folder.iterdir() if not p.name.startswith("."))
    inner = sorted(p for p in shown if (p / "track.csv").is_file() or p.suffix.lower() in TRACK_SUFFIXES)
    if len(inner) < FEWEST_REFERENCES:
        raise BadInput(
            f"{folder}: holds {counted(len(inner), 'run')} with a track; at least {FEWEST_REFERENCES} are needed to "
            "tell how plants differ"
        )
    reference = read_runs(inner)
    _check_others(reference, measured, "a run cannot be its own reference")
    return reference


def _check_others(runs: Runs, measured: Runs, why: str) -> None:
    """Raise :class:`BadInput` where one of the runs is also to be diagnosed."""
    own = {track.sha256: track for track in measured.tracks}
    for track in runs.tracks:
        twin = own.get(track.sha256)
        if twin is not None:
            raise BadInput(f"{track.file}: is also to be diagnosed ({twin.file}); {why}")
