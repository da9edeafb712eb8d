"""Tips over time: from flora's own tracks, from plain tables, and from Plant Tracer's.

| header has | is |
|---|---|
| ``time_s,light,x1,…,y10`` or a run folder | flora's own track; its tip is used |
| ``time_s,x_cm,y_cm``, or ``x_mm,y_mm``, ``x_px,y_px`` | a tip whose times are known |
| ``frame,x_cm,y_cm``, or ``x_mm,y_mm``, ``x_px,y_px`` | a tip by frames, whose interval ``--step-s`` may tell |
| ``frame_number,Apex x (mm),Apex y (mm)`` | Plant Tracer's ``trackpoints.csv`` |
"""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from flora_common import files
from flora_common.arrays import Array
from flora_common.counted import counted
from flora_common.errors import BadInput
from flora_common.suggest import clipped
from flora_common.tables import finite_number, is_missing, later_time, read_csv, read_header
from flora_common.tracks import unit_of_stems
from flora_lab.rhythm.lattice import LEAST_SAMPLES
from flora_lab.run_tracks import RunTrack, check_regular, load_run

PLANT_TRACER: Final = ("frame_number", "Apex x (mm)", "Apex y (mm)")
PLAIN: Final = tuple((at, f"x_{unit}", f"y_{unit}") for at in ("time_s", "frame") for unit in ("cm", "mm", "px"))
MOST_SAMPLES: Final = 2000
"""More are averaged in blocks: what counts are cycles, not samples."""
MOST_COORDINATE: Final = 20_000.0
"""Of a tip, in px of the largest picture; in mm and cm there is less."""
MOST_FRAMES: Final = 1e9
WIDEST_GAP_SHARE: Final = 0.1
LEAST_MEASURED_SHARE: Final = 0.7
_NEAR_STEPS: Final = 0.75
_MM_PER_CM: Final = 10.0


@dataclass(frozen=True, slots=True)
class TipTrack:
    """A tip in equal steps.

    Attributes:
        name: of the track.
        file: as it was given.
        x, y: shape (n,), in ``unit``, gaps bridged by straight lines; as the file has them, so y may go up or down.
        known: where it was measured, shape (n,).
        step: between two places, in ``time_unit``.
        start: of the first place, in ``time_unit``.
        time_unit: ``h``, or ``frames`` where the frame interval is not known.
        unit: ``cm`` or ``px``.
        is_scale_doubtful: the scale comes from somewhere else than this rig's calibration.
        right_share: share of the time in which the right lamp alone shone, less that of the left, shape (n,); None
            where no lamps are told, or they never changed.
    """

    name: str
    file: Path
    x: Array
    y: Array
    known: Array
    step: float
    start: float
    time_unit: str
    unit: str
    is_scale_doubtful: bool
    right_share: Array | None


def read_tip(path: Path, *, step_s: float | None = None, px_per_cm: float | None = None) -> TipTrack:
    """A tip from any of the files of this module's table.

    Args:
        path: file or run folder.
        step_s: between two frames, where the file counts frames.
        px_per_cm: scale, where the file is in px.

    Raises:
        BadInput: another header; an option that the file has no use for; numbers that are none; times that do not
            increase; too few places or too many gaps. The message names file and line.
    """
    header = _header(path)
    columns = {name.casefold() for name in header or ()}
    if header is None or ("light" in columns and unit_of_stems(header)):
        _refuse(path, step_s, "--step-s", "has times of its own")
        _refuse(path, px_per_cm, "--px-per-cm", "is in cm already")
        return _own(load_run(path))
    names = next((n for n in (PLANT_TRACER, *PLAIN) if {name.casefold() for name in n} <= columns), None)
    if names is None:
        known = "; ".join(",".join(n) for n in (*PLAIN, PLANT_TRACER))
        there = clipped(",".join(header))
        raise BadInput(f"{path}: its header is none of a tip's: {known}; or flora's own track.csv. Rename its {there}")
    is_in_px, is_timed = names[1] == "x_px", names[0] == "time_s"
    is_in_mm = names is PLANT_TRACER or names[1] == "x_mm"
    if is_timed:
        _refuse(path, step_s, "--step-s", "has times of its own")
    if not is_in_px:
        _refuse(path, px_per_cm, "--px-per-cm", "is in mm" if is_in_mm else "is in cm already")
    at, tips = _numbers(path, names)
    per_unit = px_per_cm if is_in_px and px_per_cm else _MM_PER_CM if is_in_mm else 1.0
    has_hours = is_timed or step_s is not None
    return _even(
        files.shown(path.stem),
        path,
        at * ((1.0 if is_timed else step_s or 1.0) / 3600.0 if has_hours else 1.0),
        tips / per_unit,
        time_unit="h" if has_hours else "frames",
        unit="px" if is_in_px and not px_per_cm else "cm",
        is_scale_doubtful=names is PLANT_TRACER,
    )


def told_apart(tracks: Sequence[TipTrack]) -> list[TipTrack]:
    """The tracks, where several have one name by as much of their files' paths, from the end, as tells them apart."""
    names = Counter(track.name for track in tracks)
    files_of = {name: {_parts(track.file) for track in tracks if track.name == name} for name in names}
    return [
        replace(track, name=_tail(_parts(track.file), files_of[track.name])) if names[track.name] > 1 else track
        for track in tracks
    ]


