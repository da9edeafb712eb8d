"""Numbers of the path method, in one place."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from flora_common.runs import Px
from flora_common.vision.picture import Reduction

PositiveCm = Annotated[float, msgspec.Meta(gt=0.0, le=50.0)]


class PathSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[stem.path]``; lengths in cm of the plant's plane.

    Attributes:
        reduction: pictures are looked at in 1/reduction of their size; if left out, as small as leaves the widest stem
            11 px (:mod:`flora_common.vision.path.reduced`).
        window_px: the plant is looked for in (x0, y0, x1, y1) px of the full picture; everywhere if left out.
        widest_stem_cm: what is thicker is leaf, never stem.
        longest_gap_cm: a stem is followed behind a leaf for this far.
        hidden_base_cm: the lowest part that a rim may hide, or that looks like what is behind it.
        below_anchor_cm: how far below the anchor's height a stem may hang. Soil and pot lie there.
        jump_cm: where the tip or another part of the stem moved by more than this, besides what
            ``fastest_cm_per_h`` allows, it is reported as ``jumped``.
        fastest_cm_per_h: how fast a tip may move.
        points: whether the ten points are even in height (``y``, the convention of ``track.csv``) or along the stem
            (``arc``).
    """

    reduction: Reduction | None = None
    window_px: tuple[Px, Px, Px, Px] | None = None
    widest_stem_cm: PositiveCm = 0.6
    longest_gap_cm: PositiveCm = 5.0
    hidden_base_cm: PositiveCm = 2.5
    below_anchor_cm: Annotated[float, msgspec.Meta(ge=0.0, le=50.0)] = 0.0
    jump_cm: Annotated[float, msgspec.Meta(gt=0.0, le=500.0)] = 0.4
    fastest_cm_per_h: PositiveCm = 9.0
    points: Literal["y", "arc"] = "y"
