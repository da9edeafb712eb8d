"""Networks as compiled code takes them, and the functions of their nodes, which all kernels share.

Source of the functions: neat-python 2.0.0, ``neat/activations.py`` and ``neat/aggregations.py``.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from flora_common.arrays import Array
from flora_lab.evolve.genome_arrays import GenomeArrays
from flora_lab.evolve.neat_genes import ACTIVATION_NUMBERS, AGGREGATION_NUMBERS
from flora_lab.simulator.rod import jit

_A: Final = ACTIVATION_NUMBERS
_SIGMOID, _TANH, _SIN, _GAUSS, _RELU = _A["sigmoid"], _A["tanh"], _A["sin"], _A["gauss"], _A["relu"]
_ELU, _LELU, _SELU, _SOFTPLUS, _IDENTITY = _A["elu"], _A["lelu"], _A["selu"], _A["softplus"], _A["identity"]
_CLAMPED, _INV, _LOG, _EXP, _ABS = _A["clamped"], _A["inv"], _A["log"], _A["exp"], _A["abs"]
_HAT, _SQUARE, _CUBE = _A["hat"], _A["square"], _A["cube"]
_G: Final = AGGREGATION_NUMBERS
_SUM, _PRODUCT, _MAX, _MIN = _G["sum"], _G["product"], _G["max"], _G["min"]
_MAXABS, _MEDIAN, _MEAN = _G["maxabs"], _G["median"], _G["mean"]
_SELU_LAMBDA: Final = 1.0507009873554804934193349852946
_SELU_ALPHA: Final = 1.6732632423543772848170429916717


class Networks(NamedTuple):
    """Some networks of a :class:`flora_lab.evolve.genome_arrays.GenomeArrays`, as compiled code takes them.

    Attributes:
        node_start: of these networks and the end of the last one, shape (G + 1,).
        output: of these networks, shape (G, number of outputs).
        bias, response, activation, aggregation, edge_start, source, weight: of all networks.
    """

    node_start: Array
    output: Array
    bias: Array
    response: Array
    activation: Array
    aggregation: Array
    edge_start: Array
    source: Array
    weight: Array


def networks_of(arrays: GenomeArrays, first: int = 0, end: int | None = None) -> Networks:
    """The networks from ``first`` to ``end``; all where nothing is said."""
    last = len(arrays) if end is None else end
    return Networks(
        arrays.node_start[first : last + 1],
        arrays.output[first:last],
        arrays.bias,
        arrays.response,
        arrays.activation,
        arrays.aggregation,
        arrays.edge_start,
        arrays.source,
        arrays.weight,
    )


@jit
def aggregate(kind: int, slots: Array, source: Array, weight: Array, start: int, end: int) -> float:
    """One node's aggregation of ``slots[source] * weight`` over its edges, in their order; neat-python's for none."""
    if kind in (_SUM, _MEAN):
        total = 0.0
        for e in range(start, end):
            total += slots[source[e]] * weight[e]
        return total / (end - start) if kind == _MEAN and end > start else total
    if kind == _PRODUCT:
        total = 1.0
        for e in range(start, end):
            total *= slots[source[e]] * weight[e]
        return total
    if start == end:
        return 0.0
    if kind == _MEDIAN:
        return _median(slots, source, weight, start, end)
    best = slots[source[start]] * weight[start]
    for e in range(start + 1, end):
        term = slots[source[e]] * weight[e]
        if kind == _MAX:
            is_better = term > best
        elif kind == _MIN:
            is_better = term < best
        else:
            is_better = abs(term) > abs(best)
        if is_better:
            best = term
    return float(best)


@jit
def _median(slots: Array, source: Array, weight: Array, start: int, end: int) -> float:
    terms = np.empty(end - start)
    for e in range(start, end):
        terms[e - start] = slots[source[e]] * weight[e]
    terms.sort()
    middle = len(terms) // 2
    return float(terms[middle] if len(terms) % 2 == 1 else (terms[middle - 1] + terms[middle]) / 2.0)


@jit
def _clamp(z: float, limit: float) -> float:
    return max(-limit, min(limit, z))


@jit
def activation_value(kind: int, z: float) -> float:
    """A node's activation. For a ``z`` that is not finite it may be any number: check ``z`` itself."""
    if kind == _SIGMOID:
        return 1.0 / (1.0 + math.exp(-_clamp(5.0 * z, 60.0)))
    if kind == _TANH:
        return math.tanh(_clamp(2.5 * z, 60.0))
    if kind == _SIN:
        return math.sin(_clamp(5.0 * z, 60.0))
    if kind == _GAUSS:
        return math.exp(-5.0 * math.pow(_clamp(z, 3.4), 2.0))
    if kind == _RELU:
        return z if z > 0.0 else 0.0
    if kind == _ELU:
        return z if z > 0.0 else math.exp(z) - 1.0
    if kind == _LELU:
        return z if z > 0.0 else 0.005 * z
    if kind == _SELU:
        return _SELU_LAMBDA * z if z > 0.0 else _SELU_LAMBDA * _SELU_ALPHA * (math.exp(z) - 1.0)
    if kind == _SOFTPLUS:
        return 0.2 * math.log(1.0 + math.exp(_clamp(5.0 * z, 60.0)))
    if kind == _IDENTITY:
        return z
    if kind == _CLAMPED:
        return _clamp(z, 1.0)
    if kind == _INV:
        return 1.0 / z if z != 0.0 else 0.0
    if kind == _LOG:
        return math.log(max(1e-7, z))
    if kind == _EXP:
        return math.exp(_clamp(z, 60.0))
    if kind == _ABS:
        return abs(z)
    if kind == _HAT:
        return max(0.0, 1.0 - abs(z))
    if kind == _SQUARE:
        return math.pow(z, 2.0)  # as neat-python has it; z * z could differ in the last bit
    return math.pow(z, 3.0)
