"""The kinematics of a growing stem in the picture plane: a chain of straight segments, compiled, one plant per lane.

Segments elongate in a zone below the tip. The bend of a joint turns everything above it. Segments that have grown long
are split in two. What makes a stem bend and grow is the business of a law: :mod:`flora_lab.simulator.tropism` (the
mechanistic model) or :mod:`flora_lab.simulator.neural_law` (the learned one).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

CAPACITY: Final = 96
"""Segments that a lane has room for; when they are used up, segments grow longer instead of being split."""
LONG_SEGMENT_CM: Final = 0.7
ZONE_EDGE_CM: Final = 0.5
LONGEST_STEP_H: Final = 300.0 / 3600.0
"""Longer steps are taken in parts."""

EARLY_CM: Final = 6.5
LATE_CM: Final = 22.0
"""Stem lengths at which a plant's early and late rates of growth hold. Wahby et al. 2018: first and last heights of a
run."""

jit = numba.njit(cache=True, error_model="numpy", nogil=True)

WORTH_THREADS: Final = 2000
"""Steps of plants below which starting threads takes longer than the work."""


def in_lanes(lanes: Callable[..., None]) -> Callable[..., None]:
    """Compile a loop over plants (``numba.prange``).

    Returns:
        The compiled loop, with one argument before its own: how many steps of plants it will do. What it does is the
        same with any number of threads.
    """
    compiled = numba.njit(cache=True, error_model="numpy", parallel=True)(lanes)

    def run(steps: int, *arguments: Any) -> None:
        threads = numba.get_num_threads()
        numba.set_num_threads(threads if steps >= WORTH_THREADS else 1)
        try:
            compiled(*arguments)
        finally:
            numba.set_num_threads(threads)

    return run


@jit
def length_of(length: Array, n: int) -> float:
    """Of the whole stem, cm."""
    total = 0.0
    for j in range(n):
        total += length[j]
    return total


@jit
def lateness(total_cm: float) -> float:
    """How far a stem of this length is from its early to its late rate of growth: 0 to 1, linear in between."""
    return float(min(max((total_cm - EARLY_CM) / (LATE_CM - EARLY_CM), 0.0), 1.0))


@jit
def elongate(length: Array, n: int, total_cm: float, zone_cm: float, grown_cm: float) -> None:
    """Let the stem grow by ``grown_cm``, all of it in the zone below the tip."""
    below_tip = total_cm
    whole = 0.0
    for j in range(n):
        middle = below_tip - 0.5 * length[j]
        whole += length[j] / (1.0 + np.exp(min((middle - zone_cm) / ZONE_EDGE_CM, 60.0)))
        below_tip -= length[j]
    below_tip = total_cm
    for j in range(n):
        old = length[j]
        share = old / (1.0 + np.exp(min((below_tip - 0.5 * old - zone_cm) / ZONE_EDGE_CM, 60.0)))
        length[j] = old + grown_cm * share / whole
        below_tip -= old


@jit
def split(length: Array, angle: Array, n: int) -> int:
    """Cut long segments in two of the same direction; returns the number of segments."""
    j = 0
    while j < n:
        if length[j] > LONG_SEGMENT_CM and n < length.shape[0]:
            for k in range(n, j, -1):
                length[k], angle[k] = length[k - 1], angle[k - 1]
            length[j] *= 0.5
            length[j + 1] = length[j]
            n += 1
            j += 1
        j += 1
    return n


@jit
def points_lane(length: Array, angle: Array, n: int, out: Array) -> None:
    """Ten points at even heights from anchor to tip; the convention of ``geometry.resample_by_height``."""
    xs, ys = np.zeros(n + 1), np.zeros(n + 1)
    for j in range(n):
        xs[j + 1] = xs[j] + np.sin(angle[j]) * length[j]
        ys[j + 1] = ys[j] + np.cos(angle[j]) * length[j]
    count = out.shape[0]
    out[0, 0] = out[0, 1] = 0.0
    out[count - 1, 0], out[count - 1, 1] = xs[n], ys[n]
    for i in range(1, count - 1):
        height = ys[n] * i / (count - 1)
        out[i, 1] = height
        nearest, gap = 0, np.inf
        found = False
        for k in range(n):
            low, high = ys[k] - height, ys[k + 1] - height
            if (low <= 0.0 < high) or (low >= 0.0 > high):
                out[i, 0] = xs[k] + low / (low - high) * (xs[k + 1] - xs[k])
                found = True
                break
            if abs(low) < gap:
                nearest, gap = k, abs(low)
        if not found:
            out[i, 0] = xs[nearest]
