"""Following a stem by looking only near the place where it was.

Between two photographs a plant moves by a fraction of a stem's width. Then the line of the one before lies inside the
stem of this one, and the stem's two edges can be measured across it at once: nothing else need be searched. What is
found so is believed only where a look at the whole picture would have no doubt either; and at every few pictures, and
whenever something has changed, the whole picture is looked at.
"""

from __future__ import annotations

import math
from typing import Final

import cv2
import msgspec
import numpy as np

from flora_common.arrays import ByteArray, FloatArray
from flora_common.geometry import arc_length
from flora_common.vision.lamp_states import COARSE
from flora_common.vision.path import curve, doubts
from flora_common.vision.path.chain import Before
from flora_common.vision.path.curve import Stem
from flora_common.vision.path.evidence import Evidence
from flora_common.vision.path.sampler import Sampler
from flora_common.vision.path.survey import Survey
from flora_common.vision.path.tip import Tip, find_tip

MOST_LOOKS: Final = 11
"""Pictures in a row of which only a part is looked at: the whole one is every hour."""
LONGEST_S: Final = 1200.0
"""A stem that was seen longer ago may be anywhere."""
MARGIN_CM: Final = 1.5
"""To either side of the stem."""
TIP_MARGIN_CM: Final = 2.5
"""To all sides of its tip."""
BEYOND_TIP_CM: Final = 1.5
"""So far beyond the old tip the new one is looked for."""
MOVED_CM: Final = 0.5
"""A tip that moved by more is looked at again in the whole picture."""
SURE_AGAIN_PX: Final = 3.0
"""Beyond the place that was sure the line is measured for so long, to be sure of that again."""
DOUBTS_SOONER: Final = 1.25
"""Factor on how far plant goes on beyond the tip: near the limit a look at the whole picture decides."""
SAME_CM: Final = 0.3
"""A tip as near as this is the same."""
LESS_SEEN: Final = 0.1
"""Share of the stem by which less of it is seen than before, at most."""
STEP_CM, STEP_SHARE = 0.2, 0.14
"""A tip that moved by more than the first, and this share of the fastest growth, is likely another thing."""
HELD_MOVED_CM: Final = 1.2
"""A stem is held to, while the whole picture tells of another one, if its tip moved by less, and less than to the
other's."""
HELD_LESS_SEEN: Final = 0.2
"""Share of it by which less of it is seen than before, at most."""
DETOUR_CM: Final = 0.6
"""A stem gets no longer by this from one picture to the next, unless its end is hidden."""
LEAP_CM: Final = 2.5
"""No tip moves so far from one picture to the next."""
OTHER_PLANT: Final = 0.35
"""Share by which more or less of the picture looks like plant than in the one before, at most."""
REACHES_IN_CM: Final = 1.0
"""Plant may touch the picture's sides and upper edge over this length."""


