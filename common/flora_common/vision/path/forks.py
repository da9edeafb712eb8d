"""Whether a line that was found for the stem turned into a petiole at a fork.

Where a petiole goes on as straight as the stem, neither direction nor colour tells which is which. But a petiole
carries one blade and then ends, and a stem goes on to bear further leaves. So the plant is taken apart along the line:
what hangs at its sides, where, and how far it reaches out. A line from which nothing branches off any more beyond a
fork, that is thinner there than below, and then widens, is likely a petiole with its blade, and what else begins at
that fork may be the stem.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from flora_common.arrays import FloatArray
from flora_common.geometry import arc_length
from flora_common.vision.path.sampler import normals, places_along
from flora_common.vision.path.strands import Strands

STEP_CM: Final = 0.1
"""The line is looked at in steps of this length."""
LEAST_BESIDE_CM: Final = 1.0
"""What may be the stem reaches out from the line by more than this."""
LEAST_AHEAD_CM: Final = 1.5
"""A line that goes on by less beyond a fork is no petiole with its blade."""
LOWEST_CM: Final = 1.0
"""No stem forks lower."""
BRANCHES_CM, BRANCHES_SHARE = 0.25, 0.4
"""What reaches out by more than the first, and by more than this share of the length over which it sits on the line, is
a branch, as young leaves round an apex are; else it is half of a blade through which the line runs."""
NODE_CM: Final = 0.3
"""Leaves that sit on the line nearer to a fork than this belong to it."""
SPECK_CM: Final = 0.08
"""What is smaller than a square of this side is no branch."""
STALK_CM, BELOW_CM = 0.8, 1.0
"""How far above and below a fork the width is that of what goes on and of what bears it."""
NARROWER: Final = 0.9
"""A petiole is thinner than the stem below by this share. Leaves before or beside a stem make it look so, too, and its
end wider; few do both and leave it bare otherwise."""
BLADE_CM, WIDENS, MOST_OF_IT = 1.2, (1.2, 1.3), 85
"""The line is wider than the stalk by the first factor over so much of it, and by the second at this percentile: blades
begin and end in a point."""
WIDER_CM: Final = 0.02
"""And by so much more, for masks are of whole pixels."""
FARTHEST_CM: Final = 1.2
"""So far to either side widths are measured."""
DOUBT_AGAIN, LONGEST_DOUBT = 3, 12
"""What is a petiole in one picture out of a few is one: leaves that turn hide now and then what tells it."""


@dataclass(frozen=True, slots=True)
class _Beside:
    """What hangs at the line's side: over which distances from the anchor, and how far it reaches out, all in cm."""

    low: float
    high: float
    out: float

    @property
    def branches(self) -> bool:
        return self.out > max(BRANCHES_CM, BRANCHES_SHARE * (self.high - self.low))


def petiole_from(line: FloatArray, strands: Strands, px_per_cm: float) -> float:
    """Distance from the anchor, px, from which on a line is likely a petiole with its blade; infinite where it is not.

    Args:
        line: shape (n, 2), px of the full picture, anchor first.
        strands: with the plant's mask.
        px_per_cm: scale.
    """
    s = arc_length(line)
    at = np.arange(0.0, s[-1], STEP_CM * px_per_cm)
    if at[-1] < (LOWEST_CM + LEAST_AHEAD_CM) * px_per_cm:
        return math.inf
    places = places_along(line, s, at)
    at_cm, end_cm = at / px_per_cm, float(s[-1]) / px_per_cm
    width = _widths(places, strands, px_per_cm)
    beside = _beside(line, places, float(np.percentile(width[at_cm > 0.5 * LOWEST_CM], 30)), strands, px_per_cm)
    for one in beside:
        # what sits on the line over a short way begins where it leaves it, what lies along it where it reaches it
        foot = one.high if one.out > one.high - one.low else one.low
        if one.out < LEAST_BESIDE_CM or not LOWEST_CM < foot < end_cm - LEAST_AHEAD_CM:
            continue
        if any(other.low > foot + NODE_CM and other.branches for other in beside):
            continue
        ahead = width[at_cm > foot + STEP_CM]
        stalk = float(np.median(ahead[: max(3, round(min(STALK_CM, 0.4 * (end_cm - foot)) / STEP_CM))]))
        below = width[(at_cm > one.low - BELOW_CM) & (at_cm < one.low - STEP_CM)]
        if not below.size or stalk > NARROWER * float(np.median(below)):
            continue
        wider = ahead - WIDER_CM * px_per_cm
        blade_cm = STEP_CM * np.count_nonzero(wider > WIDENS[0] * stalk)
        if blade_cm > BLADE_CM and float(np.percentile(wider, MOST_OF_IT)) > WIDENS[1] * stalk:
            return foot * px_per_cm
    return math.inf


