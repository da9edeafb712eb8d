"""Which of the thin pieces are the stem, and in what order.

A stem starts at the anchor, goes on smoothly, keeps its width, passes behind leaves, and ends freely; a petiole leaves
it at an angle, is thinner, and ends in a leaf. Every chain of pieces from the anchor has a worth in centimetres: the
length that is seen, less what must be believed to put the pieces together. A search over beams finds the best.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.geometry import distance_to_polyline_cm, unit
from flora_common.runs import CameraSection
from flora_common.vision.path.links import PLANT_GAP_COST, SHORT_GAP_CM, TURN_COST, covered, links_between
from flora_common.vision.path.nodes import Node, angle, upper_median
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.path.strands import End, Strand, Strands, part
from flora_common.vision.path.survey import nearest_in_window, window_box

END_COST: Final = {End.FREE: 0.0, End.BRANCH: 0.3, End.LEAF: 0.9}
"""For a stem whose last piece ends like this."""
SURE_LEAF_COST: Final = 0.2
"""The same for one that is no petiole: a stalk that never branches before its leaf or flower, a band on a leaf."""
ALONG_WINDOW: Final = 0.3
"""Share that a piece along the window's edge is worth: the edge cuts leaves, and what is left looks thin."""
LAST_FULL_CM, LAST_SHARE = 1.0, 0.7
"""What is longer than the first counts by the second at the end of a chain: a long petiole is no better a stem than a
short apex, and how it leaves the stem must decide."""
BASE_GAP_COST: Final = 0.3
BASE_TURN_COST: Final = 0.3
STRAIGHT_UP: Final = np.array([0.0, -1.0])
TIP_MOVE_COST: Final = 1.2
KEEPS_PLACE: Final = 1.15
LOSES_PLACE: Final = 0.85
RIVAL_CM: Final = 1.0
"""A chain that ends farther off than this is another answer."""
SAMPLES: Final = 10
BEAMS: Final = 24
MOST_CANDIDATES: Final = 40
FAINT_STRENGTH: Final = 25.0
MOST_PIECES: Final = 10


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """Pieces of stem in order from the anchor.

    Attributes:
        pieces: each from its lower to its upper end.
        points: shape (n, 2), px of the full picture: the anchor, then all points of the pieces.
        width: shape (n,), px; NaN at the anchor.
        piece: shape (n,), index of the piece that each point is of; -1 at the anchor.
        worth_cm: of the chain, see above.
        solid_cm: the same without what its direction at the anchor and its end cost: how well the pieces hang together.
        rival_cm: worth of the best chain that ends elsewhere; how clear the choice was.
        end: how the last piece ends.
    """

    pieces: tuple[Strand, ...]
    points: FloatArray
    width: FloatArray
    piece: FloatArray
    worth_cm: float
    solid_cm: float
    rival_cm: float
    end: End

    @property
    def strength(self) -> float:
        """The evidence along its pieces, median."""
        return float(np.median(np.concatenate([piece.strength for piece in self.pieces])))


@dataclass(frozen=True, slots=True, eq=False)
class Before:
    """The stem in the picture before.

    Attributes:
        line_px: shape (n, 2), px of the full picture, anchor first, tip last.
        trust: 0..1, how much it counts: that of a stem of which little was seen counts little.
    """

    line_px: FloatArray
    trust: float = 1.0


_Beam = tuple[float, tuple[int, ...], Node, bool]
"""Worth of a chain, its nodes, the longest of them, and whether the last is stem: no chain ends in another thing."""


def _worth(beam: _Beam) -> float:
    return beam[0]


