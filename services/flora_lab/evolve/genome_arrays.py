"""Genomes of any feed-forward topology as flat arrays, for compiled code.

The arrays hold what ``neat.nn.FeedForwardNetwork.create`` would evaluate: nodes that an output depends on, each after
those that it reads, and each node's incoming connections in neat-python's order, which is the order of adding up. So
sums, products and means are those of neat-python to the last bit.

What neat-python does with a value that is not finite: a sigmoid turns NaN into a confident 1.0. Here, as in
:mod:`flora_common.network`, a network with an input or a node's value that is not finite, or with an input larger than
``MAX_NUMBER``, gives NaN for all its outputs: no answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from flora_common.arrays import Array
from flora_common.errors import BadInput
from flora_common.network import MAX_NUMBER
from flora_lab.evolve.neat_genes import FlatGenes, flatten
from flora_lab.simulator.rod import jit


@dataclass(frozen=True, slots=True)
class GenomeArrays:
    """G networks with N nodes and E enabled connections in all that lead to an output.

    While one is evaluated, its values stand in slots: first those of the inputs, then those of its nodes in order.

    Attributes:
        keys: of the genomes, shape (G,), int64.
        inputs: how many inputs each network has.
        node_start: shape (G + 1,), int64: network g has the nodes from ``node_start[g]`` to ``node_start[g + 1]``.
        node: keys of the nodes, shape (N,), int64; each comes after those that it reads.
        bias, response: shape (N,), float64.
        activation, aggregation: shape (N,), int64; numbers of
            :data:`flora_lab.evolve.neat_genes.ACTIVATION_NUMBERS` and ``AGGREGATION_NUMBERS``.
        edge_start: shape (N + 1,), int64: node n reads the edges from ``edge_start[n]`` to ``edge_start[n + 1]``.
        source: the slot that an edge reads, shape (E,), int64.
        weight: shape (E,), float64.
        output: slots of the outputs, shape (G, number of outputs), int64.
    """

    keys: Array
    inputs: int
    node_start: Array
    node: Array
    bias: Array
    response: Array
    activation: Array
    aggregation: Array
    edge_start: Array
    source: Array
    weight: Array
    output: Array

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def slots(self) -> int:
        """What the largest network needs."""
        return self.inputs + int(np.diff(self.node_start).max(initial=0))


def pack(genomes: Sequence[Any], inputs: int, outputs: int = 1) -> GenomeArrays:
    """Make arrays of genomes.

    Args:
        genomes: of ``neat.DefaultGenome`` or a subclass; any number.
        inputs, outputs: ``num_inputs`` and ``num_outputs`` of their settings.

    Raises:
        BadInput: a network that is recurrent, a connection from or to a node that there is not, or a bias, response
            or weight that is not finite or beyond ``MAX_NUMBER``. It names the genome.
    """
    flat = flatten(genomes)
    keys = np.array([genome.key if genome.key is not None else -1 for genome in genomes], dtype=np.int64)
    for name, values, start in (
        ("bias", flat.bias, flat.node_start),
        ("response", flat.response, flat.node_start),
        ("weight", flat.weight, flat.link_start),
    ):
        wrong = np.flatnonzero(~(np.abs(values) <= MAX_NUMBER))
        if len(wrong):
            key = keys[np.searchsorted(start, wrong[0], side="right") - 1]
            raise BadInput(f"genome {key}: a {name} is {values[wrong[0]]:g}; it must be finite, at most {MAX_NUMBER:g}")
    return _arranged(flat, keys, inputs, outputs)


def _arranged(flat: FlatGenes, keys: Array, inputs: int, outputs: int) -> GenomeArrays:
    nodes, edges = len(flat.node), len(flat.source)
    node_start = np.zeros(len(flat) + 1, dtype=np.int64)
    order = np.empty(nodes, dtype=np.int64)
    edge_start = np.zeros(nodes + 1, dtype=np.int64)
    source, edge = np.empty(edges, dtype=np.int64), np.empty(edges, dtype=np.int64)
    output = np.empty((len(flat), outputs), dtype=np.int64)
    failed, why = _arrange(
        flat.node_start,
        flat.link_start,
        flat.node,
        flat.source,
        flat.target,
        flat.enabled,
        inputs,
        node_start,
        order,
        edge_start,
        source,
        edge,
        output,
    )
    if failed >= 0:
        raise BadInput(f"genome {keys[failed]}: {_REASONS[why]}")
    used = node_start[-1]
    order, edge = order[:used], edge[: edge_start[used]]
    return GenomeArrays(
        keys=keys,
        inputs=inputs,
        node_start=node_start,
        node=flat.node[order],
        bias=flat.bias[order],
        response=flat.response[order],
        activation=flat.activation[order],
        aggregation=flat.aggregation[order],
        edge_start=edge_start[: used + 1].copy(),
        source=source[: len(edge)].copy(),
        weight=flat.weight[edge],
        output=output,
    )


_NO_OUTPUT, _NO_NODE, _RECURRENT = 1, 2, 3
_REASONS: Final = {
    _NO_OUTPUT: "an output has no node",
    _NO_NODE: "a connection joins nodes that the genome does not have",
    _RECURRENT: "the network is recurrent; only feed-forward networks can be evaluated (feed_forward = True)",
}


@jit
def _place_of(key: int, sorted_keys: Array, places: Array) -> int:
    at = np.searchsorted(sorted_keys, key)
    return places[at] if at < len(sorted_keys) and sorted_keys[at] == key else -1


@jit
def _arrange(
    genome_nodes: Array,
    genome_links: Array,
    node: Array,
    link_source: Array,
    link_target: Array,
    enabled: Array,
    inputs: int,
    node_start: Array,
    order: Array,
    edge_start: Array,
    source: Array,
    edge: Array,
    output: Array,
) -> tuple[int, int]:
    """Fill the arrays after ``inputs``. Returns the genome that cannot be arranged and why, or (-1, 0)."""
    nodes, edges = 0, 0
    for g in range(len(genome_nodes) - 1):
        n0, l0, l1 = genome_nodes[g], genome_links[g], genome_links[g + 1]
        keys = node[n0 : genome_nodes[g + 1]]
        count = len(keys)
        places = np.argsort(keys)
        sorted_keys = keys[places]
        # From each enabled connection the node that it reads (-1: an input) and the node that it leads to.
        reads, leads = np.full(l1 - l0, -1), np.full(l1 - l0, -1)
        for k in range(l0, l1):
            if enabled[k]:
                leads[k - l0] = _place_of(link_target[k], sorted_keys, places)
                if link_source[k] >= 0:
                    reads[k - l0] = _place_of(link_source[k], sorted_keys, places)
                no_source = reads[k - l0] < 0 if link_source[k] >= 0 else link_source[k] < -inputs
                if leads[k - l0] < 0 or no_source:
                    return g, _NO_NODE
        # Upstream from the outputs: what is needed.
        needed = np.zeros(count, dtype=np.bool_)
        for o in range(output.shape[1]):
            place = _place_of(o, sorted_keys, places)
            if place < 0:
                return g, _NO_OUTPUT
            needed[place] = True
        is_new = True
        while is_new:
            is_new = False
            for k in range(l1 - l0):
                if leads[k] >= 0 and needed[leads[k]] and reads[k] >= 0 and not needed[reads[k]]:
                    needed[reads[k]] = is_new = True
        # Each node after those that it reads, in rounds over all connections.
        slot = np.full(count, -1)
        left = 0
        for place in range(count):
            left += needed[place]
        first = nodes
        while left > 0:
            before = left
            for place in range(count):
                if not needed[place] or slot[place] >= 0:
                    continue
                is_ready = True
                for k in range(l1 - l0):
                    if leads[k] == place and reads[k] >= 0 and slot[reads[k]] < 0:
                        is_ready = False
                        break
                if not is_ready:
                    continue
                slot[place] = inputs + nodes - first
                order[nodes] = n0 + place
                for k in range(l1 - l0):
                    if leads[k] == place:
                        source[edges] = slot[reads[k]] if reads[k] >= 0 else -link_source[l0 + k] - 1
                        edge[edges] = l0 + k
                        edges += 1
                nodes += 1
                edge_start[nodes] = edges
                left -= 1
            if left == before:
                return g, _RECURRENT
        node_start[g + 1] = nodes
        for o in range(output.shape[1]):
            output[g, o] = slot[_place_of(o, sorted_keys, places)]
    return -1, 0
