"""Networks of neat-python: of random genomes, far more varied than evolution makes them, and some that can steer."""

from __future__ import annotations

import random
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, Final

from neat.activations import ActivationFunctionSet
from neat.aggregations import AggregationFunctionSet
from neat.genome import DefaultGenome
from neat.innovation import InnovationTracker
from neat.nn import FeedForwardNetwork

from flora_common.controller_file import INPUT_NAMES
from flora_common.network import ACTIVATIONS, AGGREGATIONS

INPUTS: Final = 26


def genome_config(*, calm: bool = False) -> Any:
    """For genomes of 26 inputs and one output; ``calm`` ones have sigmoids and sums only, as evolution has."""
    number = {"init_mean": 0.0, "init_stdev": 1.5, "init_type": "gaussian", "max_value": 30.0, "min_value": -30.0}
    change = {"mutate_rate": 0.8, "mutate_power": 0.5, "replace_rate": 0.1}
    params: dict[str, Any] = {
        "num_inputs": INPUTS,
        "num_outputs": 1,
        "num_hidden": 2,
        "feed_forward": "true",
        "compatibility_disjoint_coefficient": 1.0,
        "compatibility_weight_coefficient": 0.5,
        "conn_add_prob": 0.6,
        "conn_delete_prob": 0.2,
        "node_add_prob": 0.4,
        "node_delete_prob": 0.1,
        "initial_connection": "partial_direct 0.4",
        "enabled_default": "true",
        "enabled_mutate_rate": 0.05,
        "enabled_rate_to_true_add": 0.0,
        "enabled_rate_to_false_add": 0.0,
        "activation_default": "sigmoid",
        "activation_mutate_rate": 0.0 if calm else 0.3,
        "activation_options": "sigmoid" if calm else " ".join(ACTIVATIONS),
        "aggregation_default": "sum",
        "aggregation_mutate_rate": 0.0 if calm else 0.3,
        "aggregation_options": "sum" if calm else " ".join(AGGREGATIONS),
    }
    for name in ("bias", "response", "time_constant", "weight"):
        params |= {f"{name}_{key}": value for key, value in (number | change).items()}
    config = DefaultGenome.parse_config({key: str(value) for key, value in params.items()})
    config.innovation_tracker = InnovationTracker()
    return SimpleNamespace(genome_config=config)


def random_networks(count: int, seed: int, *, calm: bool = False, mutations: int = 30) -> list[Any]:
    """neat-python's networks of random genomes."""
    config = genome_config(calm=calm)
    genomes = random_genomes(count, seed, config, mutations=mutations)
    return [FeedForwardNetwork.create(genome, config) for genome in genomes]


def random_genomes(count: int, seed: int, config: Any, *, mutations: int = 30, steering: bool = False) -> list[Any]:
    """Random genomes; ``steering`` ones tend to drive the tip towards the target, and so switch the lamps often."""
    before = random.getstate()
    random.seed(seed)
    try:
        return [_genome(config, key, mutations, steering) for key in range(count)]
    finally:
        random.setstate(before)


def _genome(config: Any, key: int, mutations: int, steering: bool) -> Any:
    genome = DefaultGenome(key)
    genome.configure_new(config.genome_config)
    for _ in range(random.randint(0, mutations)):
        genome.mutate(config.genome_config)
    if steering:
        for name, weight in (("x10", -25.0), ("target_x", 25.0)):
            link = (-1 - INPUT_NAMES.index(name), 0)
            gene = genome.create_connection(config.genome_config, *link, 10_000 + link[0])
            gene.weight, gene.enabled = weight, True
            genome.connections[link] = gene
    return genome


def overflowing(config: Any) -> Any:
    """Five nodes in a row, each the cube of the one before: beyond all numbers."""
    (genome,) = random_genomes(1, 1, config, mutations=0)
    genome.connections.clear()
    keys = [-1, 101, 102, 103, 104, 105, 0]
    for number, (source, target) in enumerate(pairwise(keys)):
        if target:
            genome.nodes[target] = genome.create_node(config.genome_config, target)
        genome.nodes[target].activation, genome.nodes[target].aggregation = "cube", "sum"
        genome.nodes[target].bias = genome.nodes[target].response = 30.0
        gene = genome.create_connection(config.genome_config, source, target, 20_000 + number)
        gene.weight, gene.enabled = 30.0, True
        genome.connections[source, target] = gene
    return genome


def followers(count: int, seed: int) -> list[Any]:
    """Networks that steer the tip towards the target, each with whims of its own, and so switch the lamps often."""
    rng = random.Random(seed)
    tip, target = -1 - INPUT_NAMES.index("x10"), -1 - INPUT_NAMES.index("target_x")
    keys = list(range(-1, -1 - INPUTS, -1))
    sigmoid, added = ActivationFunctionSet().get("sigmoid"), AggregationFunctionSet().get("sum")
    found = []
    for _ in range(count):
        whims = [(key, rng.gauss(0.0, 0.1)) for key in keys if key not in (tip, target)]
        links = [(tip, -1.0), (target, 1.0), *whims]
        found.append(FeedForwardNetwork(keys, [0], [(0, sigmoid, added, rng.gauss(0.0, 0.05), 1.0, links)]))
    return found
