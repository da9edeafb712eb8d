"""Packed genomes answer as neat-python's networks do, and have no answer where a number is not finite."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from typing import Any

import neat
import numpy as np
import pytest
from evolve_neat_toys import settings_with, toy_fitness
from evolve_reference import activate
from hypothesis import given, settings
from hypothesis import strategies as st
from neat.genes import DefaultConnectionGene, DefaultNodeGene

from flora_common.errors import BadInput
from flora_common.network import ACTIVATIONS, AGGREGATIONS, Network, Node, NotFinite
from flora_lab.evolve.genome_arrays import pack
from flora_lab.evolve.neat_engine import NeatEngine
from flora_lab.evolve.neat_settings import load_settings

INPUTS, OUTPUTS = 4, 2


class FourInputs:
    """What ``FeedForwardNetwork.create`` reads of a ``neat.Config``."""

    genome_config = neat.DefaultGenome.parse_config(
        dict(load_settings().sections["DefaultGenome"])
        | {"num_inputs": INPUTS, "num_outputs": OUTPUTS, "feed_forward": "True", "activation_options": "sigmoid"}
        | {"aggregation_options": "sum", "single_structural_mutation": "False"}
    )


def genome_of(
    nodes: Sequence[tuple[int, str, str, float, float]], links: Sequence[tuple[int, int, float, bool]], key: int = 1
) -> Any:
    """Nodes as (key, activation, aggregation, bias, response), links as (from, to, weight, enabled)."""
    genome = neat.DefaultGenome(key)
    for node_key, activation, aggregation, bias, response in nodes:
        node = genome.nodes[node_key] = DefaultNodeGene(node_key)
        node.activation, node.aggregation, node.time_constant = activation, aggregation, 1.0
        node.bias, node.response = bias, response
    for number, (source, target, weight, enabled) in enumerate(links, 1):
        gene = genome.connections[source, target] = DefaultConnectionGene((source, target), innovation=number)
        gene.weight, gene.enabled = weight, enabled
    return genome


@st.composite
def genomes(draw: st.DrawFn) -> Any:
    """Feed-forward genomes of every function, with dead ends, orphans and disabled links, nodes in any order."""
    hidden = draw(st.integers(0, 7))
    order = draw(st.permutations(range(OUTPUTS, OUTPUTS + hidden)))
    number = st.floats(-3.0, 3.0)
    nodes = [
        (key, draw(st.sampled_from(sorted(ACTIVATIONS))), draw(st.sampled_from(sorted(AGGREGATIONS))), b, r)
        for key in draw(st.permutations(range(OUTPUTS + hidden)))
        for b, r in [(draw(number), draw(number))]
    ]
    possible = [(source, target) for source in range(-INPUTS, 0) for target in range(OUTPUTS + hidden)]
    possible += [(a, b) for i, a in enumerate(order) for b in (*order[i + 1 :], *range(OUTPUTS))]
    chosen = draw(st.lists(st.sampled_from(possible), unique=True, max_size=30))
    return genome_of(nodes, [(a, b, draw(number), draw(st.integers(0, 4)) > 0) for a, b in chosen])


def checked_network(genome: Any) -> Network:
    """The rig's evaluator with neat-python's own order of nodes and links."""
    network = neat.nn.FeedForwardNetwork.create(genome, FourInputs)
    return Network(
        network.input_nodes,
        network.output_nodes,
        [
            Node(key, genome.nodes[key].activation, genome.nodes[key].aggregation, bias, response, tuple(links))
            for key, _, _, bias, response, links in network.node_evals
        ],
    )


@settings(max_examples=250, deadline=None)
@given(genomes(), st.lists(st.floats(-20.0, 20.0), min_size=INPUTS, max_size=INPUTS))
def test_the_answers_are_neat_pythons_to_the_bit(genome: Any, inputs: list[float]) -> None:
    answers = activate(pack([genome], INPUTS, OUTPUTS), inputs)[0]

    try:
        checked = checked_network(genome).activate(inputs)
    except NotFinite:
        assert np.isnan(answers).all()
        return
    assert answers.tolist() == neat.nn.FeedForwardNetwork.create(genome, FourInputs).activate(inputs)
    assert answers.tolist() == list(checked)


def evolved(tmp_path: Any, generations: int = 15) -> NeatEngine:
    engine = NeatEngine(
        settings_with(
            tmp_path,
            Genome__node_add_prob=0.5,
            Genome__conn_add_prob=0.5,
            Genome__conn_delete_prob=0.3,
            Genome__node_delete_prob=0.1,
            Genome__activation_options="sigmoid tanh gauss",
            Genome__activation_default="random",
            Genome__aggregation_options="sum max",
        ),
        3,
    )
    for _ in range(generations):
        engine.generation(toy_fitness)
    return engine


def test_a_whole_population_is_packed_at_once_and_each_as_alone(tmp_path: Any) -> None:
    engine = evolved(tmp_path)
    draw = random.Random(1)
    inputs = [[draw.uniform(-2.0, 2.0) for _ in range(26)] for _ in engine.genomes]
    arrays = pack(engine.genomes, 26)

    together = activate(arrays, inputs)

    for genome, mine, answer in zip(engine.genomes, inputs, together, strict=True):
        assert activate(pack([genome], 26), mine).tolist() == [answer.tolist()]
        assert answer.tolist() == neat.nn.FeedForwardNetwork.create(genome, engine.config).activate(mine)
    assert len(np.unique(np.diff(arrays.node_start))) > 3
    assert arrays.keys.tolist() == list(engine.population)
    # The same inputs for all may be given once.
    assert activate(arrays, inputs[0]).tolist() == activate(arrays, [inputs[0]] * len(arrays)).tolist()


def test_each_node_comes_after_those_that_it_reads(tmp_path: Any) -> None:
    arrays = pack(evolved(tmp_path).genomes, 26)

    for g in range(len(arrays)):
        first = arrays.node_start[g]
        for n in range(first, arrays.node_start[g + 1]):
            read = arrays.source[arrays.edge_start[n] : arrays.edge_start[n + 1]]
            assert (read < 26 + n - first).all()
    assert arrays.edge_start[-1] == len(arrays.source) == len(arrays.weight)
    assert arrays.slots == 26 + np.diff(arrays.node_start).max()


def test_dead_ends_and_disabled_links_are_left_out() -> None:
    nodes = [(0, "sigmoid", "sum", 0.5, 1.0), (1, "sigmoid", "sum", 0.0, 1.0)]
    nodes += [(key, "tanh", "sum", 0.0, 1.0) for key in (2, 3)]
    links = [(-1, 2, 1.0, True), (-2, 3, 1.0, True), (3, 0, 2.0, False), (2, 1, 0.7, True), (-4, 0, 1.0, False)]

    arrays = pack([genome_of(nodes, links)], INPUTS, OUTPUTS)

    assert sorted(arrays.node.tolist()) == [0, 1, 2]
    assert sorted(arrays.weight.tolist()) == [0.7, 1.0]
    assert activate(arrays, [0.0] * 4)[0, 0] == 1.0 / (1.0 + math.exp(-2.5))


def test_no_genomes() -> None:
    arrays = pack([], INPUTS, OUTPUTS)

    assert (len(arrays), arrays.slots, activate(arrays, [0.0] * 4).shape) == (0, 4, (0, 2))


@pytest.mark.parametrize("activation", ["sigmoid", "tanh", "relu", "clamped"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e308])
def test_an_input_that_is_not_finite_has_no_answer(activation: str, value: float) -> None:
    """neat-python's sigmoid makes 1.0 of NaN, its relu 0.0; also where nothing reads the input."""
    nodes = [(0, activation, "sum", 0.0, 1.0), (1, activation, "sum", 0.0, 1.0)]
    genome = genome_of(nodes, [(-1, 0, 1.0, True), (-2, 1, 0.5, True)])
    arrays = pack([genome, genome], INPUTS, OUTPUTS)
    sound = [0.1, 0.2, 0.3, 0.4]
    assert np.isfinite(activate(arrays, sound)).all()

    for place in range(INPUTS):
        inputs = [sound, [*sound[:place], value, *sound[place + 1 :]]]

        answers = activate(arrays, inputs)

        assert np.isfinite(answers[0]).all()
        assert np.isnan(answers[1]).all()