def _parts(path: Path) -> tuple[str, ...]:
    return Path(os.path.abspath(path)).parts  # noqa: PTH100 - links as they were given, but no `..`


def _tail(own: tuple[str, ...], all_parts: Collection[tuple[str, ...]]) -> str:
    """As many of a path's last parts as no other path has; the whole path where it is the only one."""
    for count in range(1, len(own)):
        if sum(parts[-count:] == own[-count:] for parts in all_parts) == 1 < len(all_parts):
            return files.shown(Path(*own[-count:]))
    return files.shown(Path(*own))


def _header(path: Path) -> list[str] | None:
    """Column names of a file; None for a folder."""
    if path.is_dir():
        return None
    if not path.exists():
        raise BadInput(f"{path}: no such track")
    check_regular(path)
    return read_header(path)


def _refuse(path: Path, value: float | None, option: str, why: str) -> None:
    if value is not None:
        raise BadInput(f"{path}: {why}; leave {option} out, or give this track to a command of its own")


def _own(run: RunTrack) -> TipTrack:
    run.check_points()
    track = run.track
    lit_s, lights = track.lamp_course()
    sides = np.array([{"left": -1.0, "right": 1.0}.get(light, 0.0) for light in lights])
    return _even(
        run.name,
        run.file,
        track.time_s / 3600.0,
        track.points_cm[:, -1],
        time_unit="h",
        unit="cm",
        is_scale_doubtful=False,
        sides=(lit_s / 3600.0, sides) if np.ptp(sides) > 0.0 else None,
    )


def _numbers(path: Path, names: tuple[str, ...]) -> tuple[Array, Array]:
    """Times or frames, shape (n,), and tips, shape (n, 2); a tip with both fields empty was not seen."""
    at: list[float] = []
    tips: list[tuple[float, float]] = []
    for line, row in read_csv(path, list(names)):
        where = f"{path} line {line}"
        at.append(
            later_time(row[names[0]], at, where) if names[0] == "time_s" else _frame(row[names[0]], names[0], at, where)
        )
        if is_missing(row[names[1]]) and is_missing(row[names[2]]):
            tips.append((math.nan, math.nan))
            continue
        x, y = (finite_number(row[name], name, where, MOST_COORDINATE) for name in names[1:])
        tips.append((x, y))
    return np.array(at), np.array(tips).reshape(-1, 2)


def _frame(text: str, name: str, before: list[float], where: str) -> float:
    """The number of a frame, after that of the row before."""
    frame = finite_number(text, name, where, MOST_FRAMES)
    if before and frame <= before[-1]:
        raise BadInput(f"{where}: {name} {frame:g} is not after {before[-1]:g} in the line before")
    return frame


def _even(
    name: str,
    path: Path,
    at: Array,
    tips: Array,
    *,
    time_unit: str,
    unit: str,
    is_scale_doubtful: bool,
    sides: tuple[Array, Array] | None = None,
) -> TipTrack:
    seen = np.isfinite(tips[:, 0])
    at, tips = at[seen], tips[seen]
    if len(at) < LEAST_SAMPLES:
        raise BadInput(
            f"{path}: holds {counted(len(at), 'place')} of the tip; a search for cycles needs {LEAST_SAMPLES}"
        )
    step = float(np.median(np.diff(at)))
    count = round((at[-1] - at[0]) / step) + 1
    if count > 20 * len(at):
        raise BadInput(f"{path}: {len(at)} places in {count} steps of {step:g} {time_unit}; too uneven for a search")
    grid = at[0] + step * np.arange(count)
    after = np.clip(np.searchsorted(at, grid), 1, len(at) - 1)
    known = np.minimum(np.abs(grid - at[after - 1]), np.abs(at[after] - grid)) < _NEAR_STEPS * step
    _check_gaps(path, known)
    x, y = (np.interp(grid, at, tips[:, axis]) for axis in (0, 1))
    right = None if sides is None else np.interp(grid, *sides)
    block = math.ceil(count / MOST_SAMPLES)
    whole = count - count % block

    def averaged(values: Array) -> Array:
        return np.asarray(values[:whole].reshape(-1, block).mean(axis=1))

    x, y = averaged(x), averaged(y)
    if np.ptp(x) == 0.0 and np.ptp(y) == 0.0:
        raise BadInput(f"{path}: the tip never moves; there is nothing to search")
    return TipTrack(
        name=name,
        file=path,
        x=x,
        y=y,
        known=averaged(known.astype(np.float64)) > 0.5,
        step=step * block,
        start=float(at[0]) + 0.5 * (block - 1) * step,
        time_unit=time_unit,
        unit=unit,
        is_scale_doubtful=is_scale_doubtful,
        right_share=None if right is None else averaged(right),
    )


def _check_gaps(path: Path, known: Array) -> None:
    count = len(known)
    share = float(known.mean())
    if share < LEAST_MEASURED_SHARE:
        raise BadInput(f"{path}: the tip is missing in {100 * (1 - share):.0f} % of the steps; 30 % is the most")
    places = np.flatnonzero(known)
    widest = int(np.diff(places).max()) - 1
    if widest > WIDEST_GAP_SHARE * count:
        raise BadInput(f"{path}: a gap of {widest} of {count} steps; give the longer part as a track of its own")
