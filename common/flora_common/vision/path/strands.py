"""The thin pieces of a plant's picture: lengths of stem, petioles, edges of leaves seen from the side.

What is wider than any stem is leaf and taken out first; the rest is thinned to lines, and these are cut where they
branch. Each piece keeps its width and how it ends, by which the pieces of the stem are told from the others.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from flora_common.arrays import ByteArray, FloatArray
from flora_common.geometry import polyline_length
from flora_common.vision.path.evidence import Evidence
from flora_common.vision.path.thinning import neighbour_offsets, thin

LOCAL_SHARE: Final = 0.40
"""Of the strongest evidence nearby, a pixel needs this share to belong to the plant: edges lie at the half."""
RIDGE_LEAST, RIDGE_NOISE = 7.0, 3.0
"""A stem on a leaf stands out by so many code units, and by so many standard deviations."""
APART: Final = 1.3
"""In scatters of both: how far apart the colours of stem and leaf must lie."""
CORNER_ARM, CORNER_RAD = 0.6, 1.0
"""A corner turns by more than this between arms so many widths of the widest stem long."""
CUT_GREENER: Final = 13.0
"""Code units by which a piece turns greener, at least, where it is cut: a leaf begins there."""
MOST_PIECES: Final = 60
"""The shortest are left out beyond: specks of noise come in hundreds."""
KNOT_AREA: Final = 2.2
"""In squares of the disc's side: smaller wide places are no leaves."""
SHORTEST: Final = 0.2
"""In widths of the widest stem: shorter pieces are crumbs."""


class End(enum.Enum):
    """How a strand ends."""

    FREE = enum.auto()
    BRANCH = enum.auto()
    """Others begin there too."""
    LEAF = enum.auto()
    """A leaf begins there."""


