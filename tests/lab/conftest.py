"""neat-python's networks as a reference: their sums in order, as its authors had them.

From Python 3.12 on ``sum`` makes up for rounding (gh-100425), and neat-python's networks, which use it, answer with
other last digits than under 3.11. Ours add up in order under every Python, in compiled code and on the rig.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import neat.aggregations


def in_order(values: Iterable[float]) -> float:
    total: Any = 0
    for value in values:
        total = total + value
    return total


def mean_in_order(values: Iterable[float]) -> float:
    told = [float(value) for value in values]
    return in_order(told) / len(told)


neat.aggregations.sum = in_order
neat.aggregations.mean = mean_in_order
