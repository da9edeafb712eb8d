"""The stem along the way that the network tells, measured, with its tip where the apex is likeliest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from flora_common.arrays import BoolArray, FloatArray
from flora_common.geometry import arc_length, unit
from flora_common.vision.path import across, curve, doubts
from flora_common.vision.path.apex import drawn_to
from flora_common.vision.path.chain import Before
from flora_common.vision.path.curve import STEP_PX, Stem
from flora_common.vision.path.guide import Way
from flora_common.vision.path.sampler import Sampler, places_along
from flora_common.vision.path.tip import Tip, find_tip

USABLE: Final = 0.13
"""How likely an apex is at least where its way is taken."""
SURE, SURE_OF_TWO, SURE_AGAIN = 0.3, 0.22, 0.14
"""The same where it is believed by itself, where the rules come to it but doubt it, and where it was plain before."""
ALONE, ALONE_POWER, LEAST_ALONE = 0.12, 0.75, 0.5
"""Where the likeliest apex elsewhere is less likely than the first, the end need be less likely by that power of how
much, and by the last at most."""
FIRST_SHARE, FIRST_SHARE_OF_TWO = 0.25, 0.4
"""With nothing known from pictures before, the end must be as likely as :data:`SURE_OF_TWO`, and an apex elsewhere have
no more than these shares of that: where the end is believed by itself, and where the rules come to it. The share tells
more than how likely the end is: of 1,246 plants that the network had not learnt from fewer than 5 in a hundred were
wrong by more than 5 mm below the first share, 14 in a hundred between the two, and 37 in a hundred above."""
SURE_ELSEWHERE, REFUTED_AFTER = 0.35, 3
"""The same where it is elsewhere than the apex that is followed and the network sees none there, for so many
pictures."""
KEEPS, KEEPS_CM = 3.0, 1.0
"""An apex where it was before counts by up to so much more, and one farther off than this by nothing."""
THROUGH_CM, GOES_ON_CM = 0.12, 0.7
"""A way that comes as near as the first to a place and goes on for the second goes through it: no stem ends there."""
GOES_ON_LIKELY, WEAKEST_SHARE, GOES_ON_SHARE = 0.4, 10.0, 0.5
"""Beyond it nearly all (but so many per cent) is that likely the stem's middle, and its end is at least that share as
likely an apex as the place. Of 636 such pairs in plants drawn by others the farther end was the stem's in all; of those
that go on for 0.7 cm in 98 of a hundred, for some young leaves lie in line with the stem."""
AGREES_CM: Final = 0.5
LEAVES_OVER_CM: Final = 2.5
"""A way that goes level to another plant's foot does so over this, from the anchor."""
LEANT_CM: Final = 0.7
"""A stem leans over no faster than this from picture to picture."""
LEAST_ALONG: Final = 0.1
"""What is less likely the stem's middle shows no stem."""
WAY_ERROR_CM: Final = 0.08
"""Standard deviation of the way across the stem."""
MEASURED_TO_CM: Final = 0.6
"""Before the apex edges are those of young leaves."""
ONWARDS_CM: Final = 0.5
SAME_TIP_CM: Final = 0.19
"""Where the rules end as near as this to the network, the tip lies half-way between."""
APEX_ERROR_CM, UNSURE_ERROR_CM = 0.08, 0.3
"""Standard deviation of a sure apex along the stem, and what one in doubt has besides."""
LOWER, WIDEST_CM, LEAST_WIDTH_PX = 0.6, 1.0, 1.5
"""The stem's width is that over this share of the way, between these."""
TURNS_RAD, TURNS_CM, TURNS_STEP_CM = 0.5, 0.8, 0.2
"""A way that turns by the first over the second goes round a bend; looked at in steps of the third."""


def is_usable(way: Way) -> bool:
    """Whether the way says more than other means do."""
    return way.sure >= USABLE


def is_believed(way: Way, *, is_first: bool) -> bool:
    """Whether the end of a way is believed by itself.

    Args:
        way: to it.
        is_first: nothing is known from pictures before, so that an apex elsewhere counts against it, too.
    """
    if is_first:
        return bool(stands_out(way.sure, way.elsewhere, FIRST_SHARE))
    alone = min(1.0, (way.elsewhere / ALONE) ** ALONE_POWER)
    return bool(way.sure >= SURE * max(LEAST_ALONE, alone))


def is_believed_of_two(way: Way, *, is_first: bool) -> bool:
    """Whether the end of a way is believed to which the rules come, too, whatever they say of it.

    Args:
        way: to it.
        is_first: as in :func:`is_believed`.
    """
    return bool(stands_out(way.sure, way.elsewhere, FIRST_SHARE_OF_TWO if is_first else math.inf))


