"""Where the apex went since the picture before, told by how it looks.

Among young leaves the end of a stem is measured to a millimetre at best, and a little otherwise in every picture. But
the apex and its leaves look in one picture as they did in the one before, and move as one. So a small piece of picture
round the tip is found again, to a pixel by correlation and then to a small fraction of one by the method of Lucas and
Kanade (1981; in the inverse form of Baker and Matthews 2004, freed of changes of light). That tells how far the tip
moved to a tenth of a millimetre, not where it is; where it is, is told by all measurements together, each carried along
with the apex (a Kalman filter, 1960, for its place).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import msgspec
import numpy as np

from flora_common.arrays import Float32Array, FloatArray
from flora_common.geometry import arc_length
from flora_common.vision.path.evidence import Evidence
from flora_common.vision.path.nearby import LONGEST_S
from flora_common.vision.picture import Picture

SPREAD_CM: Final = 0.3
"""Standard deviation of the weights about the tip: less is bare stem, which slides along itself; more is old leaves."""
HALF_SPREADS: Final = 2.0
"""Half a side of the piece of picture, in spreads."""
GLANCE_SPREADS: Final = 1.5
"""The same of what is looked for to a pixel."""
REACH_CM: Final = 1.2
"""So far a tip moves from one picture to the next, at most."""
LEAST_ALIKE, SURELY_ALIKE = 0.85, 0.95
"""Correlation; apices of which one is known to be the other seldom have less than the second."""
NEAR_SHARE: Final = 0.35
"""Of that reach: so near it is looked for first."""
MOST_STEPS, CLOSE_PX, MOST_OFF_PX = 12, 0.01, 2.0
"""Of the search for a fraction of a pixel; one that leads farther from where it set out has lost the apex."""
MOVED_ERROR_CM, MOVED_ERROR_S, MOVED_ERROR_SHARE = 0.02, 300.0, 0.04
"""Standard deviation of a motion over so many seconds, in proportion longer after more, for a stem grows out of the
leaves that it is told by; and share of it: a tip that swings turns, too, and its leaves before it."""
MEASURED_ERROR_CM: Final = 0.1
"""Standard deviation of a measured tip."""
BELIEVED_CM: Final = 0.3
"""What is measured farther from where the apex went counts as if it were so far off: it likely is a leaf's tip."""
FAR_CM: Final = 0.5
"""What is measured farther off is another thing."""
KNOWN_FROM, MOST_SURE = 4, 12
"""An apex is known after so many pictures in which nothing was doubtful; more than the second count no more."""
SECTION_CM: Final = 1.8
"""So much of the line's end is bent to where the tip is."""
_EDGE: Final = np.ones((3, 3), np.uint8)
_HALF_RIGHT, _HALF_DOWN = np.array([0.5, 0.0]), np.array([0.0, 0.5])
_WORST: Final = 1e4
"""Condition of the equations for a motion: a piece without structure across some direction tells nothing of that."""
_FLAT: Final = 1e-6
"""Variance of a channel in which there is nothing to see."""


