"""Whether the stem may end elsewhere than where it is followed, as other places and its surroundings looked lately.

In one picture the network may be sure of a hook's top and in the next of its end. What is followed is kept through
that, and stays where it was first found; how likely both have been over the last hour tells that it may be wrong. So
does what surrounds the end (:mod:`.apex_error`), where leaves may hide another one that is likely nowhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np

from flora_common.arrays import FloatArray
from flora_common.vision.path import apex_error
from flora_common.vision.path.along_way import goes_aside, is_passed
from flora_common.vision.path.guide import ELSEWHERE_CM, Way

LATELY_S: Final = 3600.0
"""Time constant of the means. Whole pictures are looked at once in it at least."""
SHARE: Final = 0.55
"""Another apex that has been likelier than this share of the stem's end may as well be it."""
AT_FIRST: Final = 1.4
"""In a first picture others count as much more, which nothing else speaks against: of 900 plants that the network had
not learnt from its likeliest apex was wrong by more than 5 mm in 16 of a hundred where the next one had less than 0.4
of its likelihood, and in 51 of a hundred else."""

OFF_LIMIT, OFF_CHANCE = 1, 0.25
"""Which of the limits an end must not be beyond, and the chance that it is from which on it is not believed."""


class Rivals(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How likely apices have been lately, 0..1.

    Attributes:
        time_s: of the last picture that was looked at whole.
        here: likelihood of the apex where the stem ends, mean over :data:`LATELY_S`.
        elsewhere: the same of the likeliest one that is not there.
        away_cm: how far from the stem's end that was, mean by likelihood.
        off: the chances that the stem ends farther off than each of
            :data:`flora_common.vision.path.apex_error.LIMITS_CM`, means over :data:`LATELY_S`, of the first pictures
            alike.
        looks: how many whole pictures there have been.
    """

    time_s: float
    here: float
    elsewhere: float
    away_cm: float
    off: tuple[float, ...] = (0.0,) * len(apex_error.LIMITS_CM)
    looks: int = 1

    @property
    def are_strong(self) -> bool:
        """Whether what is elsewhere may as well be the stem's end."""
        return self.elsewhere > SHARE * self.here

    @property
    def are_hidden(self) -> bool:
        """Whether it looks as if leaves hid where the stem ends."""
        return self.off[OFF_LIMIT] > OFF_CHANCE

    @property
    def tip_error_cm(self) -> float:
        """Standard deviation of a tip that is either here or there, as likely as both have been, and that may be hidden
        by leaves besides."""
        hidden = apex_error.error_cm(np.array(self.off))
        if not self.are_strong:
            return hidden
        apart = self.away_cm * math.sqrt(self.here * self.elsewhere) / (self.here + self.elsewhere)
        return max(apart, hidden)


def after(before: Rivals | None, ways: Sequence[Way], tip_px: FloatArray, time_s: float, px_per_cm: float) -> Rivals:
    """What is known after a picture that was looked at whole.

    Args:
        before: what was known before it; None at first.
        ways: that the network tells of it.
        tip_px: where the stem ends in it, (x, y) px of the full picture.
        time_s: when it was taken.
        px_per_cm: scale.
    """
    off_cm = [math.dist(way.tip_px, tip_px) / px_per_cm for way in ways]
    ends = [way for way, off in zip(ways, off_cm, strict=True) if off <= ELSEWHERE_CM]
    told = [way.off for way in ends if way.off is not None][:1]
    # neither another plant beside the anchor nor the top of a hook round which the stem plainly goes is a rival of its
    # end, the latter where this picture is not all there is
    others = [
        (way.sure, off)
        for way, off in zip(ways, off_cm, strict=True)
        if off > ELSEWHERE_CM
        and not goes_aside(way, px_per_cm)
        and (before is None or not is_passed(way.tip_px, ends, px_per_cm))
    ]
    here = max((way.sure for way in ends), default=0.0)
    elsewhere, away_cm = max(others, default=(0.0, 0.0))
    if before is None:
        first = Rivals(time_s, here, AT_FIRST * elsewhere, away_cm)
        return msgspec.structs.replace(first, off=tuple(told[0].tolist())) if told else first
    new = 1.0 - math.exp(-max(0.0, time_s - before.time_s) / LATELY_S)
    mean = before.elsewhere + new * (elsewhere - before.elsewhere)
    away = before.elsewhere * before.away_cm
    away += new * (elsewhere * away_cm - away)
    share = max(new, 1.0 / (before.looks + 1))
    off = before.off if not told else tuple((np.array(before.off) * (1.0 - share) + share * told[0]).tolist())
    return Rivals(
        time_s,
        before.here + new * (here - before.here),
        mean,
        away / mean if mean > 0.0 else 0.0,
        off,
        before.looks + 1,
    )
