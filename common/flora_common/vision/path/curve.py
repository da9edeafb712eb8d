"""A smooth line through the middle of the stem, and where it ends.

The chain of pieces says where the stem runs to about a pixel. Across it the picture is sampled again: the stem's two
edges give its middle to a fraction of a pixel. Where it lies on a leaf or behind one there are no two edges, and there
a ridge in brightness or, failing that, the smoothness of the curve must do.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from flora_common.geometry import FloatArray
from flora_common.vision.path import spline
from flora_common.vision.path.chain import Chain
from flora_common.vision.path.evidence import Evidence
from flora_common.vision.path.spline import Smoother, Spline
from flora_common.vision.path.survey import median

BoolArray = npt.NDArray[np.bool_]

STEP_PX: Final = 1.5
KNOT_CM: Final = 0.8
ROUGHNESS_CM: Final = 0.03
"""How far third differences of the spline's coefficients, 0.8 cm apart, usually are from 0."""
TIGHT_KNOT_CM, TIGHT_ROUGHNESS_CM = 0.4, 0.1
"""The same round a hook."""
BEND_BEGINS_CM: Final = 0.8
"""Before the place from which a band is followed."""
EDGE_ERROR_PX: Final = 0.35
ONE_EDGE_ERROR_PX: Final = 3.0
RIDGE_ERROR_PX: Final = 1.2
SKELETON_ERROR_PX: Final = 1.5
UNSEEN_ERROR_CM: Final = 0.3
"""Of the straight line across a gap: it keeps the curve from swinging out."""
ANCHOR_ERROR_CM: Final = 0.08
HALF: Final = 0.65
ROW_PX: Final = 1024
AGREE: Final = 0.15
"""In widths: how far the two edges' opinions on the middle may lie apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Stem:
    """A stem in a picture.

    Attributes:
        line: shape (n, 2), anchor first, tip last, px of the full picture, about a pixel apart.
        deviation: shape (n,), standard deviation of each place, px.
        seen: shape (n,), where both edges or a ridge were found.
        clean: shape (n,), where both edges were found, as far apart as the stem is wide.
        width: shape (n,), px; what the stem's width is taken to be there.
        across: shape (n,), px; what was measured of the width, worth something where ``clean``.
        length: along the line, px.
        bends_from: distance from the anchor, px, from which it bends more tightly than stems usually do.
    """

    line: FloatArray
    deviation: FloatArray
    seen: BoolArray
    clean: BoolArray
    width: FloatArray
    across: FloatArray
    length: float
    bends_from: float = math.inf


LEAF_GREENER: Final = (6.0, 14.0)
"""Code units, green against red, by which leaves are greener than the stem that bears them: from no leaf to surely one.
Colours differ from plant to plant and under other lamps; this does not depend on how much light falls on either."""


class Sampler:
    """Values of the evidence at places of the full picture, linear between pixels, 0 outside.

    Attributes:
        least: what has less evidence than this was taken for noise.
    """

    def __init__(self, evidence: Evidence) -> None:
        self.least = evidence.least
        self._plant, self._tone = evidence.plant, evidence.tone
        green, red = evidence.code[..., 1], evidence.code[..., 2]
        self._green = np.asarray(cv2.subtract(green, red, dtype=cv2.CV_32F), dtype=np.float32)
        self._origin = np.array(evidence.origin_px, dtype=np.float64)

    def plant(self, places: FloatArray) -> FloatArray:
        """Evidence of plant at places (..., 2)."""
        return self.plant_at(places[..., 0], places[..., 1])

    def plant_at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """The same at places whose coordinates are apart, which takes half as long for many."""
        return self._at(self._plant, x, y)

    def tone(self, places: FloatArray) -> FloatArray:
        """Brightness at places (..., 2)."""
        return self.tone_at(places[..., 0], places[..., 1])

    def tone_at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """The same at places whose coordinates are apart."""
        return self._at(self._tone, x, y)

    def green(self, places: FloatArray) -> FloatArray:
        """How much greener than red it is at places (..., 2)."""
        return self._at(self._green, places[..., 0], places[..., 1])

    def stem(self, places: FloatArray, green: float) -> FloatArray:
        """Evidence of plant at places (..., 2), but not of what is greener than a stem that is so green: a leaf."""
        return self.plant(places) * self.no_leaf(places, green)

    def no_leaf(self, places: FloatArray, green: float) -> FloatArray:
        """1 where it is as green as a stem at places (..., 2), 0 where it is as much greener as leaves are."""
        return np.clip((green + LEAF_GREENER[1] - self.green(places)) / (LEAF_GREENER[1] - LEAF_GREENER[0]), 0.0, 1.0)

    def _at(self, values: npt.NDArray[np.float32], x: FloatArray, y: FloatArray) -> FloatArray:
        if x.size == 0:
            return np.zeros(x.shape)
        # OpenCV takes no picture of places with more than 32767 rows or columns
        columns = min(x.size, ROW_PX)
        maps = np.zeros((2, -(-x.size // columns) * columns), np.float32)
        for one, v, origin in zip(maps, (x, y), self._origin, strict=True):
            np.subtract(v.ravel(), origin, out=one[: x.size], casting="same_kind")
        right, down = maps.reshape(2, -1, columns)
        found = cv2.remap(values, right, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        return np.asarray(found.ravel()[: x.size], dtype=np.float64).reshape(x.shape)


def along_chain(chain: Chain, sampler: Sampler, px_per_cm: float) -> Stem:
    """The smooth line of a chain of pieces."""
    s_raw = arc_length(chain.points)
    s = _steps(s_raw[-1])
    rough = np.column_stack([np.interp(s, s_raw, chain.points[:, k]) for k in range(2)])
    k = np.clip(np.searchsorted(s_raw, s, side="left"), 1, len(s_raw) - 1)
    on_piece = (chain.piece[k] == chain.piece[k - 1]) & (chain.piece[k] >= 0)
    return _refined(rough, on_piece, skeleton_width(chain, s_raw)(s), sampler, px_per_cm)


def along_line(
    line: FloatArray,
    upto_px: float,
    width_px: tuple[float, float],
    bends_from: float,
    sampler: Sampler,
    px_per_cm: float,
) -> Stem:
    """The smooth line along one that lies inside the stem.

    Args:
        line: shape (n, 2), px.
        upto_px: so far along it.
        width_px: of the stem, at the anchor and at the end of the line.
        bends_from: as in :class:`Stem`.
        sampler: of the picture.
        px_per_cm: scale.
    """
    s_raw = arc_length(line)
    s = _steps(min(upto_px, float(s_raw[-1])))
    rough = np.column_stack([np.interp(s, s_raw, line[:, k]) for k in range(2)])
    width = np.interp(s, [0.0, s_raw[-1]], width_px)
    known = np.ones(len(s), dtype=np.bool_)
    return _refined(rough, known, width, sampler, px_per_cm, bends_from=bends_from)


def with_tip(stem: Stem, safe: int, beyond: FloatArray, sampler: Sampler, px_per_cm: float) -> Stem:
    """The line up to a point, and from there along given places to the tip.

    Args:
        stem: line of the chain.
        safe: index of the last point that is kept.
        beyond: shape (n, 2), places that go on from there.
        sampler: of the picture.
        px_per_cm: scale.
    """
    rough, known, width, kept = _going_on(stem, safe, beyond)
    return _refined(rough, known, width, sampler, px_per_cm, apex_from=kept, bends_from=stem.bends_from, times=1)


def round_bend(stem: Stem, safe: int, band: FloatArray, sampler: Sampler, px_per_cm: float) -> Stem:
    """The line up to a point, and from there along a band that was followed round a bend, both measured.

    Args:
        stem: line of the chain.
        safe: index of the last point that is kept.
        band: shape (n, 2), places that go on from there.
        sampler: of the picture.
        px_per_cm: scale.
    """
    rough, known, width, kept = _going_on(stem, safe, band)
    bends_from = max(0.0, kept - BEND_BEGINS_CM * px_per_cm)
    return _refined(rough, known, width, sampler, px_per_cm, bends_from=bends_from)


def _going_on(stem: Stem, safe: int, beyond: FloatArray) -> tuple[FloatArray, BoolArray, FloatArray, float]:
    """A line up to a point and then along given places, in even steps: places, which count as seen, widths; and how far
    along, px, that point is."""
    raw = np.concatenate([stem.line[: safe + 1], beyond])
    s_raw = arc_length(raw)
    keep = np.concatenate([[True], np.diff(s_raw) > 1e-6])
    raw, s_raw = raw[keep], s_raw[keep]
    s = _steps(s_raw[-1])
    rough = np.column_stack([np.interp(s, s_raw, raw[:, k]) for k in range(2)])
    old = arc_length(stem.line)
    known = np.interp(s, old[: safe + 1], stem.seen[: safe + 1].astype(float)) > 0.5
    return rough, known | (s > old[safe]), np.interp(s, old, stem.width), float(old[safe])


def _steps(length: float) -> FloatArray:
    return np.linspace(0.0, length, max(8, int(length / STEP_PX) + 1))


def _refined(
    rough: FloatArray,
    known: BoolArray,
    width: FloatArray,
    sampler: Sampler,
    px_per_cm: float,
    *,
    apex_from: float = math.inf,
    bends_from: float = math.inf,
    times: int = 2,
) -> Stem:
    """Fit, then so many times measure across and fit again.

    ``known`` says where the rough line itself is worth something. From ``apex_from`` on nothing is measured: young
    leaves stand beside the stem there and move what look like its edges, by more than it bends over so short a way.
    """
    anchor, s = rough[0], arc_length(rough)
    knot, roughness = _stiffness(float(s[-1]), px_per_cm, bends_from)
    at_anchor, at_end = 1.0 / (ANCHOR_ERROR_CM * px_per_cm) ** 2, 1.0 / SKELETON_ERROR_PX**2
    unsure = 1.0 / (UNSEEN_ERROR_CM * px_per_cm) ** 2
    weights = np.where(known, at_end, unsure)
    weights[0], weights[-1] = at_anchor, at_end
    smoother = spline.Smoother(s, knot_step=knot, roughness=roughness)
    curve = smoother.fit(rough, weights)
    line = smoother.places(curve)
    for _ in range(times):
        found = _measured(line, s, width, sampler, apex_from)
        width = _model_width(s, found, width)
        places = np.where(found.seen[:, None], found.places, rough)
        # neighbours share their pixels and are not independent
        weights = np.where(
            found.seen, 0.5 * STEP_PX / found.error**2, np.where(s > apex_from, 0.2 * at_end, 0.1 * unsure)
        )
        places[0], weights[0] = anchor, at_anchor
        weights[-1] = max(weights[-1], 0.25 * at_end)
        curve = _robust(smoother, places, weights)
        line = smoother.places(curve)
    return Stem(
        line,
        smoother.deviation(curve),
        found.seen,
        found.clean,
        width,
        found.width,
        float(arc_length(line)[-1]),
        bends_from,
    )


def _stiffness(length: float, px_per_cm: float, bends_from: float) -> tuple[float, FloatArray]:
    """Distance of the spline's knots, px, and its roughness, one for each of the third differences."""
    usual = min(KNOT_CM * px_per_cm, length / 4.0)
    tight = min(TIGHT_KNOT_CM * px_per_cm, length / 4.0)
    knot = usual if bends_from > length else tight
    # the same curve has third differences in proportion to the cube of the knots' distance
    stiff = ROUGHNESS_CM * px_per_cm * (knot / usual) ** 3
    middle = (np.arange(spline.coefficients(length, knot) - 3) + 0.5) * knot
    return knot, np.where(middle < bends_from, stiff, max(stiff, TIGHT_ROUGHNESS_CM * px_per_cm))