class Apex(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What is remembered of an apex.

    Attributes:
        time_s: of the picture.
        tip_px: where it is believed to be, px of the full picture.
        var_px: variance of either coordinate, square px.
        corner_px: the first pixel (x, y) of the piece of picture round it.
        code: that piece in logarithmic code, and where there is plant in it, shape (side, side, 4), uint8.
        side: of it, px.
        sure: pictures in which it was the end of a stem beyond doubt, less those in which it was not.
    """

    time_s: float
    tip_px: tuple[float, float]
    var_px: float
    corner_px: tuple[int, int]
    code: bytes
    side: int
    sure: int = 0

    def __post_init__(self) -> None:
        """What was stored may be damaged.

        Raises:
            ValueError: the piece is not as large as it says, or the tip not in its middle.
        """
        off = np.array(self.tip_px) - np.array(self.corner_px) - self.side // 2
        if self.side % 2 == 0 or len(self.code) != 4 * self.side**2 or not np.abs(off).max() <= 1.0:
            raise ValueError("apex: no piece of picture round a tip")


@dataclass(frozen=True, slots=True)
class _Piece:
    """A piece of picture.

    Attributes:
        code: shape (side, side, 3).
        plant: shape (side, side), 1 where there is plant, or its edge, and 0 elsewhere.
        tip: where the tip is in it, (x, y) px.
    """

    code: Picture
    plant: Float32Array
    tip: FloatArray


class Followed:
    """The apex of the picture before, in this one.

    Args:
        before: as it was; None where nothing is known of it.
        evidence: of this picture.
        time_s: of this picture.
        px_per_cm: scale.

    Attributes:
        there: where it is now, (x, y) px of the full picture; None where it was not found.
    """

    def __init__(self, before: Apex | None, evidence: Evidence, time_s: float, px_per_cm: float) -> None:
        self._before, self._evidence, self._time_s, self._scale = before, evidence, time_s, px_per_cm
        can_be = before is not None and before.sure > 0 and 0.0 <= time_s - before.time_s <= LONGEST_S
        self.there = found_again(before, evidence, px_per_cm) if before is not None and can_be else None
        self._error = (MEASURED_ERROR_CM * px_per_cm) ** 2

    def is_near(self, tip_px: FloatArray) -> bool:
        """Whether it was found, and a measured tip can be a measurement of it."""
        return self.there is not None and math.dist(tip_px, self.there) <= FAR_CM * self._scale

    @property
    def is_known(self) -> bool:
        """Whether it was found, and was plain to see as the end of the stem for some pictures."""
        return self._before is not None and self.there is not None and self._before.sure >= KNOWN_FROM

    def is_astray(self, tip_px: FloatArray) -> bool:
        """Whether it is known, and a tip lies elsewhere."""
        return self.is_known and not self.is_near(tip_px)

    def drawn(self, line: FloatArray) -> FloatArray:
        """The line of the picture before, shape (n, 2), with its end where the apex is now."""
        return line if self.there is None else drawn_to(line, self.there, SECTION_CM * self._scale)

    def believed(self, line: FloatArray) -> tuple[FloatArray, Apex | None]:
        """A line that was measured in this picture, its end where all pictures together say; and what is remembered.

        One that went astray is left as it is.
        """
        measured = line[-1]
        if self.is_astray(measured):
            assert self.there is not None
            return line, self._remembered(self.there, self._moved_var())
        if self.there is None or not self.is_near(measured):
            return line, apex_at(self._evidence, self._time_s, measured, self._error, self._scale)
        prior = self._moved_var()
        gain = prior / (prior + self._error)
        off = measured - self.there
        tip = self.there + gain * off * min(1.0, BELIEVED_CM * self._scale / max(1e-9, math.hypot(*off)))
        return drawn_to(line, tip, SECTION_CM * self._scale), self._remembered(tip, (1.0 - gain) * prior)

    def _moved_var(self) -> float:
        assert self._before is not None
        assert self.there is not None
        moved_px = math.dist(self.there, self._before.tip_px)
        grown = MOVED_ERROR_CM * self._scale * max(1.0, (self._time_s - self._before.time_s) / MOVED_ERROR_S)
        return self._before.var_px + grown**2 + (MOVED_ERROR_SHARE * moved_px) ** 2

    def _remembered(self, tip_px: FloatArray, var_px: float) -> Apex | None:
        assert self._before is not None
        return apex_at(self._evidence, self._time_s, tip_px, var_px, self._scale, self._before.sure)


def judged(apex: Apex, *, is_sure: bool) -> Apex:
    """What is remembered after a picture in which it was, or was not, the end of a stem beyond doubt."""
    return msgspec.structs.replace(apex, sure=min(MOST_SURE, apex.sure + 1) if is_sure else max(0, apex.sure - 1))


def found_again(before: Apex, evidence: Evidence, px_per_cm: float) -> FloatArray | None:
    """The place (x, y) in a picture, px, to which the tip of an earlier one has moved; None where it cannot be told."""
    spread = SPREAD_CM * px_per_cm
    piece = np.frombuffer(before.code, np.uint8).reshape(before.side, before.side, 4)
    plant = np.asarray(piece[..., 3] > 0, dtype=np.float32)
    old = _Piece(np.ascontiguousarray(piece[..., :3]), plant, np.array(before.tip_px) - before.corner_px)
    origin = np.array(evidence.origin_px, dtype=np.float64)
    start = _to_a_pixel(old, evidence.code, np.array(before.tip_px) - origin, spread, REACH_CM * px_per_cm)
    if start is None:
        return None
    end = _to_a_fraction(old, evidence.code, start, spread)
    return None if end is None else end + origin


def apex_at(
    evidence: Evidence, time_s: float, tip_px: FloatArray, var_px: float, px_per_cm: float, sure: int = 0
) -> Apex | None:
    """What is remembered of an apex; None where it is too near to the edge of what was looked at."""
    half = math.ceil(HALF_SPREADS * SPREAD_CM * px_per_cm) + 1
    corner = np.rint(tip_px).astype(int) - half
    x, y = corner - evidence.origin_px
    side = 2 * half + 1
    height, width = evidence.code.shape[:2]
    if min(x, y) < 0 or x + side > width or y + side > height:
        return None
    rows, columns = slice(y, y + side), slice(x, x + side)
    plant = cv2.dilate(np.asarray(evidence.plant[rows, columns] > 0.0, dtype=np.uint8), _EDGE)
    code = np.dstack([evidence.code[rows, columns], plant]).tobytes()
    tip = float(tip_px[0]), float(tip_px[1])
    return Apex(time_s, tip, var_px, (int(corner[0]), int(corner[1])), code, side, sure)


def drawn_to(line: FloatArray, tip_px: FloatArray, section_px: float) -> FloatArray:
    """A line whose last section is bent so that it ends at another place, which is near; shape (n, 2), px."""
    s = arc_length(line)
    share = np.clip((s - (s[-1] - section_px)) / section_px, 0.0, 1.0)[:, None] ** 2
    return np.asarray(line + share * (tip_px - line[-1]), dtype=np.float64)


def _to_a_pixel(old: _Piece, code: Picture, tip: FloatArray, spread: float, reach: float) -> FloatArray | None:
    """The place in ``code`` that looks most like the tip of the old piece, near ``tip``; None where none does."""
    half = math.ceil(GLANCE_SPREADS * spread)
    x, y = (int(v) for v in np.rint(old.tip))
    part = slice(max(0, y - half), y + half + 1), slice(max(0, x - half), x + half + 1)
    sought, plant = old.code[part], old.plant[part]
    side = 2 * half + 1
    if sought.shape[:2] != (side, side) or not plant.any():
        return None
    mask = np.dstack([plant] * 3)
    # most tips move by little, and there is little else that looks so much like one
    for far, least in ((NEAR_SHARE * reach, SURELY_ALIKE), (reach, LEAST_ALIKE)):
        x0, y0 = (int(v) for v in np.maximum(0, np.rint(tip) - half - math.ceil(far)))
        x1, y1 = (int(v) for v in np.rint(tip) + half + math.ceil(far) + 1)
        there = code[y0 : max(0, y1), x0 : max(0, x1)]
        if min(there.shape[:2]) < side:
            continue
        likeness = cv2.matchTemplate(there, sought, cv2.TM_CCOEFF_NORMED, mask=mask)
        _, alike, _, at = cv2.minMaxLoc(np.where(np.isfinite(likeness), likeness, 0.0))
        if alike >= least:
            return np.asarray(np.array([x0, y0]) + at + half + old.tip - np.array([x, y]), dtype=np.float64)
    return None


def _to_a_fraction(old: _Piece, code: Picture, start: FloatArray, spread: float) -> FloatArray | None:
    """The same to a small fraction of a pixel; None where that leads elsewhere.

    Sums are written out: products of matrices come to other last digits wherever else in memory their numbers lie, and
    the same pictures must give the same bytes.
    """
    half = math.ceil(HALF_SPREADS * spread)
    steps = np.arange(-half, half + 1, dtype=np.float32)
    dx, dy = np.meshgrid(steps, steps)
    # nothing where what stands still is behind the plant
    weight = (np.exp(-(dx**2 + dy**2) / (2.0 * spread**2)) * _at(old.plant, old.tip, dx, dy)).astype(np.float64)
    weight = weight[..., None] / weight.sum()

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray((weight * values).sum(axis=(0, 1)), dtype=np.float64)

    own = _at(old.code, old.tip, dx, dy).astype(np.float64)
    light = own - mean(own)
    strength = np.maximum(mean(light**2), _FLAT)

    def freed(values: FloatArray) -> FloatArray:
        """Of what a change of light would do to each channel, shape (side, side, 3)."""
        rest = values - mean(values)
        return np.asarray(rest - mean(light * rest) / strength * light, dtype=np.float64)

    along, down = (
        freed(_at(old.code, old.tip + by, dx, dy).astype(np.float64) - _at(old.code, old.tip - by, dx, dy))
        for by in (_HALF_RIGHT, _HALF_DOWN)
    )
    xx, xy, yy = (float(mean(product).sum()) for product in (along * along, along * down, down * down))
    middle, away = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    least, most = middle - away, middle + away
    if not least > most / _WORST:
        return None
    place = start
    for _ in range(MOST_STEPS):
        off = _at(code, place, dx, dy) - own
        x, y = (float(mean(slope * off).sum()) for slope in (along, down))
        step = np.array([yy * x - xy * y, xx * y - xy * x]) / (xx * yy - xy * xy)
        place = place - step
        if not math.dist(place, start) < MOST_OFF_PX:
            return None
        if math.hypot(*step) < CLOSE_PX:
            break
    return np.asarray(place, dtype=np.float64)


def _at(code: Picture | Float32Array, place: FloatArray, dx: Float32Array, dy: Float32Array) -> Float32Array:
    """Values of a picture about a place, linear between pixels."""
    x, y = (dx + place[0]).astype(np.float32), (dy + place[1]).astype(np.float32)
    found = cv2.remap(code, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, dtype=np.float32)
