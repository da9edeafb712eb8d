"""The genes of many genomes in flat arrays, and the genetic distance between them, compiled.

:func:`distances` gives the numbers of ``neat.DefaultGenome.distance`` to the last bit: the same terms, added up in the
same order, which is that of the first genome's own dictionaries. numba does not fuse products and sums unless asked to.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final

import numpy as np

from flora_common.arrays import Array
from flora_common.network import ACTIVATIONS, AGGREGATIONS
from flora_lab.simulator.rod import jit

ACTIVATION_NUMBERS: Final = {name: k for k, name in enumerate(ACTIVATIONS)}
AGGREGATION_NUMBERS: Final = {name: k for k, name in enumerate(AGGREGATIONS)}
"""Functions as numbers, in compiled code."""

_KEY_BITS: Final = 32


@dataclass(frozen=True, slots=True)
class FlatGenes:
    """Genes of G genomes with N nodes and E connections in all, each genome's in the order of its dictionaries.

    Attributes:
        node_start, link_start: shape (G + 1,), int64: genome g has the nodes and connections from ``start[g]`` up to
            ``start[g + 1]``.
        node: keys of the nodes, shape (N,), int64.
        bias, response, time_constant: shape (N,), float64.
        activation, aggregation: numbers of the functions, shape (N,), int64.
        source, target: keys of the nodes that a connection joins, shape (E,), int64; inputs are negative.
        weight: shape (E,), float64.
        enabled: shape (E,), int8.
    """

    node_start: Array
    link_start: Array
    node: Array
    bias: Array
    response: Array
    time_constant: Array
    activation: Array
    aggregation: Array
    source: Array
    target: Array
    weight: Array
    enabled: Array

    def __len__(self) -> int:
        return len(self.node_start) - 1


def flatten(genomes: Sequence[Any]) -> FlatGenes:
    """Read the genes of ``neat.DefaultGenome`` or a subclass of it."""
    keys: list[int] = []
    nodes: list[Any] = []
    pairs: list[tuple[int, int]] = []
    links: list[Any] = []
    node_start, link_start = array("q", [0]), array("q", [0])
    for genome in genomes:
        keys += genome.nodes
        nodes += genome.nodes.values()
        pairs += genome.connections
        links += genome.connections.values()
        node_start.append(len(keys))
        link_start.append(len(pairs))
    ends = _of("q", list(chain.from_iterable(pairs))).reshape(-1, 2)
    return FlatGenes(
        node_start=np.frombuffer(node_start, dtype=np.int64),
        link_start=np.frombuffer(link_start, dtype=np.int64),
        node=_of("q", keys),
        bias=_of("d", [gene.bias for gene in nodes]),
        response=_of("d", [gene.response for gene in nodes]),
        time_constant=_of("d", [gene.time_constant for gene in nodes]),
        activation=_of("q", [ACTIVATION_NUMBERS[gene.activation] for gene in nodes]),
        aggregation=_of("q", [AGGREGATION_NUMBERS[gene.aggregation] for gene in nodes]),
        source=np.ascontiguousarray(ends[:, 0]),
        target=np.ascontiguousarray(ends[:, 1]),
        weight=_of("d", [gene.weight for gene in links]),
        enabled=_of("b", [gene.enabled for gene in links]),
    )


def _of(kind: str, values: list[Any]) -> Array:
    # array.array reads a list several times faster than numpy does.
    return np.frombuffer(array(kind, values), dtype={"q": np.int64, "d": np.float64, "b": np.int8}[kind])


@dataclass(frozen=True, slots=True)
class SortedGenes:
    """Genes, and for each genome the order of its keys, so that two genomes can be gone through side by side.

    Attributes:
        flat: the genes.
        node_order, link_order: places in the flat arrays, sorted by key within each genome.
        link: one number per connection, the same for the same pair of nodes, shape (E,), int64.
    """

    flat: FlatGenes
    node_order: Array
    link_order: Array
    link: Array

    @classmethod
    def of(cls, genomes: Sequence[Any]) -> SortedGenes:
        flat = flatten(genomes)
        link = (flat.source << _KEY_BITS) + flat.target
        return cls(flat, _orders(flat.node, flat.node_start), _orders(link, flat.link_start), link)


@jit
def _orders(keys: Array, start: Array) -> Array:
    """Places sorted by key within each genome. Insertion: keys come nearly in order, and few at a time."""
    order = np.arange(len(keys))
    for g in range(len(start) - 1):
        for i in range(start[g] + 1, start[g + 1]):
            place = order[i]
            j = i
            while j > start[g] and keys[order[j - 1]] > keys[place]:
                order[j] = order[j - 1]
                j -= 1
            order[j] = place
    return order


def distances(first: SortedGenes, place: int, others: SortedGenes, disjoint: float, weight: float) -> Array:
    """``first[place].distance(other)`` for all others, to the last bit.

    Args:
        first, place: the genome that is asked.
        others: the genomes that it is compared with.
        disjoint, weight: ``compatibility_disjoint_coefficient`` and ``compatibility_weight_coefficient``.

    Returns:
        Shape (number of others,).
    """
    a, b = first.flat, others.flat
    return np.asarray(
        _row(
            place,
            (a.node_start, a.link_start, first.node_order, first.link_order, a.node, first.link),
            (a.bias, a.response, a.time_constant, a.activation, a.aggregation, a.weight, a.enabled),
            (b.node_start, b.link_start, others.node_order, others.link_order, b.node, others.link),
            (b.bias, b.response, b.time_constant, b.activation, b.aggregation, b.weight, b.enabled),
            disjoint,
            weight,
        )
    )


@jit
def _partners(
    keys_a: Array, order_a: Array, a0: int, a1: int, keys_b: Array, order_b: Array, b0: int, b1: int, partner: Array
) -> int:
    """For each gene of a the place of the gene of b with its key, or -1; and how many genes have no partner."""
    single = 0
    i, j = a0, b0
    while i < a1 and j < b1:
        ka, kb = keys_a[order_a[i]], keys_b[order_b[j]]
        if ka == kb:
            partner[order_a[i] - a0] = order_b[j]
            i += 1
            j += 1
        elif ka < kb:
            partner[order_a[i] - a0] = -1
            single += 1
            i += 1
        else:
            single += 1
            j += 1
    while i < a1:
        partner[order_a[i] - a0] = -1
        single += 1
        i += 1
    return single + b1 - j


@jit
def _row(place: int, keys_a: Any, values_a: Any, keys_b: Any, values_b: Any, disjoint: float, weight: float) -> Array:
    nodes_a, links_a, node_order_a, link_order_a, node_a, link_a = keys_a
    bias_a, response_a, time_a, activation_a, aggregation_a, weight_a, enabled_a = values_a
    nodes_b, links_b, node_order_b, link_order_b, node_b, link_b = keys_b
    bias_b, response_b, time_b, activation_b, aggregation_b, weight_b, enabled_b = values_b
    n0, n1, l0, l1 = nodes_a[place], nodes_a[place + 1], links_a[place], links_a[place + 1]
    partner = np.empty(max(n1 - n0, l1 - l0), dtype=np.int64)
    count = len(nodes_b) - 1
    found = np.empty(count)
    for g in range(count):
        m0, m1, k0, k1 = nodes_b[g], nodes_b[g + 1], links_b[g], links_b[g + 1]
        node_distance, link_distance = 0.0, 0.0
        single = _partners(node_a, node_order_a, n0, n1, node_b, node_order_b, m0, m1, partner)
        for i in range(n0, n1):
            j = partner[i - n0]
            if j >= 0:
                d = abs(bias_a[i] - bias_b[j]) + abs(response_a[i] - response_b[j])
                d += abs(time_a[i] - time_b[j])
                if activation_a[i] != activation_b[j]:
                    d += 1.0
                if aggregation_a[i] != aggregation_b[j]:
                    d += 1.0
                node_distance += d * weight
        largest = max(n1 - n0, m1 - m0)
        if largest > 0:
            node_distance = (node_distance + disjoint * single) / largest
        single = _partners(link_a, link_order_a, l0, l1, link_b, link_order_b, k0, k1, partner)
        for i in range(l0, l1):
            j = partner[i - l0]
            if j >= 0:
                d = abs(weight_a[i] - weight_b[j])
                if enabled_a[i] != enabled_b[j]:
                    d += 1.0
                link_distance += d * weight
        largest = max(l1 - l0, k1 - k0)
        if largest > 0:
            link_distance = (link_distance + disjoint * single) / largest
        found[g] = node_distance + link_distance
    return found