@dataclass(frozen=True, slots=True, eq=False)
class Strand:
    """A piece of skeleton without branches.

    Attributes:
        points: shape (n, 2), x and y in px of the full picture, from one end to the other.
        width: shape (n,), px.
        strength: shape (n,), evidence of plant.
        green: shape (n,), how much greener than red it is, code units: leaves are greener than what bears them.
        on_leaf: share of it that lies on a leaf.
        ends: what the first and the last point are.
    """

    points: FloatArray
    width: FloatArray
    strength: FloatArray
    green: FloatArray
    on_leaf: float
    ends: tuple[End, End]

    @property
    def length(self) -> float:
        """Along its points, px."""
        return float(polyline_length(self.points))

    def reversed(self) -> Strand:
        """The same from the other end."""
        return Strand(
            self.points[::-1],
            self.width[::-1],
            self.strength[::-1],
            self.green[::-1],
            self.on_leaf,
            (self.ends[1], self.ends[0]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Strands:
    """What was found in a picture.

    Attributes:
        pieces: the strands.
        mask: shape (height, width), 1 where there is plant; first pixel at ``origin_px``.
        leaf: the same shape, 1 where the plant is wider than a stem.
        origin_px: as in :class:`Evidence`.
    """

    pieces: tuple[Strand, ...]
    mask: ByteArray
    leaf: ByteArray
    origin_px: tuple[int, int]


def find_strands(evidence: Evidence, *, widest_px: float, foot_px: tuple[float, float]) -> Strands:
    """All thin pieces of a plant's picture.

    Args:
        evidence: of the picture.
        widest_px: what is wider than this is leaf.
        foot_px: place in the full picture near which the stem begins.
    """
    mask = plant_mask(evidence, widest_px)
    leaf = _wide_parts(mask, widest_px)
    narrow = np.asarray(cv2.subtract(mask, leaf), dtype=np.uint8)
    whole_leaf = leaf
    if leaf.any():
        on_leaf = _ridges(evidence, leaf, widest_px) | _stem_coloured(evidence, mask, narrow, leaf, widest_px, foot_px)
        narrow, leaf = narrow | on_leaf, np.asarray(cv2.subtract(leaf, on_leaf), dtype=np.uint8)
    distance = _distance(narrow)
    skeleton = thin(narrow)
    to_leaf = _distance(1 - leaf) if leaf.any() else None
    ox, oy = evidence.origin_px
    lines, branchings = _branches(skeleton)
    pieces = []
    arm = max(4, round(CORNER_ARM * widest_px))
    parts = [cut for line in lines for cut in _without_corners(*line, arm) if len(cut[0]) >= 3]
    for rows, columns in sorted(parts, key=lambda cut: len(cut[0]), reverse=True)[:MOST_PIECES]:
        # half of a pixel lies outside its middle on either side
        width = 2.0 * distance[rows, columns] - 0.5
        ends = (
            _kind_of_end(rows[0], columns[0], width, to_leaf, branchings),
            _kind_of_end(rows[-1], columns[-1], width, to_leaf, branchings),
        )
        places = np.column_stack([columns + float(ox), rows + float(oy)])
        strength = evidence.plant[rows, columns].astype(np.float64)
        tint = evidence.code[rows, columns].astype(np.float64)
        leaf_share = float(whole_leaf[rows, columns].mean())
        whole = Strand(places, width, strength, tint[:, 1] - tint[:, 2], leaf_share, ends)
        pieces += [piece for piece in _by_colour(whole, arm) if piece.length >= SHORTEST * widest_px]
    return Strands(tuple(pieces), mask, whole_leaf, evidence.origin_px)


def plant_mask(evidence: Evidence, widest_px: float) -> ByteArray:
    """1 where there is plant: a clear share of the strongest evidence nearby, so that edges fall where they are."""
    side = max(3, round(widest_px)) | 1
    strongest = cv2.dilate(cv2.GaussianBlur(evidence.plant, (0, 0), 1.0), np.ones((side, side), np.uint8))
    mask = ((evidence.plant > LOCAL_SHARE * strongest) & (evidence.plant > 0)).astype(np.uint8)
    return np.asarray(cv2.medianBlur(mask, 3), dtype=np.uint8)


def _wide_parts(mask: ByteArray, widest_px: float) -> ByteArray:
    """Leaves. A knot where petioles leave the stem is wide too, but hardly larger than the disc that it holds."""
    side = max(3, round(1.15 * widest_px)) | 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    wide = cv2.morphologyEx(mask, cv2.MORPH_OPEN, disc)
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(wide, connectivity=8)
    keep = statistics[:, cv2.CC_STAT_AREA] > KNOT_AREA * side**2
    keep[0] = False
    return np.asarray(keep.astype(np.uint8)[labels], dtype=np.uint8)


def _ridges(evidence: Evidence, leaf: ByteArray, widest_px: float) -> ByteArray:
    """Bands on leaves, no wider than a stem, that are brighter or darker than what lies on both their sides.

    A stem in front of a leaf is one; the veins of the leaf are others, and thinner.
    """
    # outside of the leaf there is no side to compare with: take it to be as bright as leaves are
    tone = evidence.tone.astype(np.uint8)
    tone = np.where(leaf > 0, tone, np.uint8(np.median(tone[leaf > 0])))
    side = max(3, round(1.3 * widest_px)) | 1
    square = np.ones((side, side), np.uint8)
    bright = cv2.morphologyEx(tone, cv2.MORPH_TOPHAT, square)
    dark = cv2.morphologyEx(tone, cv2.MORPH_BLACKHAT, square)
    least = max(RIDGE_LEAST, RIDGE_NOISE * evidence.noise)
    inside = cv2.erode(leaf, np.ones((7, 7), np.uint8))
    found = ((bright > least) | (dark > least)) & (inside > 0)
    return np.asarray(cv2.medianBlur(found.astype(np.uint8), 5), dtype=np.uint8)


def _stem_coloured(
    evidence: Evidence,
    mask: ByteArray,
    narrow: ByteArray,
    leaf: ByteArray,
    widest_px: float,
    foot_px: tuple[float, float],
) -> ByteArray:
    """What on a leaf, or along its edge, has the colour of the stem below rather than the leaf's.

    The stem's colour is that of the narrow parts nearest to its foot, the leaf's that of its inside. Where the two are
    too alike to be told apart, nothing.
    """
    rows, columns = np.nonzero(narrow)
    inside = cv2.erode(leaf, np.ones((5, 5), np.uint8)) > 0
    away = np.hypot(columns + evidence.origin_px[0] - foot_px[0], rows + evidence.origin_px[1] - foot_px[1])
    near = np.argsort(away)[: max(60, round(6.0 * widest_px**2))]
    if len(near) < 60 or not inside.any():
        return np.zeros_like(mask)
    code = evidence.code
    stem = code[rows[near], columns[near]].astype(np.float32)
    blade = code[inside][:: max(1, int(inside.sum()) // 4000)].astype(np.float32)
    off = np.median(stem, axis=0) - np.median(blade, axis=0)
    spread = np.mean([np.abs(v - np.median(v, axis=0)).mean(axis=0) for v in (stem, blade)], axis=0) + 1.0
    weight = off / spread**2
    weight /= max(1e-9, float(np.abs(weight).sum()))
    along = cv2.transform(code, weight.reshape(1, 3).astype(np.float64))
    stem_at, blade_at = float(np.median(stem @ weight)), float(np.median(blade @ weight))
    scatter = 1.25 * (np.abs(stem @ weight - stem_at).mean() + np.abs(blade @ weight - blade_at).mean())
    if abs(stem_at - blade_at) < APART * (scatter + 1.0):
        return np.zeros_like(mask)
    share = (np.asarray(along, dtype=np.float32) - blade_at) / (stem_at - blade_at)
    like = ((share > 0.55) & (share < 1.8) & (mask > 0)).astype(np.uint8)
    like = np.asarray(cv2.medianBlur(like, 3), dtype=np.uint8)
    side = max(3, round(1.15 * widest_px)) | 1
    wide = cv2.morphologyEx(like, cv2.MORPH_OPEN, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))
    found = cv2.subtract(cv2.bitwise_and(like, leaf), wide)
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(found, connectivity=8)
    keep = statistics[:, cv2.CC_STAT_AREA] > 0.5 * widest_px**2
    keep[0] = False
    return np.asarray(keep.astype(np.uint8)[labels], dtype=np.uint8)


def _without_corners(
    rows: npt.NDArray[np.intp], columns: npt.NDArray[np.intp], arm: int
) -> list[tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]]:
    """The line cut at its sharp corners: where a stem fades at a node, its upper part and a petiole look like one."""
    if len(rows) <= 2 * arm:
        return [(rows, columns)]
    p = np.column_stack([columns, rows]).astype(np.float64)
    before, after = p[arm:-arm] - p[: -2 * arm], p[2 * arm :] - p[arm:-arm]
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    turn = np.abs(np.arctan2(cross, (before * after).sum(axis=1)))
    cuts: list[int] = []
    for k in np.argsort(-turn):
        if turn[k] < CORNER_RAD:
            break
        if all(abs(int(k) - other) > arm for other in cuts):
            cuts.append(int(k))
    edges = [0, *sorted(k + arm for k in cuts), len(rows)]
    return [(rows[a:b], columns[a:b]) for a, b in pairwise(edges)]


def _by_colour(piece: Strand, arm: int) -> list[Strand]:
    """The piece cut where it turns greener: there a petiole, or the stem, ends and a leaf begins that is as narrow."""
    if len(piece.points) < 4 * arm:
        return [piece]
    total = np.concatenate([[0.0], np.cumsum(piece.green)])
    mean = (total[arm:] - total[:-arm]) / arm
    step = mean[arm:] - mean[:-arm]
    k = int(np.argmax(np.abs(step)))
    if abs(step[k]) < CUT_GREENER:
        return [piece]
    at, first, last = k + arm, piece.ends[0], piece.ends[1]
    into_leaf = step[k] > 0
    middle = (End.LEAF, End.BRANCH) if into_leaf else (End.BRANCH, End.LEAF)
    below, above = part(piece, slice(0, at), (first, middle[0])), part(piece, slice(at, None), (middle[1], last))
    return [*_by_colour(below, arm), *_by_colour(above, arm)]


def part(piece: Strand, some: slice, ends: tuple[End, End]) -> Strand:
    """Some of a piece, with other ends."""
    return Strand(piece.points[some], piece.width[some], piece.strength[some], piece.green[some], piece.on_leaf, ends)


def _distance(mask: ByteArray) -> FloatArray:
    """From each set pixel to the nearest one that is not."""
    return np.asarray(cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_5), dtype=np.float64)


def _kind_of_end(
    row: np.intp, column: np.intp, width: FloatArray, to_leaf: FloatArray | None, branchings: FloatArray
) -> End:
    # thinning takes half a width off a line's end
    reach = 0.5 * float(np.sort(width)[len(width) // 2]) + 2.5
    if to_leaf is not None and to_leaf[row, column] <= reach:
        return End.LEAF
    if branchings.size and np.abs(branchings - (row, column)).max(axis=1).min() <= 3:
        return End.BRANCH
    return End.FREE


def _branches(skeleton: ByteArray) -> tuple[list[tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]], FloatArray]:
    """Rows and columns of each piece between ends and branchings, in order along it; pieces of 3 pixels at least.

    With them, row and column of each branching, shape (n, 2).
    """
    padded = cv2.copyMakeBorder(skeleton, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    width = padded.shape[1]
    flat = padded.ravel()
    offsets = neighbour_offsets(width)
    places = np.flatnonzero(flat)
    if places.size == 0:
        return [], np.zeros((0, 2))
    # a branching goes with its neighbours: else the walk would step diagonally past it into another branch
    branchings = places[flat[places[:, None] + offsets[None, :]].sum(axis=1) > 2]
    flat[(branchings[:, None] + offsets[None, :]).ravel()] = 0
    flat[branchings] = 0
    places = places[flat[places] > 0]
    left = set(places.tolist())
    steps = [int(o) for o in offsets]
    # straight neighbours first, so that a corner is walked and not cut
    steps = steps[1::2] + steps[0::2]

    def following(at: int) -> int:
        for step in steps:
            if at + step in left:
                return at + step
        return -1

    out = []
    ends = places[flat[places[:, None] + offsets[None, :]].sum(axis=1) <= 1].tolist()
    for start in [*ends, *places.tolist()]:
        if start not in left:
            continue
        walk = [start]
        left.discard(start)
        while (at := following(walk[-1])) >= 0:
            left.discard(at)
            walk.append(at)
        if len(walk) >= 3:
            found = np.array(walk)
            out.append((found // width - 1, found % width - 1))
    return out, np.column_stack([branchings // width - 1, branchings % width - 1]).astype(np.float64)
