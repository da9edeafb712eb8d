"""Tracks: a measured run as arrays, read from ``track.csv`` and checked."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.errors import BadRunFolder
from flora_common.runs import TRACK_HEADER, Light, known_light
from flora_common.shapes import FARTHEST_CM, STEM_POINTS
from flora_common.tables import finite_number, is_measured, is_missing, later_time, read_csv, read_header

Unit = Literal["cm", "mm", "px"]
SCALE: Final = "px_per_cm"
"""A column of a track in px that tells its scale."""
_MARKS: Final[Mapping[str, Unit]] = {
    "": "cm",
    **{mark.format(unit): unit for unit in ("cm", "mm", "px") for mark in ("_{}", " ({})")},
}
"""What may stand behind the name of a coordinate: ``x1``, ``x1_mm``, ``x1 (mm)``."""
_PER_CM: Final[Mapping[Unit, float]] = {"cm": 1.0, "mm": 10.0}
_FARTHEST: Final[Mapping[Unit, float]] = {"cm": FARTHEST_CM, "mm": 10.0 * FARTHEST_CM, "px": 20_000.0}
"""What nobody can have measured lies beyond it; a picture is as wide as the camera section allows."""


@dataclass(frozen=True, slots=True)
class Track:
    """A measured run as arrays.

    Attributes:
        time_s: shape (n,), strictly increasing.
        light: length n.
        points_cm: shape (n, 10, 2); point 0 is the anchor (0, 0), point 9 the tip.
        covariates: name to shape (n,); NaN where nothing was measured. Columns that hold no number are none.
        lamps_alone: time in s and lamp of the rows that hold no stem, in order of time.
    """

    time_s: FloatArray
    light: tuple[Light, ...]
    points_cm: FloatArray
    covariates: dict[str, FloatArray]
    lamps_alone: tuple[tuple[float, Light], ...] = ()

    def lamp_course(self) -> tuple[FloatArray, tuple[Light, ...]]:
        """What shone before the time of each row, be there a stem in it or not: times in s, in order, and lamps."""
        course = sorted([*zip(self.time_s.tolist(), self.light, strict=True), *self.lamps_alone])
        return np.array([time_s for time_s, _ in course]), tuple(light for _, light in course)


def read_track(path: Path) -> Track:
    """A track file, checked. Of a row of which no point but the anchor is told the lamp counts, where there is one.

    Points are in cm, or in mm where the columns say so (``x1_mm``), or in px where a column tells the scale.

    Raises:
        BadRunFolder: missing columns, points in px without a scale, numbers that are none or that nobody can have
            measured, times that do not increase, fewer than one row with a stem.
    """
    told: list[float] = []
    times: list[float] = []
    lamps_alone: list[tuple[float, Light]] = []
    lights: list[Light] = []
    points: list[list[float]] = []
    wheres: list[str] = []
    further: dict[str, list[str]] = {}
    names, unit = _columns(path)
    coordinates = names[2 : 2 + 2 * STEM_POINTS]
    for line, row in read_csv(path, names):
        where = f"{path} line {line}"
        is_stem = not all(is_missing(row[name]) for name in coordinates[2:])
        if not is_stem and (is_missing(row["time_s"]) or is_missing(row["light"])):
            continue
        told.append(later_time(row.pop("time_s"), told, where))
        light = known_light(row.pop("light"), where)
        if not is_stem:
            lamps_alone.append((told[-1], light))
            continue
        times.append(told[-1])
        lights.append(light)
        own = [finite_number(row.pop(name), name, where, _FARTHEST[unit], unit) for name in coordinates]
        per_cm = _px_per_cm(row.pop(SCALE), where) if unit == "px" else _PER_CM[unit]
        points.append([value / per_cm for value in own])
        for name, value in row.items():
            further.setdefault(name, []).append(value)
        wheres.append(where)
    if not times:
        raise BadRunFolder(f"{path}: holds no rows with a stem")
    return Track(
        np.array(times),
        tuple(lights),
        np.array(points).reshape(-1, STEM_POINTS, 2),
        {name: _numbers(name, values, wheres) for name, values in further.items() if any(map(is_measured, values))},
        tuple(lamps_alone),
    )


def unit_of_stems(header: Iterable[str]) -> Unit | None:
    """What the points of a table's stems are in, by the names of its columns; None where it has no stems."""
    mark = _mark(header)
    return None if mark is None else _MARKS[mark]


def _mark(header: Iterable[str]) -> str | None:
    columns = {name.casefold() for name in header}
    return next((mark for mark in _MARKS if f"x{STEM_POINTS}{mark}" in columns), None)


def _columns(path: Path) -> tuple[list[str], Unit]:
    """The columns of a track that must be there, time, lamp and points first, and what its points are in.

    Raises:
        BadRunFolder: unreadable, or in px and nothing tells the scale.
    """
    header = read_header(path)
    mark = _mark(header) or ""
    names, unit = TRACK_HEADER.split(","), _MARKS[mark]
    names = [*names[:2], *(name + mark for name in names[2:])]
    if unit != "px":
        return names, unit
    if SCALE not in {name.casefold() for name in header}:
        raise BadRunFolder(
            f"{path}: points are in px, of which nobody knows how long they are; add a column `{SCALE}` with the "
            "scale, or convert them to cm"
        )
    return [*names, SCALE], unit


def _px_per_cm(text: str, where: str) -> float:
    scale = finite_number(text, SCALE, where)
    if scale <= 0.0:
        raise BadRunFolder(f"{where}: {SCALE} is {scale:g}, it must be above 0")
    return scale


def _numbers(name: str, values: list[str], wheres: list[str]) -> FloatArray:
    told = zip(values, wheres, strict=True)
    return np.array([math.nan if is_missing(value) else finite_number(value, name, where) for value, where in told])