def stands_out(sure: float | FloatArray, elsewhere: float | FloatArray, share: float) -> bool | BoolArray:
    """Whether an end is likely, and any apex elsewhere has no more than a share of that; of one, or of each of several.

    Args:
        sure: how likely an apex is there.
        elsewhere: how likely one is anywhere else.
        share: see above.
    """
    return (sure >= SURE_OF_TWO) & (elsewhere <= share * sure)


def chosen(ways: Sequence[Way], before: Before | None, px_per_cm: float) -> Way:
    """The likeliest way, where one that ends at the apex before is likelier by itself, and one that ends half-way along
    another is none; nor is one that leads to another plant, where no stem is known that may have leant over."""
    own = ways if before is not None else [way for way in ways if not goes_aside(way, px_per_cm)] or ways
    ends = [way for way in own if not is_passed(way.tip_px, own, px_per_cm, least=GOES_ON_SHARE * way.sure)] or own
    if before is None:
        return ends[0]
    return max(ends, key=lambda way: worth(way, before, px_per_cm))


def worth(way: Way, before: Before, px_per_cm: float) -> float:
    """How likely the end of a way is, where the stem before counts too."""
    away = min(1.0, math.dist(way.tip_px, before.line_px[-1]) / (KEEPS_CM * px_per_cm))
    return way.sure * (1.0 + before.trust * (KEEPS - 1.0) * (1.0 - away))


def cuts_short(way: Way, before: Before, px_per_cm: float) -> bool:
    """Whether a way ends on the stem before and plainly short of its end: at a leaf that hides a part of it, say."""
    nearest = _nearest(way.tip_px, before.line_px, AGREES_CM * px_per_cm)
    return nearest is not None and _is_far_on(before.line_px[nearest:], px_per_cm)


def is_refuted(place_px: FloatArray, ways: Sequence[Way], px_per_cm: float, *, elsewhere: int) -> bool:
    """Whether the network tells that no stem ends at a place: one leads through it and on, or for some pictures it is
    sure of an apex elsewhere and sees none there.

    Args:
        place_px: (x, y), px of the full picture.
        ways: that the network tells.
        px_per_cm: scale.
        elsewhere: pictures in a row in which something ended elsewhere and was not believed.
    """
    if elsewhere >= REFUTED_AFTER and ways[0].sure >= SURE_ELSEWHERE:
        return all(math.dist(way.tip_px, place_px) > AGREES_CM * px_per_cm for way in ways)
    return is_passed(place_px, ways, px_per_cm)


def is_passed(place_px: FloatArray, ways: Sequence[Way], px_per_cm: float, *, least: float = 0.0) -> bool:
    """Whether a usable way leads through a place and plainly on, so that no stem ends there.

    Args:
        place_px: (x, y), px of the full picture.
        ways: that the network tells.
        px_per_cm: scale.
        least: how likely an apex there must be at the end of such a way.
    """
    return any(way.sure >= max(least, USABLE) and _leads_on(way, place_px, px_per_cm) for way in ways)


def _leads_on(way: Way, place_px: FloatArray, px_per_cm: float) -> bool:
    nearest = _nearest(place_px, way.line_px, THROUGH_CM * px_per_cm)
    return (
        nearest is not None
        and _is_far_on(way.line_px[nearest:], px_per_cm)
        and bool(np.percentile(_along(way)[nearest:], WEAKEST_SHARE) >= GOES_ON_LIKELY)
    )


def _nearest(place_px: FloatArray, line_px: FloatArray, within_px: float) -> int | None:
    """Which point of a line is nearest to a place; None where none is within that distance."""
    away = np.hypot(*(line_px - place_px).T)
    nearest = int(np.argmin(away))
    return nearest if away[nearest] <= within_px else None


def _is_far_on(rest_px: FloatArray, px_per_cm: float) -> bool:
    return float(arc_length(rest_px)[-1]) >= GOES_ON_CM * px_per_cm


def unsure(way: Way, stem: Stem, before: Before | None, px_per_cm: float) -> str:
    """Why the way may lead to another plant; empty where nothing says so.

    Args:
        way: that was chosen.
        stem: measured along that way.
        before: what is known from pictures before.
        px_per_cm: scale.
    """
    seen = way.line_px[_along(way) >= LEAST_ALONG]
    if len(seen) and doubts.is_aside(seen[0] - way.line_px[0], px_per_cm):
        return doubts.BEGINS_ASIDE
    if goes_aside(way, px_per_cm, before.line_px if before is not None else None):
        return doubts.BEGINS_ASIDE
    if before is not None:
        return ""
    return doubts.hidden(stem, px_per_cm)


