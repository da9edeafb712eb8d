"""Why a line that was found may not be the whole stem, or may be another thing.

What is said here is said of one picture by itself. One that gives a :func:`doubt` shows something else than a plant, or
hardly any of it; one that leaves only :func:`unsure_of_end` shows the stem, and perhaps not all of it.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final

import cv2
import numpy as np

from flora_common.arrays import ByteArray, Float32Array, FloatArray
from flora_common.geometry import arc_length, heading_at_end, unit
from flora_common.runs import CameraSection
from flora_common.vision.lamp_states import COARSE
from flora_common.vision.path.chain import Chain
from flora_common.vision.path.curve import Stem
from flora_common.vision.path.looks import has_neck, leaf_from
from flora_common.vision.path.sampler import Sampler, places_along
from flora_common.vision.path.strands import Strands

LEAST_COVER: Final = 0.75
"""Share of the line that must lie on plant."""
REACHES_IN_CM: Final = 2.0
"""A leaf may touch the picture's sides or upper edge over this length; an arm does over more."""
EDGE_PX: Final = 3
REACH_CM: Final = 0.15
"""What is nearer than twice this hangs together."""
GOES_ON_CM, GOES_ON_SHARE = 1.5, 0.5
"""Plant that hangs together with the tip and goes on above it by more than the first, and by more than this share of
the stem's length: the stem goes on in it."""
UNSURE_BEYOND_CM: Final = 1.0
"""Plant that goes on by more than this above the tip, or ahead of it, may be the stem."""
HEADING_CM, CONE = 0.8, 0.6
"""Ahead is what lies within this slope to either side of the last piece of so much of the stem."""
ASIDE_CM: Final = 1.0
"""A line whose first seen piece begins farther aside from the anchor than this, and than above it, is another plant's:
what hides a base, a rim or soil, hides it below."""
FADED, FADED_SHARE = 2.0, 0.45
"""Evidence before the tip, in shares of the least that counts, and its share of that below, under which the stem has
faded and may go on unseen."""
STEADY, STEADY_CM = 0.8, 3.0
"""A stem as long as the second, whose evidence before the tip is this share of that below, has not faded, however much
noise there is."""
PALER: Final = 2.5
"""Evidence before the tip, in the same shares, from which on a stem that is paler than below is still plain to see: a
thin one's young end is."""
SUNK_CM, SUNK_ASIDE_CM, SUNK_BESIDE_CM = (0.4, 2.4), 0.12, (0.5, 1.1)
"""A stem that sinks into noise goes on over the first, ahead of where it is lost: so far to either side it is looked
for, and the board beside it so far off."""
SUNK_SHARE, SUNK_ERRORS = 0.1, 3.0
"""It differs from the board by more than this share of what the stem before does, and than so many standard errors."""
LEAST_SUNK_PX: Final = 10
BEGINS_ASIDE: Final = "it begins beside the anchor, as another plant does"
HIDES_MORE: Final = "something stands before the board where it ends, and may hide more of it"
ANOTHER_PART: Final = "another part of the plant may as well be the stem"
NO_APEX: Final = "its end does not look like an apex"
HIDDEN_END: Final = "it looks as if leaves hid where the stem ends"
BEYOND_CM, BESIDE_CM, PLACE_CM = ((0.6, 1.6), (1.6, 2.6), (2.6, 3.6)), 1.0, 0.1
"""The board beyond an end: in which parts ahead, how far to either side, and how far apart it is looked at. Of 258 good
pictures of plants that nothing hides the farther two parts doubt one each, for leaves."""
NOT_THE_BOARD: Final = 2.5
"""Code units, some 3 %, by which it differs in any colour where something stands before it. Of a hundred good pictures
the most was 1.6; eleven hands that hid a stem's upper part had 3.3 to 29."""
ERROR_OF_MEDIAN, ERRORS = 1.858, 4.0
"""Standard error of a median, times the root of the number, over the median deviation (of a normal distribution); and
how many of them it must be off by, for noise in the dark has several code units."""
LONGEST_UNSEEN_CM: Final = 2.4
"""In a picture by itself: over a longer gap what goes on may be another plant's stem, and what hides it its leaf."""
LONGEST_IN_LINE_CM, IN_LINE_RAD, IN_LINE_CM = 5.0, 0.3, 1.0
"""The same where the stem leads into the gap and out of it as it would straight through, by the second angle at most,
both told over the third: a leaf hangs before it."""


