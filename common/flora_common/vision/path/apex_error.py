"""How far off the end of a way may be: what surrounds it tells more than how likely it is an apex.

Leaves that stand round an apex may hide it, and then the network (:mod:`.guide`) is often sure of a place where there
is none: the top of a hook, or a leaf that goes on as the stem does. A small perceptron has seen many ends that were
right or wrong, each from the end itself, looking along the stem, and tells the chances that it is off by more than a
few limits. Its numbers are multiples of powers of two, so that sums are exact in any order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Final

import cv2
import numpy as np

from flora_common.arrays import Float32Array, FloatArray
from flora_common.geometry import arc_length, unit
from flora_common.vision.path.sampler import places_along

WEIGHTS: Final = "apex_error.npz"
LIMITS_CM: Final = (0.4, 0.7, 1.1, 1.6)
"""The chances are told that an end is farther off than these."""
BETWEEN_CM: Final = (0.55, 0.9, 1.35, 2.5)
"""How far off it is where it is beyond a limit and within the next."""
RINGS_CM: Final = (0.25, 0.5, 0.8, 1.2, 1.7, 2.3, 3.0)
ANGLES: Final = 12
"""Directions on each ring, the first ahead."""
HEADING_CM, TURNS_CM = 0.7, (1.0, 2.0, 4.0)
"""Ahead is where the last piece of so much of the line leads; how much it turns is told over the others."""
BELOW_CM, BELOW_STEP_CM, ASIDE_CM = (0.0, 0.25, 0.5, 1.0, 2.0, 3.0), 0.3, (-0.3, 0.0, 0.3)
"""Places on the line so far from its end, and beside it; it leads where it does over the second."""
LEAST: Final = 1e-4
"""Likelihoods are told by their logarithm, and none is less."""
MOST_SPREADS, STEPS = 4.0, 64.0
"""What is seen counts as no farther from what is usual, in so many steps of a unit."""


@dataclass(frozen=True, slots=True, eq=False)
class Perceptron:
    """Two layers.

    Attributes:
        middle, spread: shape (n,), of what is seen where it was learnt.
        inner: shape (n + 1, hidden), the last row added to all.
        outer: shape (hidden + 1, limits), likewise.
    """

    middle: FloatArray
    spread: FloatArray
    inner: FloatArray
    outer: FloatArray

    def __post_init__(self) -> None:
        """Check what a file may have wrong.

        Raises:
            ValueError: shapes that do not fit, or numbers that are none.
        """
        count, hidden = len(self.middle), self.inner.shape[-1]
        shapes = self.spread.shape, self.inner.shape, self.outer.shape
        if shapes != ((count,), (count + 1, hidden), (hidden + 1, len(LIMITS_CM))):
            raise ValueError("a perceptron's arrays do not fit together")
        if not all(np.isfinite(v).all() for v in (self.middle, self.spread, self.inner, self.outer)):
            raise ValueError("a perceptron has numbers that are none")

    def chances(self, views: FloatArray) -> FloatArray:
        """The chances that an end is off by more than each of :data:`LIMITS_CM`, shape (limits,), falling.

        Args:
            views: shape (2, n), what is seen from it, see :func:`views_of`.
        """
        x = in_spreads(views, self.middle, self.spread)
        x = np.maximum(0.0, x @ self.inner[:-1] + self.inner[-1])
        logits = (x @ self.outer[:-1] + self.outer[-1]).mean(axis=0)
        return np.asarray(np.minimum.accumulate(1.0 / (1.0 + np.exp(-logits))), dtype=np.float64)


def in_spreads(seen: FloatArray, middle: FloatArray, spread: FloatArray) -> FloatArray:
    """What is seen, against what is usual, in whole steps."""
    return np.asarray(np.rint(STEPS * np.clip((seen - middle) / spread, -MOST_SPREADS, MOST_SPREADS)) / STEPS)


@cache
def perceptron() -> Perceptron:
    """The one that comes with this package."""
    with resources.files(__package__).joinpath(WEIGHTS).open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        return Perceptron(*(arrays[name].astype(np.float64) for name in ("middle", "spread", "inner", "outer")))


def error_cm(chances: FloatArray) -> float:
    """Root of the mean square of how far off an end with these chances is, of what is beyond the first limit."""
    between = chances - np.append(chances[1:], 0.0)
    return math.sqrt(float(between @ np.square(BETWEEN_CM)))


def views_of(
    planes: Float32Array, line: FloatArray, along: FloatArray, sure: float, elsewhere: float, px_per_cm: float
) -> FloatArray:
    """What is seen from the end of a line, shape (2, n): as it is, and in a mirror, which must not matter.

    Args:
        planes: shape (height, width, planes): what the network was shown, and its two maps, the second as logarithm.
        line: shape (m, 2), from the anchor to that end, (x, y) px of the planes.
        along: how likely its steps are the stem's middle.
        sure, elsewhere: how likely an apex is at its end, and anywhere else at most.
        px_per_cm: scale of the planes.
    """
    s = arc_length(line)
    back = places_along(line, s, s[-1] - px_per_cm * np.array([0.0, HEADING_CM, *TURNS_CM]))
    ahead = unit(line[-1] - back[1])
    turned = [
        float(ahead @ unit(far - farther))
        for far, farther in zip(back[2:], np.vstack([back[3:], line[:1]]), strict=True)
    ]
    told = [
        math.log(max(LEAST, sure)),
        math.log(max(LEAST, elsewhere)),
        math.log(max(LEAST, elsewhere) / max(LEAST, sure)),
        math.log(1.0 + float(s[-1]) / px_per_cm),
        float(np.median(along)),
        float(np.min(along)),
        abs(float(ahead[0])),
        float(ahead[1]),
        *turned,
    ]
    angles = np.arange(ANGLES) * (2.0 * np.pi / ANGLES)
    cos, sin = np.cos(angles), np.sin(angles)
    around = np.stack([ahead[0] * cos - ahead[1] * sin, ahead[1] * cos + ahead[0] * sin], axis=-1)
    ring = _at(planes, line[-1] + px_per_cm * np.array(RINGS_CM)[:, None, None] * around)
    mirrored = ring[:, -np.arange(ANGLES) % ANGLES]
    below = places_along(line, s, s[-1] - px_per_cm * np.array(BELOW_CM))
    before = places_along(line, s, s[-1] - px_per_cm * (np.array(BELOW_CM) + BELOW_STEP_CM))
    along_it = below - before
    along_it /= np.maximum(1e-9, np.hypot(*along_it.T))[:, None]
    across = np.stack([-along_it[:, 1], along_it[:, 0]], axis=-1)
    strip = _at(planes, below[:, None] + px_per_cm * np.array(ASIDE_CM)[None, :, None] * across[:, None])
    return np.stack(
        [
            np.concatenate([told, ring.ravel(), strip.ravel()]),
            np.concatenate([told, mirrored.ravel(), strip[:, ::-1].ravel()]),
        ]
    )


def _at(planes: Float32Array, places: FloatArray) -> FloatArray:
    """Planes at places (..., 2), linear between pixels, beyond the margin as on it; shape (..., planes)."""
    x, y = (np.ascontiguousarray(places[..., k], dtype=np.float32) for k in range(2))
    found = cv2.remap(planes, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, dtype=np.float64)
