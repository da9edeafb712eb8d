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

import numpy as np

from flora_common.arrays import BoolArray, FloatArray
from flora_common.geometry import arc_length
from flora_common.vision.path import spline
from flora_common.vision.path.across import Across, measured
from flora_common.vision.path.chain import Chain
from flora_common.vision.path.sampler import Sampler, places_along
from flora_common.vision.path.spline import Smoother, Spline
from flora_common.vision.path.survey import median

STEP_PX: Final = 1.5
KNOT_CM: Final = 0.8
ROUGHNESS_CM: Final = 0.03
"""How far third differences of the spline's coefficients, 0.8 cm apart, usually are from 0."""
TIGHT_KNOT_CM, TIGHT_ROUGHNESS_CM = 0.4, 0.1
"""The same round a hook."""
BEND_BEGINS_CM: Final = 0.8
"""Before the place from which a band is followed."""
SKELETON_ERROR_PX: Final = 1.5
UNSEEN_ERROR_CM: Final = 0.3
"""Of the straight line across a gap: it keeps the curve from swinging out."""
ANCHOR_ERROR_CM: Final = 0.08


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


def along_chain(chain: Chain, sampler: Sampler, px_per_cm: float) -> Stem:
    """The smooth line of a chain of pieces."""
    s_raw = arc_length(chain.points)
    s = _steps(s_raw[-1])
    rough = places_along(chain.points, s_raw, s)
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
    unseen_cm: float = UNSEEN_ERROR_CM,
) -> Stem:
    """The smooth line along one that lies inside the stem.

    Args:
        line: shape (n, 2), px.
        upto_px: so far along it.
        width_px: of the stem, at the anchor and at the end of the line.
        bends_from: as in :class:`Stem`.
        sampler: of the picture.
        px_per_cm: scale.
        unseen_cm: standard deviation of the line where nothing is measured across it.
    """
    s_raw = arc_length(line)
    s = _steps(min(upto_px, float(s_raw[-1])))
    rough = places_along(line, s_raw, s)
    width = np.interp(s, [0.0, s_raw[-1]], width_px)
    known = np.ones(len(s), dtype=np.bool_)
    return _refined(rough, known, width, sampler, px_per_cm, bends_from=bends_from, unseen_cm=unseen_cm)


def with_tip(
    stem: Stem,
    safe: int,
    beyond: FloatArray,
    sampler: Sampler,
    px_per_cm: float,
    unseen_cm: float = UNSEEN_ERROR_CM,
) -> Stem:
    """The line up to a point, and from there along given places to the tip.

    Args:
        stem: line of the chain.
        safe: index of the last point that is kept.
        beyond: shape (n, 2), places that go on from there.
        sampler: of the picture.
        px_per_cm: scale.
        unseen_cm: standard deviation, across the stem, of places where it was not seen.
    """
    rough, known, width, kept = _going_on(stem, safe, beyond)
    return _refined(
        rough,
        known,
        width,
        sampler,
        px_per_cm,
        apex_from=kept,
        bends_from=stem.bends_from,
        unseen_cm=unseen_cm,
        times=1,
    )


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
    rough = places_along(raw, s_raw, s)
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
    unseen_cm: float = UNSEEN_ERROR_CM,
    times: int = 2,
) -> Stem:
    """Fit, then so many times measure across and fit again.

    ``known`` says where the rough line itself is worth something. From ``apex_from`` on nothing is measured: young
    leaves stand beside the stem there and move what look like its edges, by more than it bends over so short a way.
    """
    anchor, s = rough[0], arc_length(rough)
    knot, roughness = _stiffness(float(s[-1]), px_per_cm, bends_from)
    at_anchor, at_end = 1.0 / (ANCHOR_ERROR_CM * px_per_cm) ** 2, 1.0 / SKELETON_ERROR_PX**2
    unsure = 1.0 / (unseen_cm * px_per_cm) ** 2
    weights = np.where(known, at_end, unsure)
    weights[0], weights[-1] = at_anchor, at_end
    smoother = spline.Smoother(s, knot_step=knot, roughness=roughness)
    curve = smoother.fit(rough, weights)
    line = smoother.places(curve)
    for _ in range(times):
        found = measured(line, s, width, sampler, apex_from)
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


def _model_width(s: FloatArray, found: Across, before: FloatArray) -> FloatArray:
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
