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

from flora_common.arrays import Array
from flora_lab.simulator.fast_functions import fast_exp, fast_sincos, inlined
from flora_lab.simulator.fast_scratch import scratch

CAPACITY: Final = 96
"""Segments that a lane has room for; when they are used up, segments grow longer instead of being split."""
REGISTER: Final = 8
"""Numbers in the widest SIMD register. Lanes have room for whole ones, so that no loop has to end within one."""
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


@inlined
def whole_registers(n: int) -> int:
    """Segments of the registers that hold ``n``; what is computed of those beyond is not used."""
    return (n + REGISTER - 1) & -REGISTER


@inlined
def along(length: Array, n: int, arc: Array, reach: Array) -> float:
    """Length of the whole stem, cm, as :func:`length_of`.

    Also written, for each segment: ``arc``, the length of the stem below it, and ``reach``, how much stem its lower
    joint stands for, cm: half of the two segments that meet there; at the anchor, the first segment.
    """
    total, below_cm = 0.0, length[0]
    for j in range(n):
        arc[j] = total
        reach[j] = 0.5 * (length[j] + below_cm)
        total += length[j]
        below_cm = length[j]
    for j in range(n, whole_registers(n)):
        arc[j] = reach[j] = 0.0
    return float(total)


@inlined
def directions(length: Array, angle: Array, n: int, sin: Array, cos: Array, x: Array, y: Array) -> None:
    """Write the sine and cosine of each segment's angle, and where its upper end is, cm."""
    for j in range(whole_registers(n)):
        sin[j], cos[j] = fast_sincos(angle[j])
        x[j], y[j] = sin[j] * length[j], cos[j] * length[j]
    end_x = end_y = 0.0
    for j in range(n):
        end_x += x[j]
        end_y += y[j]
        x[j], y[j] = end_x, end_y


@inlined
def elongate(length: Array, n: int, arc: Array, total_cm: float, zone_cm: float, grown_cm: float) -> None:
    """Let the stem grow by ``grown_cm``, all of it in the zone below the tip; ``arc`` as :func:`along` wrote it."""
    share = scratch(np.float64, CAPACITY)
    zone_at_cm = total_cm - zone_cm
    for j in range(whole_registers(n)):
        middle_cm = arc[j] + 0.5 * length[j]
        share[j] = length[j] / (1.0 + fast_exp((zone_at_cm - middle_cm) / ZONE_EDGE_CM))
    whole = 0.0
    for j in range(n):
        whole += share[j]
    rate = grown_cm / whole
    for j in range(n):
        length[j] += rate * share[j]


@jit
def split(length: Array, angle: Array, n: int) -> int:
    """Cut long segments in two of the same direction; returns the number of segments."""
    long = 0
    for j in range(n):
        long += length[j] > LONG_SEGMENT_CM
    if long == 0:
        return n
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
    sin, cos = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    x, y = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    directions(length, angle, n, sin, cos, x, y)
    last = out.shape[0] - 1
    out[0, 0] = out[0, 1] = 0.0
    out[last, 0], out[last, 1] = x[n - 1], y[n - 1]
    # A stem comes to no height before those between it and the anchor: the search goes on where it stopped.
    k, low_x, low_y = 0, 0.0, 0.0
    for i in range(1, last):
        height = y[n - 1] * i / last
        while k < n and not (low_y <= height < y[k] or low_y >= height > y[k]):
            low_x, low_y = x[k], y[k]
            k += 1
        out[i, 1] = height
        # Only a stem of no height, or one that is not finite, never comes to it.
        out[i, 0] = low_x + (low_y - height) / (low_y - y[k]) * (x[k] - low_x) if k < n else 0.0
