"""A first picture's end looked at once more, in a mirror.

Where nothing is known from pictures before, one look decides. The network sees a mirrored picture as well as any, and
is not wrong in quite the same way, so that both together tell more. Followed plants are looked at again in every hour.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from flora_common.vision.path import apex_error, guide
from flora_common.vision.path.evidence import Evidence
from flora_common.vision.path.guide import Maps, Way

SAME_APEX_CM: Final = 0.3
"""So far from where it was in the first look the apex is looked for in the second."""


def confirmed(way: Way, evidence: Evidence, px_per_cm: float) -> Way:
    """A way with the chances that it ends elsewhere, as both looks together tell them.

    Args:
        way: that was found, from the anchor.
        evidence: of the plant.
        px_per_cm: scale.
    """
    if way.off is None:
        return way
    middle = np.array([2.0 * evidence.origin_px[0] + evidence.plant.shape[1] - 1.0, 0.0])
    line = middle + way.line_px * [-1.0, 1.0]
    maps = Maps(evidence.mirrored(), px_per_cm, line[0], guide.SEEN_CM)
    along = maps.stem_at(line)
    sure = float(maps.apex[maps.nearest_peak(line[-1], SAME_APEX_CM * px_per_cm)]) * guide.weakest(along)
    elsewhere = maps.likeliest_beyond(line[-1], guide.ELSEWHERE_CM * px_per_cm)
    off = apex_error.perceptron().chances(maps.views(line, along, sure, elsewhere))
    return replace(way, off=apex_error.together(way.off, off))
