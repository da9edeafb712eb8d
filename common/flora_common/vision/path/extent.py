"""How far a line goes: cut or carried on to a length, in cm, and points along it.

A stem may be longer than it looks behind a leaf, but not before the bare board.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.geometry import arc_length
from flora_common.runs import CameraSection
from flora_common.shapes import STEM_POINTS
from flora_common.vision.path.curve import STEP_PX, Stem
from flora_common.vision.path.sampler import Sampler, places_along
from flora_common.vision.path.tip import Tip

FLOOR_MM: Final = 0.2
"""Of the uncertainty: light from one side moves both edges, by a tenth of a millimetre to three."""

BARE_CM: Final = 0.1
"""Where over so much of the way ahead there is no plant, a stem ends there, or is too pale to tell."""


def within_plant(tip: Tip, sampler: Sampler, px_per_cm: float) -> Tip:
    """The tip with no more of the way ahead than there is plant on, but for :data:`BARE_CM`.

    Args:
        tip: as it was found.
        sampler: of the picture.
        px_per_cm: scale.
    """
    if not len(tip.onwards):
        return tip
    ahead_px = arc_length(tip.onwards)
    is_plant = sampler.plant(tip.onwards) > 0.0
    last_px = np.maximum.accumulate(np.where(is_plant, ahead_px, 0.0))
    bare = np.flatnonzero(ahead_px - last_px > BARE_CM * px_per_cm)
    return replace(tip, onwards=tip.onwards[: bare[0]]) if len(bare) else tip


def as_long_as(stem: Stem, tip: Tip, wanted_px: float) -> Stem:
    """The stem cut or carried on to a length."""
    s = arc_length(stem.line)
    if wanted_px <= s[-1] or not len(tip.onwards):
        wanted_px = min(wanted_px, s[-1])
        keep = max(4, int(np.searchsorted(s, wanted_px)))
        end = places_along(stem.line, s, np.array([wanted_px]))
        line = np.concatenate([stem.line[:keep], end])
        pick = np.minimum(np.arange(len(line)), len(s) - 1)
        deviation, seen = stem.deviation[pick], stem.seen[pick]
    else:
        # from where the smooth line ends, not from where the arc did
        more = tip.onwards - (tip.places[-1] if len(tip.places) else stem.line[tip.safe]) + stem.line[-1]
        more = np.concatenate([stem.line[-1:], more])
        further = s[-1] + arc_length(more)
        # in steps as long as those of the line, and the last one shorter
        at = np.append(np.arange(s[-1] + STEP_PX, wanted_px, STEP_PX), wanted_px)
        at = at[at <= further[-1]]
        line = np.concatenate([stem.line, places_along(more, further, at)])
        extra = len(line) - len(stem.line)
        grown = stem.deviation[-1] + 0.15 * (arc_length(line)[-extra:] - s[-1]) if extra else np.zeros(0)
        deviation = np.concatenate([stem.deviation, grown])
        seen = np.concatenate([stem.seen, np.zeros(extra, dtype=np.bool_)])
        pick = np.minimum(np.arange(len(line)), len(s) - 1)
    return Stem(
        line, deviation, seen, stem.clean[pick] & seen, stem.width[pick], stem.across[pick], float(arc_length(line)[-1])
    )


def in_cm(line_px: FloatArray, camera: CameraSection) -> FloatArray:
    """A line (n, 2) of the picture in cm from the anchor, y up; its first point is the anchor."""
    line = (line_px - np.array(camera.anchor_px)) * np.array([1.0, -1.0]) / camera.px_per_cm + 0.0
    line[0] = 0.0
    return np.asarray(line, dtype=np.float64)


def by_arc(line_cm: FloatArray) -> FloatArray:
    """Ten points evenly spaced along the stem."""
    s = arc_length(line_cm)
    even = np.linspace(0.0, s[-1], STEM_POINTS)
    return places_along(line_cm, s, even)


def uncertainty_mm(stem: Stem, line_cm: FloatArray, points: FloatArray, tip_mm: float, px_per_cm: float) -> FloatArray:
    """Standard deviation of each point on a line, mm; the last one is the tip, and ``tip_mm`` what it has besides."""
    nearest = np.argmin(((points[:, None, :] - line_cm[None, :, :]) ** 2).sum(axis=2), axis=1)
    out = np.hypot(10.0 * stem.deviation[nearest] / px_per_cm, FLOOR_MM)
    out[-1] = math.hypot(out[-1], tip_mm)
    return np.asarray(out, dtype=np.float64)