def _model_width(s: FloatArray, found: _Across, before: FloatArray) -> FloatArray:
    """The stem's width from its clean stretches: a straight line over s that does not rise towards the tip."""
    if found.clean.sum() < 12:
        return before
    at, w = s[found.clean], found.width[found.clean]
    for _ in range(2):
        from_middle = at - at.mean()
        slope = min(0.0, float(from_middle @ w) / max(1e-9, float(from_middle @ from_middle)))
        levels = w - slope * at
        off = np.abs(levels - median(levels))
        near = off <= max(0.5, 2.0 * float(median(off)))
        at, w = at[near], w[near]
    level = float(median(w - slope * at))
    return np.asarray(np.maximum(level + slope * s, 0.45 * level), dtype=np.float64)


def _robust(smoother: Smoother, places: FloatArray, weights: FloatArray) -> Spline:
    """Fit twice: what lies far off for its error counts less the second time (Huber's weights)."""
    first = smoother.places(smoother.fit(places, weights))
    off = np.hypot(*(first - places).T) * np.sqrt(weights)
    scale = max(1.0, 1.5 * float(median(off[weights > 0])))
    return smoother.fit(places, weights * np.minimum(1.0, 2.0 * scale / np.maximum(off, 1e-9)))


def skeleton_width(chain: Chain, s_raw: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """A first guess of the stem's width over the distance from the anchor: that of the lower third, and no wider."""
    known = np.isfinite(chain.width)
    w = chain.width[known]
    base = float(np.median(w[: max(4, len(w) // 3)])) if len(w) else 3.0
    upper = float(np.clip(np.median(w[-max(4, len(w) // 3) :]), 0.5 * base, base)) if len(w) else base
    return lambda s: np.maximum(base + (upper - base) * s / max(s_raw[-1], 1.0), 1.2)


@dataclass(frozen=True, slots=True, eq=False)
class _Across:
    """What was found across the line at each s: places (n, 2), errors (n,) and widths (n,) in px."""

    places: FloatArray
    error: FloatArray
    width: FloatArray
    seen: BoolArray
    clean: BoolArray


def _measured(line: FloatArray, s: FloatArray, width: FloatArray, sampler: Sampler, apex_from: float) -> _Across:
    """The stem's middle at each s up to ``apex_from`` by its edges or by a ridge."""
    upto = int(np.searchsorted(s, apex_from, side="right"))
    some, normal, width = line[:upto], normals(line)[:upto], width[:upto]
    reach = 1.6 * float(width.max()) + 2.0
    offset = np.arange(-reach, reach + 0.25, 0.5)
    x, y = (some[:, k, None] + offset * normal[:, k, None] for k in range(2))
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
    return _Across(
        np.concatenate([some + middle[:, None] * normal, line[upto:]]),
        np.pad(error, more, constant_values=EDGE_ERROR_PX),
        np.pad(right - left, more),
        np.pad(clean | one_edge | ridge, more),
        np.pad(clean, more),
    )


def _edges(plant: FloatArray, offset: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Where the evidence falls to half on the left and on the right, and whether it does on both sides."""
    n, m = plant.shape
    middle = m // 2
    level = HALF * np.max(plant[:, middle - 2 : middle + 3], axis=1, keepdims=True)
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


RIDGE_LEAST: Final = 8.0
"""In code units: how much a stem must stand out on a leaf to be believed there."""


def normals(line: FloatArray) -> FloatArray:
    """Unit vectors across a line (n, 2)."""
    tangent = np.gradient(line, axis=0)
    tangent /= np.maximum(np.hypot(tangent[:, 0], tangent[:, 1]), 1e-9)[:, None]
    return np.column_stack([-tangent[:, 1], tangent[:, 0]])


def arc_length(line: FloatArray) -> FloatArray:
    """Distance along a line (n, 2) from its first point, shape (n,)."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
