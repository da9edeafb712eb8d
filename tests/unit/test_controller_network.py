"""The evaluator: answers worked out by hand, neat-python's own where it is installed, and no answer for nonsense."""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Callable
from typing import Any

import pytest

from flora_common.network import ACTIVATIONS, AGGREGATIONS, Network, Node, NotFinite


def one_node(activation: str, aggregation: str = "sum", *, bias: float = 0.0, response: float = 1.0) -> Network:
    return Network(
        [-1, -2, -3], [0], [Node(0, activation, aggregation, bias, response, ((-1, 1.0), (-2, 1.0), (-3, 1.0)))]
    )


# Each by hand from the function's formula, at z = 0.3 and z = -0.3.
BY_HAND = {
    "sigmoid": (0.8175744761936437, 0.18242552380635635),  # 1 / (1 + e^-1.5)
    "tanh": (0.6351489523872873, -0.6351489523872873),  # tanh(0.75)
    "sin": (0.9974949866040544, -0.9974949866040544),  # sin(1.5)
    "gauss": (0.6376281516217733, 0.6376281516217733),  # e^-0.45
    "relu": (0.3, 0.0),
    "elu": (0.3, -0.2591817793182821),  # e^-0.3 - 1
    "lelu": (0.3, -0.0015),
    "selu": (0.31521029620664415, -0.4556673153791221),
    "softplus": (0.34028265559655047, 0.04028265559655048),  # 0.2 ln(1 + e^1.5)
    "identity": (0.3, -0.3),
    "clamped": (0.3, -0.3),
    "inv": (3.3333333333333335, -3.3333333333333335),
    "log": (-1.2039728043259361, -16.11809565095832),
    "exp": (1.3498588075760032, 0.7408182206817179),
    "abs": (0.3, 0.3),
    "hat": (0.7, 0.7),
    "square": (0.09, 0.09),
    "cube": (0.027, -0.027),
}


def test_every_activation_of_neat_python_is_there() -> None:
    assert sorted(ACTIVATIONS) == sorted(BY_HAND)


@pytest.mark.parametrize("name", sorted(BY_HAND))
def test_activation_by_hand(name: str) -> None:
    network = one_node(name)

    got = (network.activate([0.3, 0.0, 0.0])[0], network.activate([-0.3, 0.0, 0.0])[0])

    assert got == pytest.approx(BY_HAND[name], rel=1e-12)


@pytest.mark.parametrize(
    ("name", "expected"),
    [("sum", 1.5), ("product", -12.0), ("max", 4.0), ("min", -1.5), ("maxabs", 4.0), ("median", -1.0), ("mean", 0.5)],
)
def test_aggregation_by_hand(name: str, expected: float) -> None:
    values = {"product": [2.0, 4.0, -1.5]}.get(name, [-1.0, 4.0, -1.5])

    assert one_node("identity", name).activate(values)[0] == expected


def test_a_small_network_by_hand() -> None:
    # h = tanh(2.5 (0.1 + 2 * (0.5 * 0.4 - 0.2))) = tanh(0.25); out = sigmoid(5 (-0.2 + 0.5 h + 0.1 * 0.4))
    network = Network(
        [-1, -2],
        [0],
        [
            Node(7, "tanh", "sum", 0.1, 2.0, ((-1, 0.5), (-2, -1.0))),
            Node(0, "sigmoid", "sum", -0.2, 1.0, ((7, 0.5), (-1, 0.1))),
        ],
    )
    hidden = math.tanh(0.25)

    assert network.activate([0.4, 0.2]) == pytest.approx((1 / (1 + math.exp(-5 * (-0.2 + 0.5 * hidden + 0.04))),))


def test_a_node_without_links_is_its_bias() -> None:
    network = Network([-1], [0], [Node(0, "identity", "sum", 0.25, 9.0, ())])

    assert network.activate([123.0]) == (0.25,)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e308])
@pytest.mark.parametrize("activation", sorted(ACTIVATIONS))
def test_nonsense_at_an_input_is_never_an_answer(activation: str, bad: float) -> None:
    with pytest.raises(NotFinite):
        one_node(activation).activate([0.0, bad, 0.0])


