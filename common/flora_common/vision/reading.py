"""What comes of one photograph, whatever method looked at it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from flora_common.arrays import FloatArray

PictureOutcome = Literal["ok", "no_stem", "jumped", "occluded", "touches_edge", "bad_picture"]
"""What can come of a picture; the bus has the same names, and one more for a tick without a picture."""

OK: Final = "ok"
NO_STEM: Final = "no_stem"
JUMPED: Final = "jumped"
OCCLUDED: Final = "occluded"
TOUCHES_EDGE: Final = "touches_edge"
BAD_PICTURE: Final = "bad_picture"


@dataclass(frozen=True, slots=True, eq=False)
class StemReading:
    """What came of one picture.

    Attributes:
        outcome: see :data:`PictureOutcome`. Those who read it must expect further ones.
        quality: 0..1, the share of the stem that the picture itself shows; 0 without a stem.
        points_cm: shape (10, 2), finite; anchor (0, 0) first, tip last, x right, y up. None without a stem.
        tip_px: the tip in px of the full picture, x right, y down. None without a stem.
        reason: one clause for people where the outcome is not ``ok``.
        uncertainty_mm: shape (10,), standard deviation of each point; None where the method gives none.
        folded: whether the stem turns back, so that it passes some heights more than once.
        line_px: shape (n, 2), the whole line from anchor to tip, px of the full picture; None where there is none.
        stem_pixels: how many pixels were taken for stem, in the picture as it was looked at.
        tip_choice: of the published method, ``c`` (furthest from the anchor) or ``h`` (highest).
    """

    outcome: PictureOutcome
    quality: float = 0.0
    points_cm: FloatArray | None = None
    tip_px: tuple[float, float] | None = None
    reason: str = ""
    uncertainty_mm: FloatArray | None = None
    folded: bool = False
    line_px: FloatArray | None = None
    stem_pixels: int = 0
    tip_choice: Literal["c", "h"] | None = None


def bad_picture(reason: str) -> StemReading:
    """The reading of a picture that could not be used."""
    return StemReading(BAD_PICTURE, reason=reason)


def no_stem(reason: str) -> StemReading:
    """The reading of a picture without a stem."""
    return StemReading(NO_STEM, reason=reason)
