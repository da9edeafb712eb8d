"""A stem that sags under its own weight: bent elastically and at once, most where it is soft."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from flora_lab.simulator.fast_functions import fast_exp, inlined
from flora_lab.simulator.fast_scratch import scratch
from flora_lab.simulator.rod import CAPACITY, along, directions, whole_registers

Array = npt.NDArray[Any]

SOFTNESS_CM: Final = 5.0
"""E-fold of elastic softness with distance from the tip; of the modulus it is 5.0 cm (3.5-6.3), Ohad et al., 54 plants.
How far from the tip a stem still bends by growing is another matter, and fitted."""
_MOST_SAG: Final = 0.5
"""The elastic bend of one joint, rad, beyond which no stem is taken to go in one step."""
_MOST_TIMES: Final = 24
_STILL: Final = 1e-6
"""How often a stem bends again under its own bend, at most, and the angle, rad, below which it is at rest."""


@inlined
def elastic_bends(length: Array, angle: Array, n: int, sag: float, out: Array) -> None:
    """The elastic bend of each joint under the weight above it, rad; ``out`` is written."""
    arc, reach = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    sin, cos = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    x, y = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    total = along(length, n, arc, reach)
    directions(length, angle, n, sin, cos, x, y)
    soft = scratch(np.float64, CAPACITY)
    for j in range(whole_registers(n)):
        soft[j] = fast_exp(-(total - arc[j]) / SOFTNESS_CM)
    weight = lean = 0.0
    for i in range(n):
        j = n - 1 - i
        start_x = x[j] - sin[j] * length[j]
        weight += length[j]
        lean += length[j] * (x[j] - 0.5 * sin[j] * length[j])
        bend = sag * reach[j] * soft[j] * (lean - weight * start_x)
        out[j] = min(max(bend, -_MOST_SAG), _MOST_SAG)


@inlined
def settle(length: Array, angle: Array, n: int, sag: float, before: Array) -> None:
    """Bend a stem that has grown until its elastic bends are those of the shape that it then has, in place.

    A stem that bends leans farther, and then bends more. What it would bend more by is not there to be added in a later
    step, which begins from the shape as it is: left out, half of a soft stem's sag would be lost.

    Args:
        length, angle, n: the stem, before it bends.
        sag: see :func:`elastic_bends`.
        before: bends that are in its angles already, rad, shape (CAPACITY,).
    """
    grown, now = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    for j in range(n):
        grown[j] = angle[j]
    for _ in range(_MOST_TIMES):
        elastic_bends(length, angle, n, sag, now)
        turn = moved = 0.0
        for j in range(n):
            turn += now[j] - before[j]
            moved = max(moved, abs(grown[j] + turn - angle[j]))
            angle[j] = grown[j] + turn
        if moved < _STILL:
            break
