"""Tracks: a measured run as arrays, read from ``track.csv`` and checked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.errors import BadRunFolder
from flora_common.runs import TRACK_HEADER, Light, finite_number, known_light, later_time, read_csv
from flora_common.shapes import FARTHEST_CM, STEM_POINTS


@dataclass(frozen=True, slots=True)
class Track:
    """A measured run as arrays.

    Attributes:
        time_s: shape (n,), strictly increasing.
        light: length n.
        points_cm: shape (n, 10, 2); point 0 is the anchor (0, 0), point 9 the tip.
        covariates: name to shape (n,).
    """

    time_s: FloatArray
    light: tuple[Light, ...]
    points_cm: FloatArray
    covariates: dict[str, FloatArray]


def read_track(path: Path) -> Track:
    """A track file, checked.

    Raises:
        BadRunFolder: missing columns, numbers that are none or that nobody can have measured, times that do not
            increase, fewer than one row.
    """
    times: list[float] = []
    lights: list[Light] = []
    points: list[list[float]] = []
    covariates: dict[str, list[float]] = {}
    names = TRACK_HEADER.split(",")
    for line, row in read_csv(path, names):
        where = f"{path} line {line}"
        times.append(later_time(row.pop("time_s"), times, where))
        lights.append(known_light(row.pop("light"), where))
        points.append([finite_number(row.pop(name), name, where, FARTHEST_CM, "cm") for name in names[2:]])
        for name, value in row.items():
            covariates.setdefault(name, []).append(finite_number(value, name, where))
    if not times:
        raise BadRunFolder(f"{path}: holds no rows")
    return Track(
        np.array(times),
        tuple(lights),
        np.array(points).reshape(-1, STEM_POINTS, 2),
        {name: np.array(values) for name, values in covariates.items()},
    )
