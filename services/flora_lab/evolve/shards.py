"""A population evaluated in parts, put together to what it would have come to in one piece.

An episode depends on its genome alone, so parts may be evaluated anywhere. What parts cost is sharing: a plant that
several genomes have in common is simulated once in every part that has one of them. So a part is only worth its while
where it is large.
"""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from flora_lab.evolve.episode import Outcomes
from flora_lab.evolve.evaluate import Evaluated
from flora_lab.evolve.genome_arrays import GenomeArrays
from flora_lab.evolve.shared_steps import shared_steps

LEAST_GENOMES: Final = 500
"""In a part. docs/how-to/evolve-on-many-machines.md has what smaller ones cost."""


def shard_count(population: int, processors: int, *, least: int = LEAST_GENOMES) -> int:
    """Into how many parts a population is divided.

    Args:
        population: how many genomes.
        processors: that are free for it.
        least: genomes in a part.
    """
    return max(1, min(processors, population // least))


def divided(genomes: GenomeArrays, count: int) -> list[GenomeArrays]:
    """A population in ``count`` parts of nearly the same size, in order. No part is empty."""
    ends = np.linspace(0, len(genomes), max(1, min(count, len(genomes))) + 1).astype(int).tolist()
    return [_part(genomes, first, end) for first, end in pairwise(ends)]


def joined(parts: Sequence[Evaluated]) -> Evaluated:
    """What the parts came to, in their order, as one population.

    ``steps_run`` is what the population would have taken in one piece, so that an evolution's history does not depend
    on how many machines there were.
    """
    if len(parts) == 1:
        return parts[0]
    each = [part.outcomes for part in parts]
    outcomes = Outcomes(
        fitness=np.concatenate([part.fitness for part in each]),
        reason=np.concatenate([part.reason for part in each]),
        steps=np.concatenate([part.steps for part in each]),
        tip_cm=np.concatenate([part.tip_cm for part in each]),
        is_right=np.concatenate([part.is_right for part in each]),
    )
    return Evaluated(outcomes, shared_steps(outcomes))


def to_bytes(evaluated: Evaluated) -> bytes:
    """For the way between machines; eight lamps in a byte, for they are most of it."""
    outcomes = evaluated.outcomes
    most_steps = outcomes.is_right.shape[-1]
    lamps = np.packbits(outcomes.is_right, axis=-1)
    arrays = (outcomes.fitness, outcomes.reason, outcomes.steps, outcomes.tip_cm)
    return pickle.dumps((arrays, lamps, most_steps, evaluated.steps_run), protocol=pickle.HIGHEST_PROTOCOL)


def from_bytes(data: bytes) -> Evaluated:
    """What :func:`to_bytes` made; never of bytes from elsewhere."""
    (fitness, reason, steps, tip_cm), lamps, most_steps, steps_run = pickle.loads(data)
    is_right = np.unpackbits(lamps, axis=-1, count=most_steps).astype(np.bool_)
    return Evaluated(Outcomes(fitness, reason, steps, tip_cm, is_right), steps_run)


def _part(genomes: GenomeArrays, first: int, end: int) -> GenomeArrays:
    nodes = slice(genomes.node_start[first], genomes.node_start[end])
    edges = slice(genomes.edge_start[nodes.start], genomes.edge_start[nodes.stop])
    return GenomeArrays(
        keys=genomes.keys[first:end],
        inputs=genomes.inputs,
        node_start=genomes.node_start[first : end + 1] - nodes.start,
        node=genomes.node[nodes],
        bias=genomes.bias[nodes],
        response=genomes.response[nodes],
        activation=genomes.activation[nodes],
        aggregation=genomes.aggregation[nodes],
        edge_start=genomes.edge_start[nodes.start : nodes.stop + 1] - edges.start,
        source=genomes.source[edges],
        weight=genomes.weight[edges],
        output=genomes.output[first:end],
    )
