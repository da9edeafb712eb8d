"""A picture looked at several times, where nothing or little is known from pictures before: then one picture decides.

The network sees a mirrored picture as well as any, and a larger one, and is not wrong in quite the same way: the mean
of what it says is right more often than any of it (docs/decisions/0019). Plants that are followed for longer are looked
at once, and again in every hour.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.vision.path import guide
from flora_common.vision.path.evidence import Evidence
from flora_common.vision.path.guide import Maps, Way

MAGNIFIED: Final = 4.0 / 3.0
WEIGHTS: Final = (2.0, 2.0, 1.0, 1.0)
"""Of plain and mirrored, of both magnified: the network learnt from plants of the first two's size."""


def closely(evidence: Evidence, anchor_px: FloatArray, px_per_cm: float) -> tuple[Way, ...]:
    """What :func:`.guide.everywhere` tells, by the mean of four looks: as it is, mirrored, and both magnified.

    Args:
        evidence: of the plant.
        anchor_px: where the stem begins, (x, y) px of the full picture.
        px_per_cm: scale.
    """
    anchor = np.asarray(anchor_px, dtype=np.float64)
    plain = Maps(evidence, px_per_cm, anchor, guide.SEEN_CM)
    mirrored, exchanged = evidence.mirrored(), evidence.mirrored_px
    places = plain.places()
    there, opposite = exchanged(places), exchanged(anchor)
    looks = (
        plain.logits,
        Maps(mirrored, px_per_cm, opposite, guide.SEEN_CM).logits_at(there),
        _magnified(evidence, anchor, px_per_cm).logits_at(places),
        _magnified(mirrored, opposite, px_per_cm).logits_at(there),
    )
    return guide.ways(plain.believed(np.average(looks, axis=0, weights=WEIGHTS)), anchor, px_per_cm)


def _magnified(evidence: Evidence, anchor_px: FloatArray, px_per_cm: float) -> Maps:
    """The maps of the same part of the picture, as if it had been taken from nearer by."""
    return Maps(evidence, px_per_cm / MAGNIFIED, anchor_px, guide.SEEN_CM * MAGNIFIED)
