"""Pieces of plant as they may follow each other: where they begin and end, in which direction, how wide.

The numbers are what one would believe, not what fits one set of pictures.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.geometry import unit
from flora_common.vision.path.strands import Strand

DIRECTION_OVER_CM: Final = 0.7
SURE_OF_DIRECTION_CM: Final = 0.6
"""A piece shorter than this points anywhere; its turning counts in proportion."""
BEND_COST: Final = 0.2
"""Per square of curvature (1/cm) and cm: stems bend less than the edges of leaves."""
BEND_OVER_CM: Final = 0.4
ON_LEAF_COST: Final = 0.2
"""Share that a band on a leaf is worth less: it may be one of the leaf's veins."""
WIDER, WIDER_PX = 1.25, 1.5
LEAF_LIKE_COST: Final = 1.6
KNOWS_WIDTH_CM: Final = 1.0
GREEN_OVER_CM: Final = 0.8
GREENER, GREENER_BY = 8.0, 8.0
"""Code units: a piece that is greener than the end of the one before it by the first may be a leaf, and by both is."""
LEAF_COLOURED_COST: Final = 1.3


class Node:
    """A strand in one direction, with what the links need."""

    def __init__(self, index: int, strand: Strand, px_per_cm: float, other: Node | None = None) -> None:
        """``other``: the same strand in the other direction, whose figures that know no direction are taken over."""
        self.index, self.strand = index, strand
        p = strand.points
        reach = max(3, round(DIRECTION_OVER_CM * px_per_cm))
        w = np.maximum(strand.width, 0.8)
        if other is None:
            self.usual_width, self.green = upper_median(w), upper_median(strand.green)
            self.length_cm = strand.length / px_per_cm
            self.reward = self.length_cm * (1.0 - ON_LEAF_COST * strand.on_leaf)
            self.reward -= BEND_COST * _bending(p, px_per_cm)
            self._half_width = round(upper_median(strand.width) / 2)
        else:
            self.usual_width, self.green = other.usual_width, other.green
            self.length_cm, self.reward, self._half_width = other.length_cm, other.reward, other._half_width
        # thinning bends the last half width of a line towards what it meets there
        skip = min(self._half_width, len(p) // 4)
        k = min(reach, len(p) - 1 - skip)
        self.start, self.end = p[0], p[-1]
        self.start_direction = unit(p[k] - p[skip])
        self.end_direction = unit(p[-1 - skip] - p[-1 - k])
        middle = slice(min(2, len(p) // 3), max(3, len(p) - 2))
        self.start_width, self.end_width = upper_median(w[middle][: 2 * k]), upper_median(w[middle][-2 * k :])
        self.start_strength = upper_median(strand.strength[: 2 * skip + 3])
        self.end_strength = upper_median(strand.strength[-2 * skip - 3 :])
        near = max(3, round(GREEN_OVER_CM * px_per_cm))
        self.start_green, self.end_green = upper_median(strand.green[:near]), upper_median(strand.green[-near:])
        # a thin line has some of the colour of what is behind it
        self._knows_green = min(1.0, max(0.0, 0.5 * (self.usual_width - 1.5))) * min(
            1.0, self.length_cm / GREEN_OVER_CM
        )
        self._widths = w
        self._leaf_like: dict[int, float] = {}
        self.sure = min(1.0, self.length_cm / SURE_OF_DIRECTION_CM)

    def reward_after(self, longest: Node, before: Node) -> float:
        """What is seen of the stem if this is some of it: where it is wider, or greener, than below, it is a leaf.

        ``longest`` is the longest piece below, which knows the stem's width, ``before`` the last one, which knows its
        colour: that may change along a stem, but not at once.
        """
        reward = self.reward
        if longest.length_cm >= KNOWS_WIDTH_CM:
            reward *= 1.0 - LEAF_LIKE_COST * self._wider_than(longest)
        if reward > 0.0:
            greener = min(1.0, max(0.0, (self.green - before.end_green - GREENER) / GREENER_BY))
            reward *= 1.0 - LEAF_COLOURED_COST * greener * min(self._knows_green, before._knows_green)
        return reward

    def _wider_than(self, longest: Node) -> float:
        """Share of it that is as much wider than another piece as leaves are."""
        known = self._leaf_like.get(longest.index)
        if known is None:
            wide = (self._widths - WIDER_PX) / longest.usual_width
            known = float(np.minimum(np.maximum((wide - WIDER) / 0.3, 0.0), 1.0).mean())
            self._leaf_like[longest.index] = known
        return known


def upper_median(v: FloatArray) -> float:
    """The upper median of few values; numpy's own takes ten times as long."""
    ordered = v.copy()
    ordered.sort()
    return float(ordered[len(v) // 2])


def angle(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angle between unit vectors, radians."""
    return np.asarray(np.arccos(np.clip((a * b).sum(axis=-1), -1.0, 1.0)), dtype=np.float64)


def _bending(points: FloatArray, px_per_cm: float) -> float:
    """Integral of the squared curvature along a piece, 1/cm."""
    step = max(2, round(BEND_OVER_CM * px_per_cm))
    if len(points) <= 2 * step:
        return 0.0
    chord = points[step:] - points[:-step]
    angle = np.unwrap(np.arctan2(chord[:, 1], chord[:, 0]))
    length = np.hypot(*np.diff(points, axis=0).T).mean() / px_per_cm
    curvature = (angle[step:] - angle[:-step]) / (step * length)
    return float((curvature**2).sum() * length)