def test_a_sum_that_grows_beyond_all_numbers_has_no_answer() -> None:
    nodes = [(0, "sigmoid", "sum", 0.0, 1.0), (1, "sigmoid", "sum", 0.0, 1.0)]
    nodes += [(key, "cube", "sum", 0.0, 1.0) for key in range(2, 7)]
    links = [(-1, 2, 1e5, True), *((k, k + 1, 1.0, True) for k in range(2, 6)), (6, 0, 1.0, True), (-1, 1, 1.0, True)]

    answers = activate(pack([genome_of(nodes, links)], INPUTS, OUTPUTS), [1.0] * INPUTS)

    assert np.isnan(answers).all()


@pytest.mark.parametrize("links", [[(0, 0)], [(2, 3), (3, 2), (3, 0)], [(2, 3), (3, 4), (4, 2), (-1, 2), (4, 1)]])
def test_a_recurrent_network_is_refused(links: list[tuple[int, int]]) -> None:
    nodes = [(key, "sigmoid", "sum", 0.0, 1.0) for key in range(5)]
    good = genome_of(nodes, [(-1, 0, 1.0, True)], key=8)
    bad = genome_of(nodes, [(*link, 1.0, True) for link in links], key=9)

    with pytest.raises(BadInput, match="genome 9: the network is recurrent; only feed-forward"):
        pack([good, bad], INPUTS, OUTPUTS)


