"""The cheapest ways from a pixel to others (Dijkstra 1959)."""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from flora_common.arrays import FloatArray

IndexArray = npt.NDArray[np.intp]
DEAREST: Final = 900.0
"""Cost of a way of 30 cm with a gap of 2.4 cm; what is not reached for that is no apex of this plant."""


def cheapest_ways(cost: FloatArray, start: tuple[int, int], ends: Sequence[tuple[int, int]]) -> list[IndexArray | None]:
    """The cheapest ways from pixel to neighbouring pixel to some ends, each of shape (n, 2), rows and columns; None to
    those that are too dear."""
    stride = cost.shape[1] + 2
    padded = np.pad(cost, 1, constant_values=math.inf).ravel().tolist()
    first, *last = ((row + 1) * stride + column + 1 for row, column in (start, *ends))
    least, before = {first: 0.0}, {first: first}
    waiting, done, sought = [(0.0, first)], set[int](), set(last)
    neighbours = [(down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right]
    steps = [(down * stride + right, 0.5 * math.hypot(down, right)) for down, right in neighbours]
    while waiting and sought:
        so_far, here = heapq.heappop(waiting)
        if so_far > DEAREST:
            break
        if here in done:
            continue
        done.add(here)
        sought.discard(here)
        for step, half in steps:
            there = here + step
            further = so_far + half * (padded[here] + padded[there])
            if further < least.get(there, math.inf):
                least[there], before[there] = further, here
                heapq.heappush(waiting, (further, there))
    found: list[IndexArray | None] = []
    for end in last:
        if end in sought:
            found.append(None)
            continue
        way = [end]
        while way[-1] != first:
            way.append(before[way[-1]])
        found.append(np.column_stack(np.divmod(np.array(way[::-1], dtype=np.intp), stride)) - 1)
    return found
