"""neat-python's JSON export of a feed-forward network, checked and made ready to be asked.

Source of the format: neat-python 2.0.0, ``neat/export/`` and its ``docs/network-json-format.md``, format version 1.0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Final, Literal

import msgspec

from flora_common.errors import BadController
from flora_common.network import ACTIVATIONS, AGGREGATIONS, MAX_NUMBER, Network, Node
from flora_common.suggest import did_you_mean

MAX_NODES: Final = 10_000

Number = Annotated[float, msgspec.Meta(ge=-MAX_NUMBER, le=MAX_NUMBER)]
Key = Annotated[int, msgspec.Meta(ge=-(2**31), le=2**31)]


class Strict(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A part of a controller file: unknown keys are refused."""


class FunctionName(Strict, frozen=True):
    """A function by its name; ``custom`` ones exist only in the program that made the network."""

    name: Annotated[str, msgspec.Meta(max_length=50)]
    custom: bool = False


class NetworkNode(Strict, frozen=True):
    """A node as neat-python exports it."""

    id: Key
    type: Literal["input", "hidden", "output"]
    activation: FunctionName
    aggregation: FunctionName
    bias: Number
    response: Number


class NetworkLink(Strict, frozen=True):
    """A connection as neat-python exports it."""

    from_: Key = msgspec.field(name="from")
    to: Key
    weight: Number
    enabled: bool


class Topology(Strict, frozen=True):
    num_inputs: int
    num_outputs: int
    input_keys: list[Key]
    output_keys: list[Key]


class NetworkExport(Strict, frozen=True):
    """neat-python's JSON export (its ``docs/network-json-format.md``, format 1.0)."""

    format_version: Literal["1.0"]
    network_type: Literal["feedforward"]
    metadata: dict[str, Any]
    topology: Topology
    nodes: Annotated[list[NetworkNode], msgspec.Meta(max_length=MAX_NODES)]
    connections: Annotated[list[NetworkLink], msgspec.Meta(max_length=10 * MAX_NODES)]


def network_from(export: NetworkExport, where: str) -> Network:
    """The network of an export.

    Raises:
        BadController: unknown or custom functions, nodes or connections that do not fit each other, a cycle, a node
            that leads nowhere, another number of outputs than one. The message begins with ``where``.
    """
    topology = export.topology
    for name, count, keys in (
        ("num_inputs", topology.num_inputs, topology.input_keys),
        ("num_outputs", topology.num_outputs, topology.output_keys),
    ):
        if count != len(keys):
            raise BadController(f"{where}: network.topology.{name} is {count}, but {len(keys)} keys are listed")
    if len(topology.output_keys) != 1:
        raise BadController(f"{where}: the network has {len(topology.output_keys)} outputs; a controller has one")
    nodes: dict[int, NetworkNode] = {}
    for node in export.nodes:
        if node.id in nodes:
            raise BadController(f"{where}: network node {node.id} is there twice")
        nodes[node.id] = node
        if node.type != "input":
            _check_function(node.activation, ACTIVATIONS, f"{where}: network node {node.id}", "activation")
            _check_function(node.aggregation, AGGREGATIONS, f"{where}: network node {node.id}", "aggregation")
    _check_types(nodes, topology, where)
    links = _links(export, nodes, where)
    order = _evaluation_order(nodes, links, where)
    _check_all_used(nodes, links, topology.output_keys, where)
    try:
        return Network(
            topology.input_keys,
            topology.output_keys,
            [
                Node(n.id, n.activation.name, n.aggregation.name, n.bias, n.response, tuple(links[n.id]))
                for n in (nodes[key] for key in order)
            ],
        )
    except ValueError as problem:
        raise BadController(f"{where}: network: {problem}") from problem


def _check_function(function: FunctionName, known: Mapping[str, Callable[..., float]], where: str, kind: str) -> None:
    if function.custom:
        raise BadController(f"{where}: {kind} `{function.name}` is custom; only neat-python's own can be evaluated")
    if function.name not in known:
        raise BadController(f"{where}: unknown {kind} `{function.name}`{did_you_mean(function.name, known)}")


def _check_types(nodes: Mapping[int, NetworkNode], topology: Topology, where: str) -> None:
    for kind, keys in (("input", topology.input_keys), ("output", topology.output_keys)):
        if len(set(keys)) != len(keys):
            raise BadController(f"{where}: network.topology lists an {kind} twice")
        for key in keys:
            if key not in nodes or nodes[key].type != kind:
                raise BadController(f"{where}: network {kind} {key} has no node of type `{kind}`")
        for node in nodes.values():
            if node.type == kind and node.id not in keys:
                raise BadController(f"{where}: network node {node.id} is an {kind} that network.topology does not list")


def _links(export: NetworkExport, nodes: Mapping[int, NetworkNode], where: str) -> dict[int, list[tuple[int, float]]]:
    """Enabled connections into each node that is not an input, in the file's order, which is that of adding up."""
    links: dict[int, list[tuple[int, float]]] = {n.id: [] for n in nodes.values() if n.type != "input"}
    seen: set[tuple[int, int]] = set()
    for link in export.connections:
        name = f"{where}: network connection {link.from_} to {link.to}"
        if link.from_ not in nodes or link.to not in nodes:
            raise BadController(f"{name}: there is no node {link.to if link.from_ in nodes else link.from_}")
        if link.to not in links:
            raise BadController(f"{name}: leads into an input")
        if (link.from_, link.to) in seen:
            raise BadController(f"{name}: is there twice")
        seen.add((link.from_, link.to))
        if link.enabled:
            links[link.to].append((link.from_, link.weight))
    return links


def _evaluation_order(
    nodes: Mapping[int, NetworkNode], links: Mapping[int, list[tuple[int, float]]], where: str
) -> list[int]:
    """Every node after those that it reads (Kahn's algorithm)."""
    readers: dict[int, list[int]] = {key: [] for key in nodes}
    waiting = {key: len(into) for key, into in links.items()}
    for key, into in links.items():
        for source, _ in into:
            readers[source].append(key)
    ready = [key for key in nodes if waiting.get(key, 0) == 0]
    order: list[int] = []
    while ready:
        key = ready.pop()
        if key in links:
            order.append(key)
        for reader in readers[key]:
            waiting[reader] -= 1
            if waiting[reader] == 0:
                ready.append(reader)
    if len(order) < len(links):
        stuck = set(links).difference(order)
        raise BadController(
            f"{where}: network is not feed-forward: node {_in_cycle(stuck, links)} reads itself in the end"
        )
    return order


def _in_cycle(stuck: set[int], links: Mapping[int, list[tuple[int, float]]]) -> int:
    """The lowest node of a cycle, found by going upstream from any node that could not be put in order."""
    seen: list[int] = []
    key = min(stuck)
    while key not in seen:
        seen.append(key)
        key = next(source for source, _ in links[key] if source in stuck)
    return min(seen[seen.index(key) :])


def _check_all_used(
    nodes: Mapping[int, NetworkNode],
    links: Mapping[int, list[tuple[int, float]]],
    outputs: Sequence[int],
    where: str,
) -> None:
    used, todo = set(outputs), list(outputs)
    while todo:
        for source, _ in links.get(todo.pop(), ()):
            if source not in used:
                used.add(source)
                todo.append(source)
    for node in nodes.values():
        if node.type == "hidden" and node.id not in used:
            raise BadController(f"{where}: network node {node.id} leads to no output; leave it out")