class Nearby(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the last look at a whole picture told, and the looks since, for those near the stem that follow.

    Attributes:
        lamps: number of the lamp state.
        noise: standard deviation of the evidence of plant.
        plant_pixels: how many pixels were plant in the picture before.
        width_px: of the stem, at the anchor and at the tip.
        sure_px: distance from the anchor up to which it was sure, without being carried on to its tip.
        bends_from_px: distance from the anchor from which it bends tightly; None where it does not.
        looks: pictures since then of which only a part was looked at.
        is_guided: whether the network told its way.
    """

    lamps: int
    noise: float
    plant_pixels: int
    width_px: tuple[float, float]
    sure_px: float
    bends_from_px: float | None = None
    looks: int = 0
    is_guided: bool = False


def after(stem: Stem, sure_px: float, evidence: Evidence, *, is_guided: bool) -> Nearby:
    """What a look at a whole picture tells, in which a stem was found."""
    width = float(stem.width[0]), float(stem.width[-1])
    bends_from = stem.bends_from if math.isfinite(stem.bends_from) else None
    return Nearby(
        evidence.lamps, evidence.noise, evidence.plant_pixels, width, sure_px, bends_from, is_guided=is_guided
    )


def again(near: Nearby, survey: Survey) -> Nearby:
    """What is known after another look near the stem."""
    return msgspec.structs.replace(near, plant_pixels=survey.plant_pixels, looks=near.looks + 1)


def since_clear(near: Nearby | None, stem: Stem, before: Before | None, px_per_cm: float) -> Nearby | None:
    """What is still known of a stem after a picture in which it is not clear which part of the plant that is.

    If it ends where it did, it can be held to; but whole pictures are looked at until one is clear again.

    Args:
        near: what the last clear picture told; None if there was none since the stem was last lost.
        stem: as found now.
        before: the stem in the picture before, if it is believed.
        px_per_cm: scale.
    """
    if near is None or before is None or math.dist(stem.line[-1], before.line_px[-1]) > STEP_CM * px_per_cm:
        return None
    return msgspec.structs.replace(near, looks=MOST_LOOKS)


def enough(near: Nearby, line_px: FloatArray, survey: Survey, part: tuple[slice, slice], px_per_cm: float) -> bool:
    """Whether what the whole picture shows at a glance is as before, so that a look near the stem is enough.

    Args:
        near: of the last whole picture.
        line_px: the stem in the picture before.
        survey: of this picture.
        part: rows and columns near the stem.
        px_per_cm: scale.
    """
    if near.looks >= MOST_LOOKS or survey.number != near.lamps:
        return False
    if abs(survey.plant_pixels - near.plant_pixels) > OTHER_PLANT * near.plant_pixels:
        return False
    plant = survey.plant
    touching = np.count_nonzero(plant[:, 0]) + np.count_nonzero(plant[:, -1]) + np.count_nonzero(plant[0])
    if touching * COARSE > REACHES_IN_CM * px_per_cm:
        return False
    return not _rises_elsewhere(plant, line_px, part, px_per_cm)


def _rises_elsewhere(plant: ByteArray, line_px: FloatArray, part: tuple[slice, slice], px_per_cm: float) -> bool:
    """Whether plant that hangs together with the tip goes on above the stem outside of the part that is looked at."""
    top = max(0, math.ceil((float(line_px[:, 1].min()) - doubts.UNSURE_BEYOND_CM * px_per_cm) / COARSE))
    rows, columns = (slice(s.start // COARSE, -(-s.stop // COARSE)) for s in part)
    above = plant[:top].copy()
    above[rows.start : rows.stop, columns] = 0
    if not above.any():
        return False
    _, labels = cv2.connectedComponents(plant, connectivity=8)
    x, y = (int(np.clip(round(v / COARSE), 1, n - 2)) for v, n in zip(line_px[-1], plant.shape[::-1], strict=True))
    label = int(labels[y - 1 : y + 2, x - 1 : x + 2].max())
    return bool(label and (above & (labels[:top] == label)).any())


def part_of(line_px: FloatArray, box: tuple[slice, slice], px_per_cm: float) -> tuple[slice, slice]:
    """Rows and columns of the full picture near a stem, within those in which a plant may stand."""
    margin, at_tip = MARGIN_CM * px_per_cm, TIP_MARGIN_CM * px_per_cm
    low = np.minimum(line_px.min(axis=0) - margin, line_px[-1] - at_tip)
    high = np.maximum(line_px.max(axis=0) + margin, line_px[-1] + at_tip)
    rows = slice(max(box[0].start, math.floor(low[1])), min(box[0].stop, math.ceil(high[1])))
    return rows, slice(max(box[1].start, math.floor(low[0])), min(box[1].stop, math.ceil(high[0])))


def found(
    line_px: FloatArray, near: Nearby, sampler: Sampler, px_per_cm: float, before: Before | None
) -> tuple[Stem, Tip]:
    """The stem that lies along a line, up to its tip, and that tip.

    Args:
        line_px: shape (n, 2), px of the full picture, inside the stem, anchor first.
        near: what is known of that line.
        sampler: of the picture.
        px_per_cm: scale.
        before: the stem in the picture before.
    """
    bends_from = math.inf if near.bends_from_px is None else near.bends_from_px
    # no farther than it was sure then: what is followed from picture to picture soon leads into a leaf
    upto_px = near.sure_px + near.width_px[1] + SURE_AGAIN_PX
    stem = curve.along_line(line_px, upto_px, near.width_px, bends_from, sampler, px_per_cm)
    rest_cm = max(0.0, float(arc_length(line_px)[-1]) - upto_px) / px_per_cm
    tip = find_tip(stem, sampler, px_per_cm, before, beyond_cm=rest_cm + BEYOND_TIP_CM)
    return curve.with_tip(stem, tip.safe, tip.places, sampler, px_per_cm), tip


def same_stem(stem: Stem, before: Before, seen_before: float, px_per_cm: float) -> bool:
    """Whether a stem is so like the one before that nothing else need be looked at."""
    moved_px = math.dist(stem.line[-1], before.line_px[-1])
    return moved_px < MOVED_CM * px_per_cm and float(stem.seen.mean()) > seen_before - LESS_SEEN


def is_detour(stem: Stem, before: Before, px_per_cm: float) -> bool:
    """Whether a stem that ends where it did before is longer than it can have become: it goes through a leaf."""
    return stem.length - float(arc_length(before.line_px)[-1]) > DETOUR_CM * px_per_cm


def still_there(
    before: Before,
    near: Nearby,
    seen_before: float,
    other: Stem,
    sampler: Sampler,
    px_per_cm: float,
    *,
    only_plain: bool,
) -> tuple[Stem, Tip] | None:
    """The stem of the picture before and its tip, if it is still there, though the whole picture tells of another.

    A line through a leaf may explain more of a picture than a stem that is as plain to see as it was.

    Args:
        before: the stem in the picture before.
        near: what is known of it.
        seen_before: share of it that was seen then.
        other: what the whole picture tells of.
        sampler: of the picture.
        px_per_cm: scale.
        only_plain: only if no stem can have moved to the other's end, and the other has fewer clean edges.
    """
    stem, tip = found(before.line_px, near, sampler, px_per_cm, before)
    moved_px, leap_px = (math.dist(s.line[-1], before.line_px[-1]) for s in (stem, other))
    plain = leap_px > LEAP_CM * px_per_cm and np.count_nonzero(stem.clean) >= np.count_nonzero(other.clean)
    there = (
        moved_px < min(HELD_MOVED_CM * px_per_cm, leap_px) and float(stem.seen.mean()) > seen_before - HELD_LESS_SEEN
    )
    if not there or (only_plain and not plain) or doubts.unsure_of_end(stem, sampler, px_per_cm, 0.0, 0.0):
        return None
    return stem, tip
