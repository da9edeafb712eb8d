"""Directions, lines and stems in three dimensions, cm: y is up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from guide.canvas import Floats

UP: Final = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, slots=True)
class Stem:
    """What leaves stand on.

    Attributes:
        axis, tangent: shape (n, 3), anchor first, and its direction.
        to_end_cm, radius_cm: shape (n,), along the axis.
    """

    axis: Floats
    tangent: Floats
    to_end_cm: Floats
    radius_cm: Floats

    def at(self, below_cm: float) -> int:
        """The point that is so far below its end."""
        return int(np.searchsorted(-self.to_end_cm, -below_cm).clip(1, len(self.axis) - 1))


def unit(vector: Floats) -> Floats:
    """Its direction."""
    return vector / (np.linalg.norm(vector) + 1e-9)


def across(vector: Floats, direction: Floats) -> Floats:
    """The part of a vector that is across a unit vector."""
    return vector - (vector @ direction) * direction


def perpendicular(direction: Floats, azimuth: float) -> Floats:
    """The unit vector across a direction at an angle about it."""
    aside = unit(np.cross(direction, [0.05, 0.1, 1.0]))
    return np.cos(azimuth) * aside + np.sin(azimuth) * np.cross(direction, aside)


def bent(base: Floats, heading: Floats, length: float, droop: float, wander: Floats) -> Floats:
    """A line from a place in a direction, that hangs by some rad per cm, shape (n, 3)."""
    count = max(7, int(length / 0.25))
    step, places = length / (count - 1), [base]
    for _ in range(count - 1):
        heading = unit(heading + step * (wander - droop * UP))
        places.append(places[-1] + step * heading)
    return np.array(places)
