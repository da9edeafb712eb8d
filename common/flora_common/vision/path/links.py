"""What it costs to believe that one piece of stem follows another.

In centimetres of stem: a kink of 45 degrees costs some 2 cm, a gap behind a leaf a tenth of its length, a gap where the
empty setup is seen up to thrice its length.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from flora_common.arrays import FloatArray
from flora_common.vision.path.nodes import Node, angle
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.path.strands import Strands

TURN_COST: Final = 3.0
"""Per square radian, at either end of a gap."""
LEAF_GAP_COST: Final = 0.1
PLANT_GAP_COST: Final = 0.3
"""Over what is no wider than a stem, and would have been seen as a piece of its own if it were one."""
FAINT_GAP_COST, CLEAR_GAP_COST = 0.7, 2.8
"""Over the empty setup: a stem may fade where it looks like what is behind it, but not end clearly and begin again."""
CLEAR_STRENGTH: Final = 60.0
LONGEST_OPEN_GAP_CM: Final = 3.0
SIDE_COST: Final = 6.0
"""Per radian by which another piece goes on straighter, from a small angle on."""
SIDE_FREE_RAD: Final = 0.12
NODE_CM: Final = 1.2
SHARPEST_TURN_RAD: Final = 1.0
SHARPEST_OVER_GAP_RAD: Final = 1.4
GENTLE_CM: Final = 1.0
"""Over a longer gap there is room to turn: the cost of turning falls with the gap's length, as the energy of a bent rod
does, and it may turn further."""
WIDTH_COST: Final = 0.4
"""Per square of the natural logarithm of the ratio of widths."""
SHORT_GAP_CM: Final = 0.3
"""Over a gap this short the direction of the gap itself says nothing."""
MOST_LINKS: Final = 7
"""From one piece: the cheapest for what they add."""


def links_between(
    nodes: Sequence[Node], found: Strands, px_per_cm: float, settings: PathSettings
) -> list[list[tuple[int, float]]]:
    """For each node, those that may follow it, and what the link costs."""
    starts, ends = np.array([n.start for n in nodes]), np.array([n.end for n in nodes])
    into, out_of = np.array([n.start_direction for n in nodes]), np.array([n.end_direction for n in nodes])
    gap = starts[None, :, :] - ends[:, None, :]
    length = np.hypot(gap[..., 0], gap[..., 1])
    along = gap / np.maximum(length, 1e-6)[..., None]
    leave, arrive = angle(out_of[:, None, :], along), angle(along, into[None, :, :])
    direct = angle(out_of[:, None, :], into[None, :, :])
    short = length < SHORT_GAP_CM * px_per_cm
    sure = np.array([n.sure for n in nodes])
    leave, arrive = leave * sure[:, None], arrive * sure[None, :]
    direct = direct * np.minimum(sure[:, None], sure[None, :])
    gentle = np.minimum(1.0, GENTLE_CM / np.maximum(length / px_per_cm, 1e-6))
    turning = np.where(short, direct**2, (leave**2 + arrive**2) * gentle)
    worst = np.where(short, direct, np.maximum(np.maximum(leave, arrive), direct))
    index = np.array([n.index for n in nodes])
    possible = (length <= settings.longest_gap_cm * px_per_cm) & (
        worst < np.where(gentle < 1.0, SHARPEST_OVER_GAP_RAD, SHARPEST_TURN_RAD)
    )
    possible &= index[:, None] != index[None, :]
    ratio = np.log(np.array([n.start_width for n in nodes])[None, :] / np.array([n.end_width for n in nodes])[:, None])
    ratio *= np.minimum(sure[:, None], sure[None, :])
    out: list[list[tuple[int, float]]] = [[] for _ in nodes]
    first, second = np.nonzero(possible)
    if first.size == 0:
        return out
    gap_cm = length[first, second] / px_per_cm
    faded = np.minimum(
        np.array([n.end_strength for n in nodes])[first], np.array([n.start_strength for n in nodes])[second]
    )
    gap_cost, open_cm = _gap_cost(ends[first], starts[second], gap_cm, faded, found)
    cost = TURN_COST * turning[first, second] + gap_cost + WIDTH_COST * ratio[first, second] ** 2
    lengths = np.array([n.length_cm for n in nodes])
    cost += _side_cost(first, direct[first, second], gap_cm, ratio[first, second], lengths[second])
    for a, b, c, o in zip(first.tolist(), second.tolist(), cost.tolist(), open_cm.tolist(), strict=True):
        if o <= LONGEST_OPEN_GAP_CM:
            out[a].append((b, c))
    for links in out:
        links.sort(key=lambda link: link[1] - nodes[link[0]].reward)
        del links[MOST_LINKS:]
    return out


def _gap_cost(
    start: FloatArray, end: FloatArray, gap_cm: FloatArray, strength: FloatArray, found: Strands
) -> tuple[FloatArray, FloatArray]:
    """What it costs to bridge gaps (n of them), and how much of each lies over the empty setup, cm."""
    over_leaf, over_thin = covered(start, end, found)
    open_cm = gap_cm * (1.0 - over_leaf - over_thin)
    per_open_cm = FAINT_GAP_COST + (CLEAR_GAP_COST - FAINT_GAP_COST) * np.minimum(1.0, strength / CLEAR_STRENGTH)
    cost = gap_cm * (LEAF_GAP_COST * over_leaf + PLANT_GAP_COST * over_thin) + per_open_cm * open_cm
    return cost, open_cm


def covered(start: FloatArray, end: FloatArray, found: Strands) -> tuple[FloatArray, FloatArray]:
    """Share of each straight line (n of them) that runs over leaves, and over other plant."""
    t = np.linspace(0.0, 1.0, 13)[None, :, None]
    place = start[:, None, :] + t * (end - start)[:, None, :] - np.array(found.origin_px, dtype=np.float64)
    height, width = found.mask.shape
    x = np.clip(np.rint(place[..., 0]).astype(int), 0, width - 1)
    y = np.clip(np.rint(place[..., 1]).astype(int), 0, height - 1)
    leaf = found.leaf[y, x].mean(axis=1)
    return np.asarray(leaf, dtype=np.float64), np.asarray(found.mask[y, x].mean(axis=1) - leaf, dtype=np.float64)


def _side_cost(
    first: npt.NDArray[np.intp], turn: FloatArray, gap_cm: FloatArray, ratio: FloatArray, length_cm: FloatArray
) -> FloatArray:
    """What it costs to leave the straightest way: where two pieces go on, the petiole is the one that leaves aside.

    Args:
        first: for each link, from which piece it leads; likewise the others, of the piece to which it leads.
    """
    straight = np.full(int(first.max()) + 1, np.inf)
    stem_like = (gap_cm < NODE_CM) & (length_cm > 0.5) & (ratio > np.log(0.6)) & (ratio < np.log(1.3))
    np.minimum.at(straight, first[stem_like], turn[stem_like])
    return np.asarray(SIDE_COST * np.maximum(0.0, turn - straight[first] - SIDE_FREE_RAD), dtype=np.float64)
