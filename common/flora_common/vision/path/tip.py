"""Where the stem ends, from the last piece that was seen of it.

Thinning stops half a width short of an end, and bends towards the young leaves round an apex. So the stem is continued
from the last place with two clean edges by circular arcs of every plausible bend; along each, what looks like stem is
added up and what does not is taken away. The best arc, cut where its sum is largest, ends at the tip; where the stem
was followed so far, the mean of the best ones does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import BoolArray, FloatArray
from flora_common.geometry import arc_length
from flora_common.vision.path.chain import Before
from flora_common.vision.path.curve import STEP_PX, Stem
from flora_common.vision.path.looks import leaf_from
from flora_common.vision.path.sampler import HALF_LIGHT_LEVEL, Sampler
from flora_common.vision.path.trace import traced

GLANCE, LOOKED_AT = 4, 9
"""One step in so many is enough to tell how good an arc is; without a picture before, so many are then tried."""
LONGEST_CM: Final = 2.5
BENDS_PER_CM: Final = np.linspace(-0.5, 0.5, 15)
TURNS_RAD: Final = np.linspace(-0.15, 0.15, 7)
STEP: Final = 0.5
"""Along the arcs, px."""
CLEAR_ERROR_PX: Final = 0.5
UNCLEAR_ERROR_CM: Final = 0.25
"""Standard deviations along the stem of an end with two clean edges, and what is added where there are none."""
APEX_CM: Final = 1.2
"""A leaf or bud that hides what comes next, and ends this near, hides the apex."""
FOLLOWED_CM: Final = 1.2
"""The direction at the safe place is that of this much of the stem below it."""
FOLLOWED_ROUND_BEND_CM: Final = 0.6
CLEAN_RUN: Final = 3
GOES_ON_WIDTHS: Final = (1.0, 2.0)
"""Where the found line goes on by more than this past the place where the two part, the band is a leaf."""
KEEPS_TIP_FROM, KEEPS_TIP_CM = 0.5, 0.5
"""A tip that is as near as this to the one before, where that is trusted, needs no other; unless it is a leaf's, or the
stem plainly goes on by more than as much."""
PLAIN_SHARE: Final = 0.8
"""Share of what goes on plainly that has two clean edges."""
MEASURED_POINTS: Final = 12
LEAVES_WIDTHS, LEAVES_CM = 0.8, 0.15
"""A band that leaves the found line by more than both is a bend that the line did not take."""
CLEAN_SHARE: Final = 0.6
"""Share of the band with two clean edges past that place, from which the second holds."""
BOTH_SIDES, ONE_SIDE, ON_LEAF = 1.0, 0.35, 0.8
ACROSS_WIDTHS: Final = np.array([-0.95, -0.8, -0.25, 0.0, 0.25, 0.8, 0.95])
HIDDEN_COST: Final = 0.25
OPEN_COST: Final = 3.0
BEND_COST_CM: Final = 1.5
"""For the sharpest change of bend: where nothing tells them apart, the straighter arc is right."""
STRAIGHT_FREE_CM: Final = 0.3
"""Among leaves, by so much must another arc be better than the one that just goes on."""
ALIKE_CM: Final = 0.15
"""Arcs that are worth less than the best by this count a third of it: so little says nothing of which is right."""
HOOK_RAD: Final = 0.45
MOVE_COST: Final = 0.3
"""Per cm from where the tip was before, up to 1 cm."""
CLEAR_RIDGE: Final = 12.0


@dataclass(frozen=True, slots=True, eq=False)
class Tip:
    """Where a stem ends.

    Attributes:
        safe: index of the last point of the line that is sure.
        places: shape (n, 2), from there to the tip, px.
        onwards: shape (m, 2), where it would go on if it were longer.
        open_end: whether the plant ends there; otherwise a leaf hides what comes next.
        error_px: standard deviation along the stem.
    """

    safe: int
    places: FloatArray
    onwards: FloatArray
    open_end: bool
    error_px: float


def find_tip(
    stem: Stem,
    sampler: Sampler,
    px_per_cm: float,
    before: Before | None = None,
    *,
    beyond_cm: float = LONGEST_CM,
) -> Tip:
    """Follow the stem from its last sure place to its end; where it was before counts for something.

    Args:
        stem: as far as it was found.
        sampler: of the picture.
        px_per_cm: scale.
        before: the stem in the picture before.
        beyond_cm: how far beyond the end of what was found the tip is looked for.
    """
    safe = _last_sure(stem, leaf_from(stem.line, sampler, px_per_cm))
    s = arc_length(stem.line)
    width = float(stem.width[safe])
    followed_cm = FOLLOWED_CM if s[safe] < stem.bends_from else FOLLOWED_ROUND_BEND_CM
    heading, bend = _heading(stem.line, s, safe, followed_cm * px_per_cm)
    steps = np.arange(STEP, beyond_cm * px_per_cm + (s[-1] - s[safe]), STEP)
    # the first arc just goes on, straightening out as stems do; the others are tried against it
    grid = np.meshgrid(BENDS_PER_CM / px_per_cm, TURNS_RAD, indexing="ij")
    bend = float(np.clip(bend, grid[0].min(), grid[0].max()))
    bends, turns = (np.append(own, v.ravel()) for own, v in zip((0.5 * bend, 0.0), grid, strict=True))
    effort = (np.abs(bends - bend) * px_per_cm / BENDS_PER_CM[-1] + np.abs(turns) / TURNS_RAD[-1]) ** 2
    level = float(np.median(sampler.plant(stem.line[None, max(0, safe - 20) : safe + 1])))
    # a few steps tell how good an arc is
    few = steps[GLANCE - 1 :: GLANCE]
    arcs, side = _arcs(stem.line[safe], heading + turns[:, None], bends[:, None], few)
    against = _bent_cost(effort[:, None], few, px_per_cm)
    moved = _moved_cost(arcs, before, px_per_cm)
    gain, _ = _gain(arcs, side, width, level, sampler)
    worth = (np.cumsum(GLANCE * STEP * gain / px_per_cm, axis=1) - against - moved).max(axis=1)
    shares = _one_by_one(worth) if before is None else _as_one(worth)
    angle = heading + (shares @ turns)[:, None] + (shares @ bends)[:, None] * steps
    against = _bent_cost((shares @ effort)[:, None], steps, px_per_cm)
    against = against + np.array([np.interp(steps, few, row) for row in shares @ moved])
    # and the line itself where it turns more than an arc can: a hook
    line = _along(stem.line[safe:], s[safe:] - s[safe], steps)
    if line is not None and np.ptp(line) > HOOK_RAD:
        angle = np.concatenate([angle, line[None]])
        against = np.concatenate([against, _moved_cost(_places(stem.line[safe], line[None])[0], before, px_per_cm)])
    arcs, side = _places(stem.line[safe], angle)
    gain, plant = _gain(arcs, side, width, level, sampler)
    there = plant > HALF_LIGHT_LEVEL * level
    worth = np.cumsum(STEP * gain / px_per_cm, axis=1) - against
    arc, end = (int(k) for k in np.unravel_index(int(np.argmax(worth)), worth.shape))
    if worth[0].max() > worth[arc, end] - STRAIGHT_FREE_CM:
        arc, end = 0, int(np.argmax(worth[0]))
    last = gain[arc, max(0, end - round(width / STEP)) : end + 1]
    error = CLEAR_ERROR_PX + (1.0 - float(np.clip(last.mean(), 0.0, 1.0))) * UNCLEAR_ERROR_CM * px_per_cm
    # the plant ends within the next pixels, or the stem goes on where it cannot be told from a leaf
    more = _still_there(there[arc], end)
    open_end = _is_open(there[arc], end, width)
    if end + more >= len(steps) - 1:
        return Tip(safe, arcs[arc, : end + 1], arcs[arc, end + 1 :], False, error)
    if not open_end and more * STEP <= APEX_CM * px_per_cm:
        # young leaves stand round an apex, and seldom above it: it is likely where the plant ends in this direction
        end, error, open_end = end + more, error + 0.4 * more * STEP, True
    places = np.concatenate([arcs[arc, : end + 1], _just_beyond(arcs[arc], plant[arc], end, HALF_LIGHT_LEVEL * level)])
    return Tip(safe, places, arcs[arc, end + 1 :], open_end, error)


def _one_by_one(worth: FloatArray) -> FloatArray:
    """Shares of all arcs in those that are tried to their ends, shape (k, n): the first and the best by themselves."""
    first = np.arange(len(worth)) == 0
    return np.eye(len(worth))[np.sort(np.argsort(-np.where(first, np.inf, worth))[:LOOKED_AT])]


def _as_one(worth: FloatArray) -> FloatArray:
    """The same, shape (1, n): their mean, by worth.

    Which of those that are nearly as good as the best is best is chance; their mean changes less between two pictures.
    """
    favoured = worth + STRAIGHT_FREE_CM * (np.arange(len(worth)) == 0)
    share = np.exp((favoured - favoured.max()) / ALIKE_CM)
    return np.asarray(share[None] / share.sum(), dtype=np.float64)


def _places(start: FloatArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places in steps from a start with given directions (rad), and the unit vectors across these."""
    cos, sin = np.cos(angle), np.sin(angle)
    return start + np.cumsum(STEP * np.stack([cos, sin], axis=-1), axis=1), np.stack([-sin, cos], axis=-1)