def doubted_for(before: int, *, is_petiole: bool) -> int:
    """How many more clear pictures a line is doubted for, after a picture in which it is, or is not, a petiole.

    Args:
        before: the same after the picture before; 0 where the line ends elsewhere than it did.
        is_petiole: in this one.
    """
    return min(LONGEST_DOUBT, before + DOUBT_AGAIN) if is_petiole else max(0, before - 1)


def _widths(places: FloatArray, strands: Strands, px_per_cm: float) -> FloatArray:
    """How wide the plant is across a line at its places, px, freed of single steps."""
    normal = normals(places)
    away = np.arange(0.0, FARTHEST_CM * px_per_cm, 0.5)
    height, breadth = strands.mask.shape
    width = np.zeros(len(places))
    for side in (-1.0, 1.0):
        x, y = (
            np.rint(places[:, k, None] + side * away * normal[:, k, None] - strands.origin_px[k]).astype(int)
            for k in range(2)
        )
        inside = (x >= 0) & (x < breadth) & (y >= 0) & (y < height)
        nothing = ~inside | (strands.mask[np.clip(y, 0, height - 1), np.clip(x, 0, breadth - 1)] == 0)
        nothing[:, -1] = True
        width += 0.5 * np.argmax(nothing, axis=1)
    some = np.lib.stride_tricks.sliding_window_view(np.pad(width, 1, mode="edge"), 3)
    return np.asarray(np.median(some, axis=1), dtype=np.float64)


def _beside(line: FloatArray, places: FloatArray, width: float, strands: Strands, px_per_cm: float) -> list[_Beside]:
    """What hangs at the line's sides, from the anchor on, if the line is as wide as ``width``, px, all along."""
    width = max(2.0, width)
    corners = [np.round((line - strands.origin_px) * 8).astype(np.int32)]
    band, off_line = np.zeros_like(strands.mask), np.ones_like(strands.mask)
    cv2.polylines(band, corners, False, 1, round(1.2 * width + 1.0), cv2.LINE_8, 3)
    cv2.polylines(off_line, corners, False, 0, 1, cv2.LINE_8, 3)
    rest = np.asarray(cv2.subtract(strands.mask, band), dtype=np.uint8)
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(rest, connectivity=8)
    away = cv2.distanceTransform(off_line, cv2.DIST_L2, cv2.DIST_MASK_3)
    rows, columns = np.nonzero(
        cv2.bitwise_and(np.asarray(cv2.dilate(band, np.ones((5, 5), np.uint8)), dtype=np.uint8), rest)
    )
    label = labels[rows, columns]
    found = []
    for k in np.unique(label):
        if statistics[k, cv2.CC_STAT_AREA] < (SPECK_CM * px_per_cm) ** 2:
            continue
        x, y = (v[label == k] + origin for v, origin in zip((columns, rows), strands.origin_px, strict=True))
        nearest = np.argmin((x[:, None] - places[:, 0]) ** 2 + (y[:, None] - places[:, 1]) ** 2, axis=1)
        low, high = STEP_CM * np.percentile(nearest, [3, 97])
        left, top, wide, high_px = (int(v) for v in statistics[k][:4])
        part = slice(top, top + high_px), slice(left, left + wide)
        out = float(np.max(away[part], where=labels[part] == k, initial=0.0)) - 0.5 * width
        found.append(_Beside(float(low), float(high), out / px_per_cm))
    return sorted(found, key=lambda one: one.low)