def test_a_value_that_overflows_inside_is_never_an_answer() -> None:
    cubes = [Node(k, "cube", "product", 0.0, 1e6, ((k - 1, 1e6),) * 3) for k in range(1, 8)]
    network = Network([0], [8], [*cubes, Node(8, "sigmoid", "sum", 0.0, 1.0, ((7, 1.0),))])

    with pytest.raises(NotFinite):
        network.activate([3.0])


def test_infinities_that_cancel_inside_are_never_an_answer() -> None:
    grow = [Node(k, "identity", "product", 0.0, 1e6, ((k - 1, 1e6),) * 4) for k in range(1, 7)]
    network = Network([0], [9], [*grow, Node(9, "sigmoid", "sum", 0.0, 1.0, ((6, 1e6), (6, -1e6)))])

    with pytest.raises(NotFinite):
        network.activate([1e6])


@pytest.mark.parametrize("field", ["bias", "response", "weight"])
@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e308])
def test_nonsense_in_the_network_is_refused_when_it_is_made(field: str, bad: float) -> None:
    constants = {"bias": 0.0, "response": 1.0, "weight": 1.0, field: bad}
    node = Node(0, "sigmoid", "sum", constants["bias"], constants["response"], ((-1, constants["weight"]),))

    with pytest.raises(ValueError, match=f"node 0: {field}"):
        Network([-1], [0], [node])


@pytest.mark.parametrize(
    ("nodes", "said"),
    [
        ([Node(0, "sigmoid", "sum", 0, 1, ((5, 1.0),))], "reads node 5, which comes later or does not exist"),
        ([Node(0, "sigmoidal", "sum", 0, 1, ())], "unknown activation `sigmoidal`"),
        ([Node(0, "sigmoid", "total", 0, 1, ())], "unknown aggregation `total`"),
        ([Node(0, "sigmoid", "sum", 0, 1, ())] * 2, "is there twice"),
        ([], "output 0 has no node"),
    ],
)
def test_a_network_that_does_not_fit_together_is_refused(nodes: list[Node], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Network([-1], [0], nodes)


def test_another_number_of_values_is_a_bug_and_told() -> None:
    with pytest.raises(ValueError, match="2 values for 3 inputs"):
        one_node("sigmoid").activate([0.0, 0.0])


def test_against_neat_python_itself() -> None:
    """Random networks over all functions: the same to the last bit on Python 3.11."""
    nn = pytest.importorskip("neat.nn", reason="neat-python is not installed (extra `lab`)")
    from neat.activations import ActivationFunctionSet
    from neat.aggregations import AggregationFunctionSet

    activations, aggregations = ActivationFunctionSet(), AggregationFunctionSet()
    assert set(activations.functions) == set(ACTIVATIONS)
    assert set(aggregations.functions) == set(AGGREGATIONS)
    draw = random.Random(1)
    compared = 0
    for _ in range(300):
        nodes = _random_nodes(draw)
        theirs = nn.FeedForwardNetwork(list(range(-26, 0)), [100], _as_theirs(nodes, activations.get, aggregations.get))
        ours = Network(range(-26, 0), [100], nodes)
        for _ in range(10):
            values = [draw.gauss(0.0, 1.0) for _ in range(26)]
            try:
                (wanted,) = theirs.activate(values)
            except OverflowError:
                with pytest.raises(NotFinite):
                    ours.activate(values)
                continue
            (got,) = ours.activate(values)
            exact = sys.version_info < (3, 12)  # from there on their sum() compensates rounding
            assert got == wanted if exact else got == pytest.approx(wanted, rel=1e-9)
            compared += 1
    assert compared > 2500


def _random_nodes(draw: random.Random) -> list[Node]:
    nodes: list[Node] = []
    known = list(range(-26, 0))
    for key in [*range(1, draw.randint(1, 9)), 100]:
        links = tuple((source, draw.gauss(0.0, 1.5)) for source in draw.sample(known, draw.randint(0, 6)))
        kinds = draw.choice(sorted(ACTIVATIONS)), draw.choice(sorted(AGGREGATIONS))
        nodes.append(Node(key, *kinds, draw.gauss(0.0, 1.0), draw.gauss(1.0, 0.3), links))
        known.append(key)
    return nodes


def _as_theirs(nodes: list[Node], activation: Callable[[str], Any], aggregation: Callable[[str], Any]) -> list[Any]:
    return [
        (n.key, activation(n.activation), aggregation(n.aggregation), n.bias, n.response, list(n.links)) for n in nodes
    ]