def doubt(stem: Stem, sampler: Sampler, px_per_cm: float, *, touching_cm: float, above_cm: float) -> str:
    """Why the line may be another thing than the whole stem, one clause; empty where nothing says so."""
    if reason := badly_covered(stem, sampler):
        return reason
    if touching_cm > REACHES_IN_CM:
        return f"something wide reaches in over {touching_cm:.0f} cm of the picture's edge"
    length_cm = stem.length / px_per_cm
    if above_cm > max(GOES_ON_CM, GOES_ON_SHARE * length_cm):
        return f"the plant goes on for {above_cm:.1f} cm above a stem of {length_cm:.1f} cm"
    return ""


def badly_covered(stem: Stem, sampler: Sampler) -> str:
    """Why the line may lie on no plant, one clause; empty where it does lie on one."""
    covered = float((sampler.plant(stem.line)[stem.seen] > 0).mean()) if stem.seen.any() else 0.0
    return f"only {covered:.0%} of the line lies on plant" if covered < LEAST_COVER else ""


def unsure_of_end(stem: Stem, sampler: Sampler, px_per_cm: float, above_cm: float, ahead_cm: float) -> str:
    """Why the stem may end elsewhere, one clause; empty where nothing says so."""
    if above_cm > UNSURE_BEYOND_CM:
        return f"the plant goes on for {above_cm:.1f} cm above the tip"
    if ahead_cm > UNSURE_BEYOND_CM:
        return f"the plant goes on for {ahead_cm:.1f} cm ahead of the tip"
    if reason := fades(stem, sampler, px_per_cm):
        return reason
    if reason := ends_in_leaf(stem, sampler, px_per_cm):
        return reason
    if has_neck(stem.line, sampler, px_per_cm):
        return "the line goes through a neck that is thinner than the stem on both sides"
    return ""


def ends_in_leaf(stem: Stem, sampler: Sampler, px_per_cm: float) -> str:
    """Why the end may be a leaf's, one clause; empty where nothing says so."""
    if leaf_from(stem.line, sampler, px_per_cm) < len(stem.line):
        return "the line ends in what is darker and greener than the stem below: a leaf"
    return ""


def fades(
    stem: Stem, sampler: Sampler, px_per_cm: float, *, may_be_steady: bool = True, may_be_paler: bool = False
) -> str:
    """Why the stem may go on unseen, one clause; empty where nothing says so.

    Args:
        stem: found.
        sampler: of the picture.
        px_per_cm: of the full picture.
        may_be_steady: whether one that is as plain before its end as below has not faded, in whatever noise.
        may_be_paler: whether one that is plain to see before its end has not faded, however much plainer it is below.
    """
    s, plant = arc_length(stem.line), sampler.plant(stem.line[None])[0]
    to_tip_cm = (s[-1] - s) / px_per_cm
    last, rest = plant[(to_tip_cm > 0.1) & (to_tip_cm < 0.7)], plant[to_tip_cm > 1.0]
    if not last.size:
        return ""
    here, below = float(np.median(last)), float(np.median(rest)) if rest.size else 0.0
    is_steady = may_be_steady and to_tip_cm[0] > STEADY_CM and here > STEADY * below
    has_paled = here < FADED_SHARE * below and not (may_be_paler and here > PALER * sampler.least)
    if has_paled or (here < FADED * sampler.least and not is_steady):
        return "the stem fades before it ends: it looks like what is behind it"
    return ""