def _arcs(start: FloatArray, angle: FloatArray, bend: FloatArray, steps: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same at some distances along circles with given directions (rad) at the start and bends (rad per px)."""
    half = 0.5 * bend * steps
    chord = steps * np.sinc(half / np.pi)
    places = start + np.stack([chord * np.cos(angle + half), chord * np.sin(angle + half)], axis=-1)
    turned = angle + 2.0 * half
    return places, np.stack([-np.sin(turned), np.cos(turned)], axis=-1)


def _bent_cost(effort: FloatArray, steps: FloatArray, px_per_cm: float) -> FloatArray:
    """What each place costs as an end, for how much the arc is bent."""
    return np.asarray(BEND_COST_CM * effort * np.minimum(1.0, steps / px_per_cm), dtype=np.float64)


def _moved_cost(arcs: FloatArray, before: Before | None, px_per_cm: float) -> FloatArray:
    """What each place costs as an end, for how far it is from the tip before."""
    if before is None:
        return np.zeros(arcs.shape[:-1])
    off = arcs - before.line_px[-1]
    away = np.minimum(np.hypot(off[..., 0], off[..., 1]) / px_per_cm, 1.0)
    return np.asarray(before.trust * MOVE_COST * away, dtype=np.float64)


def _just_beyond(arc: FloatArray, plant: FloatArray, end: int, least: float) -> FloatArray:
    """The place between two steps at which the plant ends, shape (1, 2); (0, 2) if it does not there."""
    inside, outside = float(plant[end]), float(plant[end + 1])
    if not inside > least >= outside:
        return arc[:0]
    return arc[end : end + 1] + (inside - least) / (inside - outside) * (arc[end + 1 : end + 2] - arc[end : end + 1])


def round_bends(stem: Stem, tip: Tip, sampler: Sampler, px_per_cm: float, before: Before | None = None) -> FloatArray:
    """The band in which the line is sure, followed on, where that leads elsewhere than to the tip; shape (n, 2)."""
    line = np.concatenate([stem.line[: tip.safe + 1], tip.places])
    upto = leaf_from(line, sampler, px_per_cm)
    kept = (
        before is not None
        and before.trust > KEEPS_TIP_FROM
        and upto == len(line)
        and bool(np.hypot(*(line[-1] - before.line_px[-1])) < KEEPS_TIP_CM * px_per_cm)
    )
    band, clean = traced(stem.line[: tip.safe + 1], _width_before(stem, tip.safe), sampler, px_per_cm)
    if len(band) < 2:
        return band[:0]
    width = float(stem.width[tip.safe])
    first = max(0, tip.safe - 8)
    found = line[first::2]
    squared = ((band[:, None, :] - found[None]) ** 2).sum(axis=2)
    off = np.flatnonzero(np.sqrt(squared.min(axis=1)) > max(LEAVES_WIDTHS * width, LEAVES_CM * px_per_cm))
    if not off.size:
        return band[:0]
    if kept and not (
        clean[off[0] :].mean() > PLAIN_SHARE and arc_length(band[off[0] :])[-1] > KEEPS_TIP_CM * px_per_cm
    ):
        return band[:0]
    parting = int(np.argmin(squared[max(0, off[0] - 1)]))
    most = GOES_ON_WIDTHS[int(clean[off[0] :].mean() > CLEAN_SHARE)] * width
    # what runs through a leaf is not the stem that goes on
    more = found[parting : max(parting + 1, (upto - first + 1) // 2)]
    return band if float(arc_length(more)[-1]) < most else band[:0]


def _width_before(stem: Stem, safe: int) -> float:
    """The stem's width near a place, px: as it was measured rather than as a line through all its measures says."""
    measured = stem.across[: safe + 1][stem.clean[: safe + 1]][-MEASURED_POINTS:]
    return float(np.median(measured)) if len(measured) else float(stem.width[safe])


def _along(line: FloatArray, s: FloatArray, steps: FloatArray) -> FloatArray | None:
    """Direction at each step along a line, rad, and straight on beyond its end; None where it is a point."""
    if s[-1] < 2.0:
        return None
    reach = 3.0
    here, there = (np.minimum(steps + d, s[-1]) for d in (-reach, reach))
    back = np.maximum(np.minimum(here, there - reach), 0.0)
    v = np.stack([np.interp(there, s, line[:, k]) - np.interp(back, s, line[:, k]) for k in range(2)], axis=-1)
    return np.asarray(np.unwrap(np.arctan2(v[:, 1], v[:, 0])), dtype=np.float64)


def _still_there(there: BoolArray, end: int) -> int:
    """How many steps the plant goes on after one."""
    nothing = np.flatnonzero(~there[end + 1 :])
    return int(nothing[0]) if nothing.size else len(there) - end - 1


def _is_open(there: BoolArray, end: int, width: float) -> bool:
    return _still_there(there, end) * STEP < 0.5 * width + 1.0


def _last_sure(stem: Stem, upto: int) -> int:
    """The last point of a run of clean ones among the first ``upto``."""
    run = np.convolve(stem.clean[:upto].astype(int), np.ones(CLEAN_RUN, int), mode="valid") == CLEAN_RUN
    found = np.flatnonzero(run)
    if found.size == 0:
        return max(1, int(0.6 * len(stem.line)))
    # the light of a leaf beside the stem moves its edges, by up to a width before it hides them
    back = round(float(stem.width[found[-1]]) / STEP_PX)
    return max(2, int(found[-1]) + CLEAN_RUN - 1 - back)


def _gain(
    arcs: FloatArray, side: FloatArray, width: float, level: float, sampler: Sampler
) -> tuple[FloatArray, FloatArray]:
    """What each place along each arc is worth as stem: 1 with two clean edges, less on a leaf, below 0 for nothing.

    And the evidence of plant there.
    """
    # across first: sums over a short last axis take long
    offset = (ACROSS_WIDTHS * max(width, 2.0))[:, None, None]
    x, y = (arcs[..., k] + offset * side[..., k] for k in range(2))
    plant = sampler.plant_at(x, y)
    inside = (plant[2] + plant[3] + plant[4]) / 3.0
    least = 0.8 * inside
    left, right = plant[0] + plant[1] < least, plant[5] + plant[6] < least
    gain = np.where(left | right, ONE_SIDE, 0.0)
    clean = left & right
    gain[clean] = BOTH_SIDES
    # two clean edges are worth more than any band on a leaf
    rest = np.flatnonzero(~clean)
    tone = sampler.tone_at(*(v.reshape(len(offset), -1)[:, rest] for v in (x, y)))
    middle, before, behind = (tone[2] + tone[3] + tone[4]) / 3.0, 0.5 * (tone[0] + tone[1]), 0.5 * (tone[5] + tone[6])
    ridge = np.maximum(middle - np.maximum(before, behind), np.minimum(before, behind) - middle)
    on_leaf = np.clip(ridge / CLEAR_RIDGE, 0.0, 1.0) * (ON_LEAF + HIDDEN_COST) - HIDDEN_COST
    one_edge = gain.flat[rest]
    gain.flat[rest] = np.where(one_edge > 0.0, np.maximum(one_edge, on_leaf), on_leaf)
    centre = plant[3]
    return np.where(centre > HALF_LIGHT_LEVEL * level, gain, -OPEN_COST), centre


def _heading(line: FloatArray, s: FloatArray, safe: int, reach_px: float) -> tuple[float, float]:
    """Direction (rad, x right, y down) of the line at a point, and its bend (rad per px) over the reach below it."""
    below = min(int(np.searchsorted(s, max(0.0, s[safe] - reach_px))), safe - 2)
    below = max(0, below)
    middle = (below + safe) // 2
    first, second = line[middle] - line[below], line[safe] - line[middle]
    if not (np.any(first) and np.any(second)):
        return -np.pi / 2, 0.0
    a, b = np.arctan2(first[1], first[0]), np.arctan2(second[1], second[0])
    turn = float((b - a + np.pi) % (2 * np.pi) - np.pi)
    bend = turn / max(1.0, 0.5 * float(s[safe] - s[below]))
    return float(b) + 0.25 * bend * float(s[safe] - s[below]), bend
