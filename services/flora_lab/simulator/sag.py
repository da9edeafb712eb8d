"""A stem that sags under its own weight: bent elastically and at once, most where it is soft."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from flora_lab.simulator.fast_functions import fast_exp, inlined
from flora_lab.simulator.fast_scratch import scratch
from flora_lab.simulator.rod import CAPACITY, along, directions, whole_registers
from flora_lab.simulator.tropism import MATURE, MATURE_EDGE_CM, PROPRIO

Array = npt.NDArray[Any]

SOFTNESS_CM: Final = 5.0
"""E-fold of elastic softness with distance from the tip; of the modulus it is 5.0 cm (3.5-6.3), Ohad et al., 54 plants.
How far from the tip a stem still bends by growing is another matter, and fitted."""
_MOST_SAG: Final = 0.5
"""The elastic bend of one joint, rad, beyond which no stem is taken to go in one step."""


@inlined
def elastic_bends(length: Array, angle: Array, n: int, sag: float, deep: Array, soft: Array, out: Array) -> None:
    """The elastic bend of each joint under the weight above it, rad; ``out`` is written.

    Also written, of each joint: ``deep``, how far below the tip it is, cm, and ``soft``, how soft, 1 at the tip.
    """
    arc, reach = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    sin, cos = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    x, y = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    total = along(length, n, arc, reach)
    directions(length, angle, n, sin, cos, x, y)
    for j in range(whole_registers(n)):
        deep[j] = total - arc[j]
        soft[j] = fast_exp(-deep[j] / SOFTNESS_CM)
    weight = lean = 0.0
    for i in range(n):
        j = n - 1 - i
        start_x = x[j] - sin[j] * length[j]
        weight += length[j]
        lean += length[j] * (x[j] - 0.5 * sin[j] * length[j])
        bend = sag * reach[j] * soft[j] * (lean - weight * start_x)
        out[j] = min(max(bend, -_MOST_SAG), _MOST_SAG)


@inlined
def straightened(n: int, p: Array, elastic: Array, deep: Array, soft: Array, bend_h: float, out: Array) -> None:
    """What proprioception takes of an elastic bend in a step, as if growth had made it, rad; ``out`` is written.

    Tissue that grows straightens what growth has bent. Elastic bend it cannot grow away: there is always as much of it
    as there is weight, so that it has to be given back.
    """
    for j in range(whole_registers(n)):
        out[j] = soft[j] / (1.0 + fast_exp((deep[j] - p[MATURE]) / MATURE_EDGE_CM)) * bend_h * p[PROPRIO]
    for j in range(n):
        out[j] *= elastic[j]
