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
_FARTHEST: Final = 9.0
"""How far two bends are followed to where all end, in units of the second."""
_TINY: Final = 1e-24


@inlined
def elastic_bends(length: Array, angle: Array, n: int, sag: float, out: Array) -> None:
    """The elastic bend of each joint under the weight above it, rad; ``out`` is written."""
    compliance = scratch(np.float64, CAPACITY)
    _compliance(length, n, sag, compliance)
    _bends(length, angle, n, compliance, out)


@inlined
def _compliance(length: Array, n: int, sag: float, out: Array) -> None:
    """How much each joint bends under a moment, rad/cm^2; ``out`` is written."""
    arc, reach = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    total = along(length, n, arc, reach)
    for j in range(whole_registers(n)):
        out[j] = sag * reach[j] * fast_exp(-(total - arc[j]) / SOFTNESS_CM)


@inlined
def _bends(length: Array, angle: Array, n: int, compliance: Array, out: Array) -> None:
    """As :func:`elastic_bends`, of joints that are so compliant."""
    sin, cos = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    x, y = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    directions(length, angle, n, sin, cos, x, y)
    weight = lean = 0.0
    for i in range(n):
        j = n - 1 - i
        start_x = x[j] - sin[j] * length[j]
        weight += length[j]
        lean += length[j] * (x[j] - 0.5 * sin[j] * length[j])
        bend = compliance[j] * (lean - weight * start_x)
        out[j] = min(max(bend, -_MOST_SAG), _MOST_SAG)


@inlined
def settle(length: Array, angle: Array, n: int, sag: float, before: Array) -> None:
    """Bend a stem that has grown until its elastic bends are those of the shape that it then has, in place.

    A stem that bends leans farther, and then bends more. What it would bend more by is not there to be added in a later
    step, which begins from the shape as it is: left out, half of a soft stem's sag would be lost. Each bend brings it
    nearer by much the same share, so that two of them tell where all would end (Anderson 1965, of depth one).

    Args:
        length, angle, n: the stem, before it bends.
        sag: see :func:`elastic_bends`.
        before: bends that are in its angles already, rad, shape (CAPACITY,).
    """
    grown, now = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    bent, moved = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    compliance = scratch(np.float64, CAPACITY)
    _compliance(length, n, sag, compliance)
    for j in range(n):
        grown[j] = bent[j] = angle[j]
        moved[j] = 0.0
    for _ in range(_MOST_TIMES):
        _bends(length, angle, n, compliance, now)
        turn = farthest = along_change = of_change = 0.0
        for j in range(n):
            turn += now[j] - before[j]
            now[j] = grown[j] + turn
            move = now[j] - angle[j]
            farthest = max(farthest, abs(move))
            change = move - moved[j]
            moved[j] = move
            along_change += change * move
            of_change += change * change
        # Only forwards: where bends grow, what two of them point to is where a stem stands that the least push fells.
        share = min(max(along_change / of_change, -_FARTHEST), 0.0) if of_change > _TINY else 0.0
        is_still = farthest < _STILL
        for j in range(n):
            angle[j] = now[j] if is_still else now[j] - share * (now[j] - bent[j])
            bent[j] = now[j]
        if is_still:
            break
