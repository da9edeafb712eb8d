"""Target and obstacle: the task's shapes in the picture plane, in cm, origin at the anchor, x right, y up.

Plain Python, so that services which only pass them on need no numpy. :mod:`flora_common.geometry` computes with them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

STEM_POINTS: Final = 10
"""Points of a stem description: point 1 is the anchor, point 10 the growing tip."""

FARTHEST_CM: Final = 500.0
"""No point of a grow box is farther from the anchor along an axis; a coordinate beyond it is a wrong unit."""


@dataclass(frozen=True, slots=True)
class Target:
    """The place that the tip is to reach: a disc."""

    x_cm: float
    y_cm: float
    radius_cm: float = 2.0

    def distance_cm(self, x_cm: float, y_cm: float) -> float:
        """Distance from a point to the centre of the target."""
        return math.hypot(x_cm - self.x_cm, y_cm - self.y_cm)

    def contains(self, x_cm: float, y_cm: float) -> bool:
        """Whether a point lies on or inside the target's circle."""
        return self.distance_cm(x_cm, y_cm) <= self.radius_cm

    def fitness(self, tip_x_cm: float, tip_y_cm: float) -> float:
        """The paper's behavioural fitness F of a tip (equation for F in its section "Evolutionary approach").

        F = (x_r + y_r) / (|x*| + |y*|) with x_r = |x*| - |x* - x_tip| and y_r = |y*| - |y* - y_tip|.
        1.0 is a tip on the target's centre; a tip that moved away gives values below that of the anchor (0.0).

        Raises:
            ValueError: the target lies on the anchor, where F is not defined.
        """
        best = abs(self.x_cm) + abs(self.y_cm)
        if best == 0.0:
            raise ValueError("fitness is not defined for a target at the anchor (0, 0)")
        return (best - abs(self.x_cm - tip_x_cm) - abs(self.y_cm - tip_y_cm)) / best


@dataclass(frozen=True, slots=True)
class Obstacle:
    """The virtual obstacle: an upright rectangle given by its centre and extent."""

    x_cm: float
    y_cm: float
    width_cm: float = 7.0
    height_cm: float = 3.0

    @property
    def left_cm(self) -> float:
        return self.x_cm - self.width_cm / 2

    @property
    def right_cm(self) -> float:
        return self.x_cm + self.width_cm / 2

    @property
    def bottom_cm(self) -> float:
        return self.y_cm - self.height_cm / 2

    @property
    def top_cm(self) -> float:
        return self.y_cm + self.height_cm / 2