def test_a_cycle_that_no_output_depends_on_or_that_is_disabled_is_none() -> None:
    nodes = [(key, "sigmoid", "sum", 0.0, 1.0) for key in range(4)]
    links = [(2, 3, 1.0, True), (3, 2, 1.0, True), (0, 1, 1.0, True), (1, 0, 1.0, False)]

    assert pack([genome_of(nodes, links)], INPUTS, OUTPUTS).node.tolist() == [0, 1]


@pytest.mark.parametrize(
    ("links", "message"),
    [
        ([(-1, 5, 1.0, True)], "a connection joins nodes that the genome does not have"),
        ([(5, 0, 1.0, True)], "a connection joins nodes that the genome does not have"),
        ([(-5, 0, 1.0, True)], "a connection joins nodes that the genome does not have"),
        ([(-1, 0, math.nan, True)], "a weight is nan; it must be finite, at most 1e"),
        ([(-1, 0, 2e6, True)], r"a weight is 2e\+06; it must be finite"),
    ],
)
def test_genomes_that_cannot_be_are_refused(links: list[tuple[int, int, float, bool]], message: str) -> None:
    nodes = [(key, "sigmoid", "sum", 0.0, 1.0) for key in range(2)]

    with pytest.raises(BadInput, match=f"genome 9: {message}"):
        pack([genome_of(nodes, [(-1, 1, 1.0, True)]), genome_of(nodes, links, key=9)], INPUTS, OUTPUTS)


def test_a_bias_that_is_not_finite_and_a_missing_output_are_refused() -> None:
    with pytest.raises(BadInput, match="genome 1: a bias is inf"):
        pack([genome_of([(0, "tanh", "sum", math.inf, 1.0)], [])], INPUTS, 1)
    with pytest.raises(BadInput, match="genome 1: an output has no node"):
        pack([genome_of([(0, "tanh", "sum", 0.0, 1.0)], [])], INPUTS, OUTPUTS)


def test_inputs_of_another_shape_are_refused() -> None:
    with pytest.raises(ValueError, match=r"inputs of shape \(3,\) for 0 networks of 4 inputs"):
        activate(pack([], INPUTS, OUTPUTS), [0.0] * 3)
