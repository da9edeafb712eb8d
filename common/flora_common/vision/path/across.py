"""What is measured across a line: the two edges of a stem, or the ridge of one that lies on a leaf."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from flora_common.arrays import BoolArray, FloatArray
from flora_common.vision.path.sampler import HALF_LIGHT_LEVEL, Sampler, normals

EDGE_ERROR_PX: Final = 0.35
ONE_EDGE_ERROR_PX: Final = 3.0
RIDGE_ERROR_PX: Final = 1.2
BARE_PERCENTILE: Final = 35
"""Of widths across a stem: leaves and their stalks make it wider in half of its places at most."""
AGREE: Final = 0.15
"""In widths: how far the two edges' opinions on the middle may lie apart."""
RIDGE_LEAST: Final = 8.0
"""In code units: how much a stem must stand out on a leaf to be believed there."""


@dataclass(frozen=True, slots=True, eq=False)
class Across:
    """What was found across the line at each s: places (n, 2), errors (n,) and widths (n,) in px."""

    places: FloatArray
    error: FloatArray
    width: FloatArray
    seen: BoolArray
    clean: BoolArray


def measured(line: FloatArray, s: FloatArray, width: FloatArray, sampler: Sampler, apex_from: float) -> Across:
    """The stem's middle at each s up to ``apex_from`` by its edges or by a ridge."""
    upto = int(np.searchsorted(s, apex_from, side="right"))
    some, normal, width = line[:upto], normals(line)[:upto], width[:upto]
    offset, x, y = _places(some, normal, 1.6 * float(width.max()) + 2.0)
    left, right, there = _edges(sampler.plant_at(x, y), offset)
    half = 0.5 * width
    # each edge by itself says where the middle is; beside a leaf only one of them is the stem's
    by_left, by_right = left + half, right - half
    nearer = np.where(np.abs(by_left) < np.abs(by_right), by_left, by_right)
    clean = there & (np.abs(by_left - by_right) < AGREE * width + 0.4) & (np.abs(left + right) < 1.5 * width + 2.0)
    one_edge = there & (np.abs(nearer) < 0.35 * width + 0.5)
    by_ridge, ridge = np.zeros(upto), np.zeros(upto, dtype=np.bool_)
    rest = np.flatnonzero(~clean)
    if rest.size:
        by_ridge[rest], ridge[rest] = _ridge(sampler.tone_at(x[rest], y[rest]), offset, width[rest])
    # a ridge is the stem itself; a single edge may be that of a leaf which covers it
    one_edge &= ~ridge
    middle = np.where(clean, 0.5 * (left + right), np.where(one_edge, nearer, by_ridge))
    error = np.where(clean, EDGE_ERROR_PX, np.where(one_edge, ONE_EDGE_ERROR_PX, RIDGE_ERROR_PX))
    more = (0, len(line) - upto)
    return Across(
        np.concatenate([some + middle[:, None] * normal, line[upto:]]),
        np.pad(error, more, constant_values=EDGE_ERROR_PX),
        np.pad(right - left, more),
        np.pad(clean | one_edge | ridge, more),
        np.pad(clean, more),
    )


def bare_width(line: FloatArray, widest_px: float, sampler: Sampler) -> float:
    """How wide the plant is across a line where it is bare stem, px; NaN where no two edges are seen."""
    offset, x, y = _places(line, normals(line), widest_px)
    left, right, there = _edges(sampler.plant_at(x, y), offset)
    width = (right - left)[there]
    return float(np.percentile(width, BARE_PERCENTILE)) if width.size else math.nan


def _places(line: FloatArray, normal: FloatArray, reach_px: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Offsets across a line (n, 2) every half pixel, shape (m,), and x and y of these places, shape (n, m)."""
    offset = np.arange(-reach_px, reach_px + 0.25, 0.5)
    x, y = (line[:, k, None] + offset * normal[:, k, None] for k in range(2))
    return offset, x, y


def _edges(plant: FloatArray, offset: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Where the evidence falls to half on the left and on the right, and whether it does on both sides."""
    n, m = plant.shape
    middle = m // 2
    level = HALF_LIGHT_LEVEL * np.max(plant[:, middle - 2 : middle + 3], axis=1, keepdims=True)
    low = plant < level
    rows = np.arange(n)
    right = middle + np.argmax(low[:, middle:], axis=1)
    left = middle - np.argmax(low[:, middle::-1], axis=1)
    both = low[:, middle:].any(axis=1) & low[:, : middle + 1].any(axis=1) & ~low[:, middle] & (level[:, 0] > 0)
    right, left = np.clip(right, 1, m - 1), np.clip(left, 0, m - 2)

    def crossing(outer: npt.NDArray[np.intp], inner: npt.NDArray[np.intp]) -> FloatArray:
        a, b = plant[rows, outer], plant[rows, inner]
        share = np.clip((level[:, 0] - a) / np.where(np.abs(b - a) < 1e-9, 1.0, b - a), 0.0, 1.0)
        return np.asarray(offset[outer] + share * (offset[inner] - offset[outer]), dtype=np.float64)

    return crossing(left, left + 1), crossing(right, right - 1), np.asarray(both)


def _ridge(tone: FloatArray, offset: FloatArray, width: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Where a band of the stem's width stands out most against both its sides, and whether it does clearly."""
    step = offset[1] - offset[0]
    total = np.concatenate([np.zeros((len(tone), 1)), np.cumsum(tone, axis=1)], axis=1)
    half = np.maximum(1, np.rint(0.5 * width / step).astype(int))[:, None]
    side = np.maximum(1, np.rint(0.4 * width / step).astype(int))[:, None]
    most = 0.6 * width + 0.5
    centre = np.flatnonzero(np.abs(offset) <= most.max())[None, :]

    def mean(low: npt.NDArray[np.intp], high: npt.NDArray[np.intp]) -> FloatArray:
        a, b = np.clip(low, 0, tone.shape[1]), np.clip(high, 0, tone.shape[1])
        rows = np.arange(len(tone))[:, None]
        return np.asarray((total[rows, b] - total[rows, a]) / np.maximum(b - a, 1), dtype=np.float64)

    inner = mean(centre - half + 1, centre + half)
    left, right = mean(centre - half - side, centre - half), mean(centre + half + 1, centre + half + side + 1)
    up, down = inner - np.maximum(left, right), np.minimum(left, right) - inner
    stands = np.maximum(up, down)
    stands[np.abs(offset[centre]) > most[:, None]] = -np.inf
    best = np.argmax(stands, axis=1)
    rows = np.arange(len(tone))
    clear = stands[rows, best] > RIDGE_LEAST
    return offset[centre[0, best]], np.asarray(clear)
