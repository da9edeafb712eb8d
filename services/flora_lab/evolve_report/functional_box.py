"""The functional box plot: what a box plot is to numbers, for whole curves.

Curves are ordered by their modified band depth: the share of all pairs of curves between which a curve lies, averaged
over its length. statsmodels' ``banddepth`` ranks curves that are equal at a place in an arbitrary order, and best
fitness is equal in many runs at many generations; here a curve also lies between two curves where it equals one of
them. Without ties both give the same numbers.

Source: Sun and Genton 2011, "Functional Boxplots", Journal of Computational and Graphical Statistics 20.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import FloatArray

FENCE: Final = 1.5
"""The central region, widened to either side by this many times its own width, holds all curves but outliers."""


@dataclass(frozen=True, slots=True)
class FunctionalBox:
    """The parts of a functional box plot of curves of shape (curves, places).

    Attributes:
        depth: of each curve, shape (curves,); more is more central.
        median: place of the deepest curve, the first of equals.
        region: least and greatest of the deeper half of the curves, shape (2, places).
        envelope: least and greatest of all curves but outliers, shape (2, places).
        outliers: places of the curves that are not within the fence everywhere.
    """

    depth: FloatArray
    median: int
    region: FloatArray
    envelope: FloatArray
    outliers: tuple[int, ...]


def functional_box(curves: FloatArray, *, least: float = 0.0) -> FunctionalBox:
    """A functional box plot's parts.

    Args:
        curves: shape (curves, places), two curves or more, finite.
        least: how far outside the fence a curve is to be for an outlier: where half of the curves are equal, the fence
            has no width, and any other curve would be one.

    Raises:
        ValueError: fewer than two curves.
    """
    if len(curves) < 2:
        raise ValueError(f"{len(curves)} curves; a functional box plot needs two")
    depth = band_depth(curves)
    order = np.argsort(-depth, kind="stable")
    central = curves[order[: -(-len(curves) // 2)]]
    low, high = central.min(axis=0), central.max(axis=0)
    fence = FENCE * (high - low) + least
    is_outlier = ((curves < low - fence) | (curves > high + fence)).any(axis=1)
    rest = curves[~is_outlier]
    return FunctionalBox(
        depth,
        int(order[0]),
        np.stack([low, high]),
        np.stack([rest.min(axis=0), rest.max(axis=0)]),
        tuple(np.flatnonzero(is_outlier).tolist()),
    )


def band_depth(curves: FloatArray) -> FloatArray:
    """The modified band depth of each curve, shape (curves,), from curves of shape (curves, places)."""
    count = len(curves)
    ordered = np.sort(curves, axis=0)
    below, above = np.empty(curves.shape), np.empty(curves.shape)
    for place, (values, column) in enumerate(zip(curves.T, ordered.T, strict=True)):
        below[:, place] = np.searchsorted(column, values, side="left")
        above[:, place] = count - np.searchsorted(column, values, side="right")
    pairs = count * (count - 1) / 2.0
    outside = below * (below - 1.0) / 2.0 + above * (above - 1.0) / 2.0
    return np.asarray(1.0 - outside.mean(axis=1) / pairs)