def hides_more(line: FloatArray, flat: Float32Array | None, px_per_cm: float) -> str:
    """Why something may hide what goes on beyond a line's end, one clause; empty where the board is seen there.

    Args:
        line: px of the full picture.
        flat: how the picture differs from the empty setup (:class:`.survey.Survey`); None where that is not known.
        px_per_cm: of the full picture.
    """
    if flat is None:
        return ""
    across = np.arange(-BESIDE_CM, BESIDE_CM + 0.5 * PLACE_CM, PLACE_CM)
    parts = (_about_end(flat, line, np.arange(*ahead, PLACE_CM), across, px_per_cm) for ahead in BEYOND_CM)
    return HIDES_MORE if any(len(part) and _is_hidden(part) for part in parts) else ""


def _is_hidden(board: Float32Array) -> bool:
    """Whether most of a part of the board, which differs from the empty setup by so much, shape (n, 3), is hidden."""
    off = np.median(board, axis=0)
    error = ERROR_OF_MEDIAN * np.median(np.abs(board - off), axis=0) / math.sqrt(len(board))
    return bool((np.abs(off) > np.maximum(NOT_THE_BOARD, ERRORS * error)).any())


def sinks(line: FloatArray, flat: Float32Array | None, px_per_cm: float) -> bool:
    """Whether a stem that hardly stands out of the noise goes on straight ahead of a line's end, fainter than noise.

    A mean over centimetres tells what no place by itself does: the board along what would be the stem's middle differs
    from that beside it in the colour by which the stem before differs.

    Args:
        line: px of the full picture.
        flat: how the picture differs from the empty setup (:class:`.survey.Survey`); None where that is not known.
        px_per_cm: of the full picture.
    """
    if flat is None:
        return False
    beyond, beside = np.arange(*SUNK_CM, PLACE_CM), np.arange(*SUNK_BESIDE_CM, PLACE_CM)
    within, without = np.linspace(-SUNK_ASIDE_CM, SUNK_ASIDE_CM, 3), np.concatenate([-beside, beside])
    stem, board, onwards, there = (
        _about_end(flat, line, along, across, px_per_cm).astype(np.float64)
        for along in (-beyond, beyond)
        for across in (within, without)
    )
    if min(map(len, (stem, board, onwards, there))) < LEAST_SUNK_PX:
        return False
    contrast = stem.mean(axis=0) - board.mean(axis=0)
    size = float(np.linalg.norm(contrast)) + 1e-9
    off, noise = (v @ (contrast / size) for v in (onwards, there))
    error = float(noise.std()) * math.sqrt(1.0 / len(off) + 1.0 / len(noise))
    return float(off.mean() - noise.mean()) > max(SUNK_SHARE * size, SUNK_ERRORS * error)


def _about_end(
    flat: Float32Array, line: FloatArray, along_cm: FloatArray, across_cm: FloatArray, px_per_cm: float
) -> Float32Array:
    """How the picture differs from the empty setup at places ahead of a line's end and beside it, those that lie in the
    picture, each pixel of ``flat`` once, shape (n, 3)."""
    ahead = heading_at_end(line, HEADING_CM * px_per_cm)
    off = along_cm[:, None, None] * ahead + across_cm[None, :, None] * np.array([-ahead[1], ahead[0]])
    places = np.rint((line[-1] + px_per_cm * off.reshape(-1, 2)) / COARSE).astype(int)
    x, y = np.unique(places, axis=0).T
    inside = (x >= 0) & (x < flat.shape[1]) & (y >= 0) & (y < flat.shape[0])
    return np.asarray(flat[y[inside], x[inside]], dtype=np.float32)


def hidden(stem: Stem, px_per_cm: float) -> str:
    """Why what goes on beyond the longest part of a stem that shows neither edges nor a ridge may be another plant's.

    One clause; empty where nothing says so.
    """
    s = arc_length(stem.line)
    known = np.concatenate([[0.0], s[stem.seen], s[-1:]])
    at = int(np.argmax(np.diff(known)))
    gap_cm = float(known[at + 1] - known[at]) / px_per_cm
    longest_cm = LONGEST_IN_LINE_CM if _goes_through(stem.line, s, known[at], known[at + 1], px_per_cm) else 0.0
    return unseen(gap_cm) if gap_cm > max(LONGEST_UNSEEN_CM, longest_cm) else ""


