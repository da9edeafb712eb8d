"""How far stems reached in all directions, and by how much another one goes beyond that.

A controller file says it of the simulated plants that its network was evolved with: outside of it nobody has tried the
network.
"""

from __future__ import annotations

import math
from typing import Annotated, Final

import msgspec

from flora_common.arrays import FloatArray
from flora_common.geometry import polyline_length
from flora_common.network_export import Strict
from flora_common.runs import Cm

Length = Annotated[float, msgspec.Meta(ge=0.0, le=20_000.0)]
"""Of ten points that are all where they may be, however they lie."""

_STEPS_PER_CM: Final = 100.0
"""Ranges are told in tenths of a millimetre, rounded outwards."""


class StemRange(Strict, frozen=True):
    """``stem_range`` of a controller file: the stems that were met, cm in the frame of :mod:`flora_common.geometry`.

    Attributes:
        left_cm, right_cm: x of the points that were farthest to either side.
        lowest_tip_cm, highest_tip_cm: y of tips.
        shortest_cm, longest_cm: length of a stem, along its ten points.
    """

    left_cm: Cm
    right_cm: Cm
    lowest_tip_cm: Cm
    highest_tip_cm: Cm
    shortest_cm: Length
    longest_cm: Length

    @property
    def is_ordered(self) -> bool:
        """Whether no least value is above its greatest."""
        return (
            self.left_cm <= self.right_cm
            and self.lowest_tip_cm <= self.highest_tip_cm
            and self.shortest_cm <= self.longest_cm
        )

    def beyond(self, points_cm: FloatArray) -> tuple[float, str]:
        """By how much a stem goes beyond what was met, in cm, and which way; 0 where it does not.

        Growing is no leaving: a stem that is shorter than all that were met grows into the range, and of one whose tip
        is higher than any it is told how much higher, not how much longer. A stem that is long enough, and whose tip is
        lower than any, has sunk.

        Args:
            points_cm: shape (10, 2), finite.
        """
        x, tip_y = points_cm[:, 0], float(points_cm[-1, 1])
        length = float(polyline_length(points_cm))
        far_cm, way = max(
            (self.left_cm - float(x.min()), "farther left"),
            (float(x.max()) - self.right_cm, "farther right"),
            (tip_y - self.highest_tip_cm, "higher"),
            (length - self.longest_cm if tip_y <= self.highest_tip_cm else 0.0, "longer"),
            (self.lowest_tip_cm - tip_y if length >= self.shortest_cm else 0.0, "lower"),
        )
        return (far_cm, way) if far_cm > 0.0 else (0.0, "")


def range_of(stems_cm: FloatArray) -> StemRange:
    """The range of these stems.

    Args:
        stems_cm: shape (n, 10, 2), n >= 1, finite, within 500 cm.
    """
    x, tips, lengths = stems_cm[..., 0], stems_cm[:, -1, 1], polyline_length(stems_cm)
    return StemRange(
        left_cm=_down(x.min()),
        right_cm=_up(x.max()),
        lowest_tip_cm=_down(tips.min()),
        highest_tip_cm=_up(tips.max()),
        shortest_cm=_down(lengths.min()),
        longest_cm=_up(lengths.max()),
    )


def _down(value: float) -> float:
    return math.floor(float(value) * _STEPS_PER_CM) / _STEPS_PER_CM


def _up(value: float) -> float:
    return math.ceil(float(value) * _STEPS_PER_CM) / _STEPS_PER_CM
