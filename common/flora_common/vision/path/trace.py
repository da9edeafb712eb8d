"""The stem followed as a band round any bend, from a sure place on.

Lines that were thinned, and splines that are held smooth, cut a hook or end at its top. A band with two clean edges can
be followed round it: a step on along the circle that the last steps lie on, then to the middle between the edges. Where
it passes in front of a leaf, its edges are where the greener begins.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from flora_common.arrays import BoolArray, FloatArray
from flora_common.geometry import arc_length
from flora_common.vision.path.sampler import HALF_LIGHT_LEVEL, LEAF_GREENER, Sampler, places_along

STEP_WIDTHS: Final = 0.35
FITTED_WIDTHS, LEAST_FITTED_PX = 2.5, 8.0
"""The circle is that of so much of the line behind."""
THINNEST, WIDEST, WIDTH_FREE_PX = 0.6, 1.35, 0.5
"""A band with two edges counts as the stem between these shares of its width."""
MOST_OFF: Final = 0.45
"""In widths: how far the middle may lie from where the circle leads."""
BRIDGED_WIDTHS, BRIDGED_PX = 1.6, 2.0
"""Without an edge, as where a young leaf sits, it is followed so far and no farther."""
ONE_EDGE_SHARE: Final = 0.35
"""Where one edge is seen, what is bridged counts by this."""
ONE_EDGE_OFF: Final = 0.3
"""In widths: how far the middle by one edge may lie from where the circle leads."""
LONGEST_CM: Final = 6.0
ENDS_AT: Final = 0.5
"""Share of the evidence behind at which there is no plant any more."""
TIGHTEST_WIDTHS: Final = 0.9
"""Radius of the tightest bend."""
BENDS_TRIED: Final = np.linspace(-1.0, 1.0, 9)
AHEAD_WIDTHS: Final = np.array([0.6, 1.2])
ACROSS_WIDTHS: Final = np.array([-0.9, -0.25, 0.0, 0.25, 0.9])
OTHER_BEND_COST: Final = 0.25
"""In shares of full evidence: for the tightest bend, where the line behind is straight."""
_LEAF_FROM: Final = sum(LEAF_GREENER) / 2.0
"""Code units by which what comes is greener than what was, if it is more a leaf than not."""
GREEN_FOLLOWS: Final = 0.1
PULL: Final = 0.7
"""Share of the way to the middle that a step takes."""


def traced(line: FloatArray, width: float, sampler: Sampler, px_per_cm: float) -> tuple[FloatArray, BoolArray]:
    """Places beyond the end of a line, along the band that it ends in, (n, 2), n may be 0; and which have two edges.

    Args:
        line: shape (m, 2), m >= 2, px; sure up to its last point.
        width: of the stem there, px.
        sampler: of the picture.
        px_per_cm: scale.
    """
    width = max(width, 2.0)
    step = float(np.clip(STEP_WIDTHS * width, 1.0, 3.0))
    behind = max(4, round(max(LEAST_FITTED_PX, FITTED_WIDTHS * width) / step))
    s = arc_length(line)
    at = s[-1] - step * np.arange(behind)[::-1]
    at = at[at >= 0.0]
    if len(at) < 4:
        return np.zeros((0, 2)), np.zeros(0, dtype=np.bool_)
    places = list(places_along(line, s, at))
    along = step * np.arange(1 - len(places), 1)
    fit = np.linalg.pinv(np.stack([np.ones_like(along), along, along**2], axis=1))
    offset = np.arange(-1.5 * width - 2.0, 1.5 * width + 2.25, 0.5)
    across = width * np.array([-0.2, 0.0, 0.2])
    level = float(np.median(sampler.plant(np.array(places)[None])))
    green = float(np.median(sampler.green(np.array(places)[None])))
    kept, unclean, clean = len(places), 0.0, [True] * len(places)
    for _ in range(int(LONGEST_CM * px_per_cm / step)):
        _, slope, half_bend = fit @ np.array(places[-len(along) :])
        bend = 2.0 * float(slope[0] * half_bend[1] - slope[1] * half_bend[0]) / max(1e-9, float(slope @ slope) ** 1.5)
        heading = math.atan2(slope[1], slope[0])
        bend = _bend_on(places[-1], heading, bend, width, level, green, sampler)
        heading += 0.5 * bend * step
        place = places[-1] + step * np.array([math.cos(heading), math.sin(heading)])
        heading += 0.5 * bend * step
        normal = np.array([-math.sin(heading), math.cos(heading)])
        left, right = _edges(sampler.stem((place + offset[:, None] * normal)[None], green)[0], offset, level)
        if left > right:
            # all of it greener: followed as far as is bridged
            left, right = _edges(sampler.plant((place + offset[:, None] * normal)[None])[0], offset, level)
        if left > right:
            break
        middle, found = 0.5 * (left + right), right - left
        here = float(sampler.green((place + across[:, None] * normal)[None]).mean())
        fits = THINNEST * width - WIDTH_FREE_PX < found < WIDEST * width + WIDTH_FREE_PX
        if fits and abs(middle) < MOST_OFF * width and here < green + _LEAF_FROM:
            place = place + PULL * middle * normal
            unclean = 0.0
            green += GREEN_FOLLOWS * (here - green)
            width = min(width, 0.95 * width + 0.05 * found)
        else:
            nearer = min(left + 0.5 * width, right - 0.5 * width, key=abs)
            one = abs(nearer) < ONE_EDGE_OFF * width
            place = place + (0.5 * PULL * nearer * normal if one else 0.0)
            unclean += step * (ONE_EDGE_SHARE if one else 1.0)
            if unclean > BRIDGED_WIDTHS * width + BRIDGED_PX:
                break
        places.append(place)
        clean.append(unclean == 0.0)
        if unclean == 0.0:
            kept = len(places)
    some = slice(len(along), max(kept, len(along)))
    return np.array(places[some]).reshape(-1, 2), np.array(clean[some], dtype=np.bool_)


def _bend_on(
    place: FloatArray, heading: float, bend: float, width: float, level: float, green: float, sampler: Sampler
) -> float:
    """The bend, 1/px, on which a band of this width goes on best; that of the line behind where it does as well."""
    most = 1.0 / (TIGHTEST_WIDTHS * width)
    bends = np.append(np.clip(bend, -most, most), most * BENDS_TRIED)
    ahead = width * AHEAD_WIDTHS[None, :]
    angle = heading + 0.5 * bends[:, None] * ahead
    # the chord to a place on a circle leaves by half of the angle that the circle turns by there
    chord = ahead * np.sinc(0.5 * bends[:, None] * ahead / np.pi)
    middle = place + chord[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    turned = heading + bends[:, None] * ahead
    normal = np.stack([-np.sin(turned), np.cos(turned)], axis=-1)
    across = width * ACROSS_WIDTHS
    plant = sampler.stem(
        (middle[:, :, None, :] + across[None, None, :, None] * normal[:, :, None, :]).reshape(len(bends), -1, 2), green
    )
    share = np.minimum(1.0, plant.reshape(len(bends), len(AHEAD_WIDTHS), -1) / max(level, 1e-9))
    inside, outside = share[..., 1:-1].mean(axis=-1), 0.5 * (share[..., 0] + share[..., -1])
    worth = (inside - outside).mean(axis=1) - OTHER_BEND_COST * np.abs(bends - bends[0]) / most
    return float(bends[int(np.argmax(worth))])


def _edges(plant: FloatArray, offset: FloatArray, level: float) -> tuple[float, float]:
    """Where a band ends on the left and on the right, infinite where it does not; (1, -1) where there is no plant."""
    centre = len(offset) // 2
    top = float(plant[centre - 2 : centre + 3].max())
    if top < ENDS_AT * level:
        return 1.0, -1.0
    low = np.flatnonzero(plant < HALF_LIGHT_LEVEL * top)
    right, left = low[low >= centre], low[low <= centre]

    def crossing(outer: int, inner: int) -> float:
        share = (HALF_LIGHT_LEVEL * top - plant[outer]) / max(1e-9, plant[inner] - plant[outer])
        return float(offset[outer] + np.clip(share, 0.0, 1.0) * (offset[inner] - offset[outer]))

    a = crossing(int(left[-1]), int(left[-1]) + 1) if left.size else -math.inf
    b = crossing(int(right[0]), int(right[0]) - 1) if right.size else math.inf
    return (a, b) if a <= b else (b, a)