def _goes_through(line: FloatArray, s: FloatArray, begins: float, ends: float, px_per_cm: float) -> bool:
    """Whether a line leads straight from one place along it to another: as it comes to the first, and leaves the
    second."""
    reach = IN_LINE_CM * px_per_cm
    if begins < reach or s[-1] - ends < reach:
        return False
    places = places_along(line, s, np.array([begins - reach, begins, ends, ends + reach]))
    below, through, above = (unit(step) for step in np.diff(places, axis=0))
    return bool(min(below @ through, through @ above) > math.cos(IN_LINE_RAD))


def unseen(gap_cm: float) -> str:
    """Why what follows a gap may be another plant's, one clause."""
    return f"nothing is seen of it over {gap_cm:.1f} cm; what goes on may be another plant"


def longest_gap_px(chain: Chain) -> float:
    """The longest way between two pieces of a chain, over which nothing of it is seen."""
    gaps = (float(np.hypot(*(b.points[0] - a.points[-1]))) for a, b in pairwise(chain.pieces))
    return max(gaps, default=0.0)


def begins_aside(chain: Chain, camera: CameraSection) -> bool:
    """Whether what is seen of the stem begins beside the anchor rather than above it: it is another plant's."""
    return is_aside(chain.pieces[0].points[0] - camera.anchor_px, camera.px_per_cm)


def is_aside(foot_px: FloatArray, px_per_cm: float) -> bool:
    """Whether a place, (x, y) px from the anchor, lies beside it rather than above it."""
    return bool(abs(foot_px[0]) > max(ASIDE_CM * px_per_cm, -foot_px[1]))


def beyond_px(line: FloatArray, mask: ByteArray, origin_px: tuple[int, int], px_per_cm: float) -> tuple[float, float]:
    """How far the plant that hangs together with a line's end goes on above the whole line, and ahead of its end.

    Args:
        line: px of the full picture.
        mask: shape (height, width), 1 where there is plant, first pixel at ``origin_px``.
        origin_px: (x, y).
        px_per_cm: scale.
    """
    half = mask[::2, ::2]
    near = cv2.dilate(half, np.ones((max(1, round(REACH_CM * px_per_cm)) | 1,) * 2, np.uint8))
    _, labels = cv2.connectedComponents(near, connectivity=4)
    x, y = ((line[-1] - np.array(origin_px)) / 2.0).round().astype(int)
    label = labels[int(np.clip(y, 0, half.shape[0] - 1)), int(np.clip(x, 0, half.shape[1] - 1))]
    rows, columns = np.nonzero((labels == label) & (half > 0)) if label else (np.zeros(0), np.zeros(0))
    if rows.size == 0:
        return 0.0, 0.0
    above = float(line[:, 1].min() - (origin_px[1] + 2 * int(rows.min())))
    heading = heading_at_end(line, HEADING_CM * px_per_cm)
    off = 2.0 * np.column_stack([columns, rows]) + origin_px - line[-1]
    ahead, aside = off @ heading, np.abs(off @ np.array([-heading[1], heading[0]]))
    return above, float(np.max(ahead, where=aside < CONE * ahead + 0.1 * px_per_cm, initial=0.0))


def touching_px(strands: Strands, camera: CameraSection) -> float:
    """Over how many px of the picture's sides and upper edge wide parts of plant touch it."""
    (x, y), width = strands.origin_px, strands.leaf.shape[1]
    count = 0
    if x <= EDGE_PX:
        count += int(strands.leaf[:, : EDGE_PX + 1 - x].any(axis=1).sum())
    if x + width >= camera.width_px - EDGE_PX:
        count += int(strands.leaf[:, -EDGE_PX:].any(axis=1).sum())
    if y <= EDGE_PX:
        count += int(strands.leaf[: EDGE_PX + 1 - y].any(axis=0).sum())
    return float(count)
