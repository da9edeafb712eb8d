"""What of a stem never moves, in an empty setup that is learnt from the plant's pictures, and what is put in its place.

The foot of a stem stays where it is. A stem is narrow, stands out from what is round it, and leads from the anchor to
where the plant moves: to the nearest place of each area that does, and to the farthest of all, there is a cheapest way
(Dijkstra 1959) over what stands out or moves. What stands out along these ways and does not move, and what is greener
than its surroundings beside them, is stem. Leaves that never move may stay: nobody looks for them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np

from flora_common.arrays import BoolArray, ByteArray, Float32Array, IntArray
from flora_common.vision.path.cheapest_ways import cheapest_ways

STAYS: Final = 12.0
"""In code units: what stands out from its surroundings by this, or is greener by it, may be plant."""
LEAST_AREA, LEAST_PART = 2.0, 1.0
"""Squares of the widest stem's width: smaller areas that come and go are noise; so much counts beside a larger one."""
APART: Final = 4.0
"""Widths of the widest stem between two areas of one plant at most: between leaves and tip the stem hardly moves."""
PLAIN, LEAST_COST = 40.0, 0.05
"""Code units by which a stem stands out that is plain to see, and what is added for where nothing does."""
BESIDE: Final = 1.5
"""Widths of the widest stem to either side of a way within which what is greener is stem."""
ACROSS_PX: Final = 10.0
"""Ways are looked for at a scale at which the widest stem is that wide at most."""


def replace(empty: ByteArray, moves: ByteArray, anchor_px: tuple[float, float], widest_px: float) -> None:
    """Put the surroundings in place of the part of a stem that never moves; changes ``empty``.

    Args:
        empty: what the setup is taken for so far, in logarithmic code, shape (height, width, 3).
        moves: 1 where something plant-like comes and goes, shape (height, width).
        anchor_px: where the stem leaves the soil.
        widest_px: no stem is wider.
    """
    plant = _moving_plant(moves, anchor_px, widest_px)
    if not plant:
        return
    anchor = round(anchor_px[0]), round(anchor_px[1])
    margin = round(BESIDE * widest_px)
    corners = np.vstack([*plant, [anchor]])
    left, top = np.maximum(corners.min(axis=0) - margin, 0)
    right, bottom = corners.max(axis=0) + margin + 1
    rows, columns = slice(top, bottom), slice(left, right)
    side = min(255, max(5, round(2.5 * widest_px)) | 1)
    around = np.asarray(cv2.medianBlur(empty, side)[rows, columns], dtype=np.uint8)
    part, still = empty[rows, columns], moves[rows, columns] == 0
    out = np.asarray(cv2.absdiff(part, around).max(axis=-1), dtype=np.float32)
    ends = [*(area[0] for area in plant), max((area[-1] for area in plant), key=lambda place: math.dist(place, anchor))]
    ways = _ways(np.where(still, out, PLAIN), np.array([anchor, *ends]) - [left, top], widest_px)
    green = (greenness(part) - greenness(around) > STAYS).astype(np.uint8)
    foot = _near(ways, out.shape, widest_px) & (out > STAYS) & still
    foot |= _near(ways, out.shape, 2.0 * BESIDE * widest_px) & (cv2.dilate(green, np.ones((3, 3), np.uint8)) > 0)
    part[foot] = around[foot]


def greenness(code: ByteArray) -> Float32Array:
    """Green and yellow, in code units; shape (..., 3) to (...)."""
    b, g, r = (code[..., k].astype(np.float32) for k in range(3))
    return np.asarray(1.5 * (g - 0.5 * (b + r)) + 0.6 * (0.5 * (g + r) - b))


def _moving_plant(moves: ByteArray, anchor_px: tuple[float, float], widest_px: float) -> list[IntArray]:
    """Where the plant at the anchor moves: the nearest large area, and what is about that; the places of each of shape
    (n, 2), (x, y) px, nearest first.

    Noise moves in small areas, and in the dark at the margin; another plant is farther off.
    """
    _, labels, stats, _ = cv2.connectedComponentsWithStats(moves)
    area = stats[:, cv2.CC_STAT_AREA] / widest_px**2
    area[0] = 0.0  # where nothing moves
    parts = area[labels] >= LEAST_PART
    row, column = np.nonzero(parts)
    places, label = np.stack([column, row], axis=1), labels[row, column]
    away = np.hypot(*(places - anchor_px).T)
    large = area[label] >= LEAST_AREA
    if not large.any():
        return []
    first = int(np.argmin(np.where(large, away, np.inf)))
    reach = 2 * round(0.5 * APART * widest_px) + 1
    _, groups = cv2.connectedComponents(cv2.dilate(parts.astype(np.uint8), np.ones((reach, reach), np.uint8)))
    mine = groups[row, column] == groups[row[first], column[first]]
    order = np.argsort(away, kind="stable")
    return [places[order][label[order] == one] for one in np.unique(label[mine])]


def _ways(out: Float32Array, places: IntArray, widest_px: float) -> list[IntArray]:
    """The cheapest ways from the first place to the others, each of shape (n, 2), (x, y) px.

    Args:
        out: by how much each place stands out, shape (height, width).
        places: shape (n, 2), (x, y) px.
        widest_px: no stem is wider.
    """
    scale = min(1.0, ACROSS_PX / widest_px)
    size = max(1, round(scale * out.shape[1])), max(1, round(scale * out.shape[0]))
    seen = cv2.resize(np.minimum(out / PLAIN, 1.0), size, interpolation=cv2.INTER_AREA)
    columns, rows = np.clip((scale * places).astype(np.int64), 0, np.array(size) - 1).T
    start, *ends = zip(rows.tolist(), columns.tolist(), strict=True)
    found = cheapest_ways(1.0 / (seen.astype(np.float64) + LEAST_COST), start, ends)
    return [np.rint((way[:, ::-1] + 0.5) / scale - 0.5).astype(np.int64) for way in found if way is not None]


def _near(ways: Sequence[IntArray], shape: tuple[int, ...], wide_px: float) -> BoolArray:
    """What lies in a band of that width about the ways."""
    band = np.zeros(shape, np.uint8)
    cv2.polylines(
        band, [way.astype(np.int32) for way in ways], isClosed=False, color=1, thickness=max(1, round(wide_px))
    )
    return band > 0