def goes_aside(way: Way, px_per_cm: float, known_px: FloatArray | None = None) -> bool:
    """Whether a way leads level over to what stands beside the anchor, which is another plant's.

    Args:
        way: from the anchor.
        px_per_cm: scale.
        known_px: the stem in the picture before; where that has leant over, a way may, too.
    """
    low = way.line_px[arc_length(way.line_px) < LEAVES_OVER_CM * px_per_cm]
    aside = [place for place in low if doubts.is_aside(place - way.line_px[0], px_per_cm)]
    return any(known_px is None or _nearest(place, known_px, LEANT_CM * px_per_cm) is None for place in aside)


def agrees(way: Way, stem: Stem, px_per_cm: float) -> bool:
    """Whether the end of a stem that was found otherwise is the likeliest apex, too."""
    return math.dist(way.tip_px, stem.line[-1]) < AGREES_CM * px_per_cm


def _along(way: Way) -> FloatArray:
    """How likely each place of the line is the stem's middle, shape (n,)."""
    places, ways = (np.linspace(0.0, 1.0, len(v)) for v in (way.line_px, way.along))
    return np.interp(places, ways, way.along)


def stem_along(way: Way, sampler: Sampler, px_per_cm: float) -> tuple[Stem, Tip]:
    """The stem along the network's way, and its tip.

    Args:
        way: to the apex.
        sampler: of the picture.
        px_per_cm: scale.
    """
    line = way.line_px
    s = arc_length(line)
    width = _width(line, s, sampler, px_per_cm)
    upto = max(float(s[-1]) - MEASURED_TO_CM * px_per_cm, 0.6 * float(s[-1]))
    stem = curve.along_line(
        line, upto, (width, 0.8 * width), _bends_from(line, s, px_per_cm), sampler, px_per_cm, WAY_ERROR_CM
    )
    safe, apex = len(stem.line) - 1, way.tip_px
    by_rules = find_tip(stem, sampler, px_per_cm, beyond_cm=(float(s[-1]) - upto) / px_per_cm + SAME_TIP_CM).places[-1]
    if math.dist(by_rules, apex) < SAME_TIP_CM * px_per_cm:
        apex = 0.5 * (apex + by_rules)
    rest = drawn_to(line, apex, MEASURED_TO_CM * px_per_cm)[s > upto + STEP_PX]
    places = rest if len(rest) else apex[None]
    heading = unit(places[-1] - (places[-3] if len(places) > 2 else stem.line[-1]))
    onwards = places[-1] + np.arange(1.0, ONWARDS_CM * px_per_cm)[:, None] * heading
    error = (APEX_ERROR_CM + UNSURE_ERROR_CM * (1.0 - way.sure) ** 2) * px_per_cm
    tip = Tip(safe, places, onwards, True, error)
    whole = curve.with_tip(stem, safe, places, sampler, px_per_cm, WAY_ERROR_CM)
    drawn = drawn_to(whole.line, apex, MEASURED_TO_CM * px_per_cm)
    return replace(whole, line=drawn, length=float(arc_length(drawn)[-1])), tip


def _width(line: FloatArray, s: FloatArray, sampler: Sampler, px_per_cm: float) -> float:
    """The stem's width along the lower part of the way, px."""
    low = np.arange(0.0, max(2.0, LOWER * s[-1]), STEP_PX)
    places = places_along(line, s, low)
    width = across.bare_width(places, WIDEST_CM * px_per_cm, sampler)
    return width if width > LEAST_WIDTH_PX else LEAST_WIDTH_PX


def _bends_from(line: FloatArray, s: FloatArray, px_per_cm: float) -> float:
    """Distance from the anchor, px, from which the way bends more tightly than stems usually do."""
    even = np.arange(0.0, s[-1], TURNS_STEP_CM * px_per_cm)
    if len(even) < 6:
        return math.inf
    at = places_along(line, s, even)
    reach = 2
    step = at[reach:] - at[:-reach]
    angle = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    apart = round(TURNS_CM / TURNS_STEP_CM)
    if len(angle) <= apart:
        return math.inf
    turned = np.flatnonzero(np.abs(angle[apart:] - angle[:-apart]) > TURNS_RAD)
    return max(0.0, float(even[turned[0]]) - curve.BEND_BEGINS_CM * px_per_cm) if turned.size else math.inf
