"""A stem that sags under its own weight, or is pushed aside: bent elastically, where it is soft, and within minutes.

The load acts on each cm of it alike, downwards or to a side. What it bends is not at rest at once: fibres slide, as in
any fresh stem that is loaded (Kelvin-Voigt: an elastic bend that is come to with a time constant). A stem that bends
leans farther, and then bends more; where that comes to nearly as much as it began with, coming to rest takes many times
the constant, and the tip swings over late and far.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.simulator.fast_functions import fast_exp, inlined
from flora_lab.simulator.fast_scratch import scratch
from flora_lab.simulator.rod import CAPACITY, along, directions, split, whole_registers

SOFTNESS_CM: Final = 5.0
"""E-fold of elastic softness with distance from the tip; of the modulus it is 5.0 cm (3.5-6.3), Ohad et al., 54 plants.
How far from the tip a stem still bends by growing is another matter, and fitted."""
SETTLING_H: Final = 0.05
"""Time constant with which a bend is come to."""
_PARTS: Final = 4
"""In so many parts of a step a stem bends again under its own bend."""
_MOST_SAG: Final = 0.5
"""The elastic bend of one joint, rad, beyond which no stem is taken to go."""
BENT: Final = (1 + CAPACITY // 2, 2)
"""What is remembered of bends. First how many segments, and the sum of whose angles, they are the bends of; then the
angle of each segment that is elastic, two in a row."""


@inlined
def elastic_bends(
    length: Array, angle: Array, n: int, weight: float, push: float, softness_cm: float, out: Array
) -> None:
    """The elastic bend of each joint under the load above it once it is at rest, rad; ``out`` is written."""
    compliance = scratch(np.float64, CAPACITY)
    _compliance(length, n, softness_cm, compliance)
    _bends(length, angle, n, weight, push, compliance, out)


@inlined
def _compliance(length: Array, n: int, softness_cm: float, out: Array) -> None:
    """How much each joint bends under a moment, in units of what the tip does per cm; ``out`` is written."""
    arc, reach = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    total = along(length, n, arc, reach)
    for j in range(whole_registers(n)):
        out[j] = reach[j] * fast_exp(-(total - arc[j]) / softness_cm)


@inlined
def _bends(length: Array, angle: Array, n: int, weight: float, push: float, compliance: Array, out: Array) -> None:
    """As :func:`elastic_bends`, of joints that are so compliant."""
    sin, cos = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    x, y = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    directions(length, angle, n, sin, cos, x, y)
    above = lean = rise = 0.0
    for i in range(n):
        j = n - 1 - i
        start_x, start_y = x[j] - sin[j] * length[j], y[j] - cos[j] * length[j]
        above += length[j]
        lean += length[j] * (x[j] - 0.5 * sin[j] * length[j])
        rise += length[j] * (y[j] - 0.5 * cos[j] * length[j])
        bend = compliance[j] * (weight * (lean - above * start_x) + push * (rise - above * start_y))
        out[j] = min(max(bend, -_MOST_SAG), _MOST_SAG)


@inlined
def recall(
    length: Array, angle: Array, n: int, weight: float, push: float, softness_cm: float, bent: Array, out: Array
) -> None:
    """The angle of each segment that is elastic, rad, by what is remembered; ``out`` is written.

    A stem that is not the one that was bent is taken to be at rest.

    Args:
        length, angle, n: the stem.
        weight, push, softness_cm: ``SAG``, ``WIND`` and ``SOFTNESS_CM`` of :mod:`flora_lab.simulator.terms`.
        bent: what is remembered, shape :data:`BENT`.
    """
    if bent[0, 0] == n and bent[0, 1] == angle[:n].sum():
        for j in range(n):
            out[j] = bent[1 + j // 2, j % 2]
    else:
        elastic_bends(length, angle, n, weight, push, softness_cm, out)
        for j in range(1, n):
            out[j] += out[j - 1]


@inlined
def settle(
    length: Array,
    angle: Array,
    n: int,
    weight: float,
    push: float,
    softness_cm: float,
    settling_h: float,
    dt_h: float,
    elastic: Array,
) -> None:
    """Bend a stem that has grown towards where its elastic bends are those of its shape, in place.

    Args:
        length, angle, n: the stem.
        weight, push, softness_cm: see :func:`recall`.
        settling_h: ``SETTLING_H`` of the same.
        dt_h: for so long.
        elastic: the angle of each segment that is elastic, rad, shape (CAPACITY,); what it is then is written.
    """
    compliance, now = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    _compliance(length, n, softness_cm, compliance)
    share = 1.0 - fast_exp(-dt_h / (_PARTS * settling_h))
    for _ in range(_PARTS):
        _bends(length, angle, n, weight, push, compliance, now)
        turn = 0.0
        for j in range(n):
            turn += now[j]
            more = share * (turn - elastic[j])
            elastic[j] += more
            angle[j] += more


@inlined
def split_and_remember(length: Array, angle: Array, n: int, elastic: Array, bent: Array) -> int:
    """As :func:`flora_lab.simulator.rod.split`; what is elastic is remembered of the stem that is left."""
    whole = scratch(np.float64, CAPACITY)
    for j in range(n):
        whole[j] = length[j]
    split(whole, elastic, n)
    segments = int(split(length, angle, n))
    bent[0, 0], bent[0, 1] = segments, angle[:segments].sum()
    for j in range(segments):
        bent[1 + j // 2, j % 2] = elastic[j]
    return segments