def best_chain(
    found: Strands, camera: CameraSection, settings: PathSettings, before: Before | None = None
) -> Chain | None:
    """The chain of the highest worth; None where no piece begins near the anchor.

    Args:
        found: the pieces and the mask of the plant.
        camera: anchor and scale.
        settings: window, and gaps that may be bridged.
        before: the stem in the picture before, which this one resembles.
    """
    px_per_cm, anchor = camera.px_per_cm, np.array(camera.anchor_px, dtype=np.float64)
    seen_from = np.array(nearest_in_window(camera, settings), dtype=np.float64)
    pieces = sorted(_from_anchor(found.pieces, anchor, px_per_cm), key=_weight, reverse=True)[:MOST_CANDIDATES]
    nodes: list[Node] = []
    for i, piece in enumerate(pieces):
        nodes.append(Node(i, piece, px_per_cm))
        nodes.append(Node(i, piece.reversed(), px_per_cm, nodes[-1]))
    if not nodes:
        return None
    _weigh(nodes, before, px_per_cm)
    _doubt_window_edge(nodes, camera, settings)
    links = links_between(nodes, found, px_per_cm, settings)
    beams: list[_Beam] = []
    starts = np.array([node.start for node in nodes])
    over = np.column_stack(covered(np.broadcast_to(seen_from, starts.shape), starts, found)).tolist()
    for k, (node, (over_leaf, over_thin)) in enumerate(zip(nodes, over, strict=True)):
        cost = _first_cost(node, over_leaf, over_thin, seen_from, px_per_cm, settings)
        if cost is not None:
            beams.append((node.reward - cost, (k,), node, True))
    finals: list[tuple[float, tuple[int, ...]]] = []
    last_cost = {only: [_last_cost(n, before, px_per_cm, only=only) for n in nodes] for only in (True, False)}
    for _ in range(MOST_PIECES):
        finals += [
            (worth - last_cost[len(chain) == 1][chain[-1]], chain) for worth, chain, _, is_stem in beams if is_stem
        ]
        longer: list[_Beam] = []
        for worth, chain, longest, _ in beams:
            used = {k // 2 for k in chain}
            for to, cost in links[chain[-1]]:
                if to // 2 not in used:
                    node = nodes[to]
                    seen = node.reward_after(longest, nodes[chain[-1]])
                    longer_one = node if node.length_cm > longest.length_cm else longest
                    longer.append((worth + seen - cost, (*chain, to), longer_one, seen > 0.0))
        longer.sort(key=_worth, reverse=True)
        beams = longer[:BEAMS]
        if not beams:
            break
    if not finals:
        return None
    worth, chain = max(finals, key=lambda item: item[0])
    tip = nodes[chain[-1]].end
    elsewhere = [
        w for w, c in finals if math.dist(nodes[c[-1]].end, tip) > RIVAL_CM * px_per_cm and c != chain[: len(c)]
    ]
    base_turn = BASE_TURN_COST * float(angle(STRAIGHT_UP, nodes[chain[0]].start_direction)) ** 2
    solid = worth + last_cost[len(chain) == 1][chain[-1]] + base_turn
    return _joined([nodes[k].strand for k in chain], anchor, worth, solid, max(elsewhere, default=-math.inf))


def _weight(piece: Strand) -> float:
    """What a piece could add to a chain: long and clear ones first, specks of noise last."""
    return len(piece.points) * min(1.0, upper_median(piece.strength) / FAINT_STRENGTH)


def _joined(pieces: Sequence[Strand], anchor: FloatArray, worth: float, solid: float, rival: float) -> Chain:
    return Chain(
        tuple(pieces),
        np.concatenate([anchor[None, :], *[p.points for p in pieces]]),
        np.concatenate([[np.nan], *[p.width for p in pieces]]),
        np.concatenate([[-1.0], *[np.full(len(p.points), float(i)) for i, p in enumerate(pieces)]]),
        worth,
        solid,
        rival,
        pieces[-1].ends[1],
    )


def _from_anchor(pieces: Sequence[Strand], anchor: FloatArray, px_per_cm: float) -> list[Strand]:
    """The pieces; one that passes the anchor is cut there, for what lies beyond is no stem."""
    out = []
    for piece in pieces:
        away = np.hypot(*(piece.points - anchor).T)
        k = int(np.argmin(away))
        inside = 4 <= k < len(piece.points) - 4
        if away[k] < 0.35 * px_per_cm and inside:
            out += [
                part(piece, slice(k, None), (End.FREE, piece.ends[1])),
                part(piece, slice(0, k + 1), (piece.ends[0], End.FREE)),
            ]
        else:
            out.append(piece)
    return out


def _weigh(nodes: Sequence[Node], before: Before | None, px_per_cm: float) -> None:
    """A piece that lies where the stem was counts more than its length, one that lies elsewhere less."""
    if before is None:
        return
    samples = [
        node.strand.points[np.linspace(0, len(node.strand.points) - 1, SAMPLES).astype(int)] for node in nodes[::2]
    ]
    away = distance_to_polyline_cm(np.concatenate(samples), before.line_px) / px_per_cm
    shares = np.clip((0.7 - away) / 0.5, 0.0, 1.0).reshape(-1, SAMPLES).mean(axis=1)
    for node, share in zip(nodes[::2], shares.tolist(), strict=True):
        factor = LOSES_PLACE + (KEEPS_PLACE - LOSES_PLACE) * share
        node.reward *= 1.0 + before.trust * (factor - 1.0)
    for node, twin in zip(nodes[::2], nodes[1::2], strict=True):
        twin.reward = node.reward


def _doubt_window_edge(nodes: Sequence[Node], camera: CameraSection, settings: PathSettings) -> None:
    if settings.window_px is None:
        return
    rows, columns = window_box(camera, settings)
    near = 0.5 * settings.widest_stem_cm * camera.px_per_cm
    for node in nodes:
        x, y = node.strand.points.T
        inside = np.minimum(np.minimum(x - columns.start, columns.stop - 1 - x), np.minimum(y, rows.stop - 1 - y))
        if np.mean(inside < near) > 0.5:
            node.reward *= ALONG_WINDOW


def _first_cost(
    node: Node, over_leaf: float, over_thin: float, anchor: FloatArray, px_per_cm: float, settings: PathSettings
) -> float | None:
    """What it costs to believe that the stem begins with this piece; None where it is too far from the anchor.

    ``over_leaf`` and ``over_thin`` are the shares of the way to it over leaves and over other plant, ``anchor`` is the
    place in the window that is nearest to the anchor.
    """
    gap = node.start - anchor
    gap_cm = float(np.hypot(*gap)) / px_per_cm
    if gap_cm > max(settings.hidden_base_cm, settings.longest_gap_cm):
        return None
    if gap_cm * (1.0 - over_leaf) > settings.hidden_base_cm:
        return None
    turn = float(angle(STRAIGHT_UP, node.start_direction))
    cost = gap_cm * (BASE_GAP_COST + PLANT_GAP_COST * over_thin) + BASE_TURN_COST * turn**2
    if gap_cm > SHORT_GAP_CM:
        cost += TURN_COST * 0.5 * float(angle(unit(gap), node.start_direction)) ** 2
    return cost


def _last_cost(node: Node, before: Before | None, px_per_cm: float, *, only: bool) -> float:
    end = node.strand.ends[1]
    if end is End.LEAF and (node.strand.on_leaf > 0.5 or (only and node.strand.ends[0] is End.FREE)):
        cost = SURE_LEAF_COST
    else:
        cost = END_COST[end]
    cost += (1.0 - LAST_SHARE) * max(0.0, node.reward - LAST_FULL_CM)
    if before is not None:
        cost += before.trust * TIP_MOVE_COST * min(1.5, math.dist(node.end, before.line_px[-1]) / px_per_cm)
    return cost
