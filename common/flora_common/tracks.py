"""Tracks: a measured run as arrays, read from ``track.csv`` and checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.errors import BadRunFolder
from flora_common.runs import TRACK_HEADER, Light, known_light
from flora_common.shapes import FARTHEST_CM, STEM_POINTS
from flora_common.tables import finite_number, is_measured, is_missing, later_time, read_csv


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

    Raises:
        BadRunFolder: missing columns, numbers that are none or that nobody can have measured, times that do not
            increase, fewer than one row with a stem.
    """
    told: list[float] = []
    times: list[float] = []
    lamps_alone: list[tuple[float, Light]] = []
    lights: list[Light] = []
    points: list[list[float]] = []
    wheres: list[str] = []
    further: dict[str, list[str]] = {}
    names = TRACK_HEADER.split(",")
    for line, row in read_csv(path, names):
        where = f"{path} line {line}"
        is_stem = not all(is_missing(row[name]) for name in names[4:])
        if not is_stem and (is_missing(row["time_s"]) or is_missing(row["light"])):
            continue
        told.append(later_time(row.pop("time_s"), told, where))
        light = known_light(row.pop("light"), where)
        if not is_stem:
            lamps_alone.append((told[-1], light))
            continue
        times.append(told[-1])
        lights.append(light)
        points.append([finite_number(row.pop(name), name, where, FARTHEST_CM, "cm") for name in names[2:]])
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


def _numbers(name: str, values: list[str], wheres: list[str]) -> FloatArray:
    told = zip(values, wheres, strict=True)
    return np.array([math.nan if is_missing(value) else finite_number(value, name, where) for value, where in told])
