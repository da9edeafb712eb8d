"""Where a network's nodes are drawn: inputs to the left in groups, hidden ones by depth, the output to the right."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from flora_common.controller_file import OBSTACLE_NAMES, POINT_NAMES, TARGET_NAMES, LoadedController
from flora_common.network import Node

MOST_HIDDEN: Final = 40
"""As many hidden nodes are drawn; of more, those with the greatest weights."""
GROUPS: Final[tuple[tuple[str, tuple[str, ...]], ...]] = (
    ("stem, x", POINT_NAMES[0::2]),
    ("stem, y", POINT_NAMES[1::2]),
    ("target", TARGET_NAMES),
    ("obstacle", OBSTACLE_NAMES),
)
GAP: Final = 1.0
"""Between two groups, as a share of the distance between two inputs."""


@dataclass(frozen=True, slots=True)
class Group:
    """Inputs that are drawn under each other.

    Attributes:
        name: of all.
        inputs: (name, number of the node), the first on top.
    """

    name: str
    inputs: tuple[tuple[str, int], ...]


@dataclass(frozen=True, slots=True)
class Layout:
    """Where everything is.

    Attributes:
        groups: of inputs, from top to bottom.
        at: number of a node to (x, y); x is 0 for inputs and 1 for the output, y from 0 (bottom) to 1 (top).
        hidden: numbers of the hidden nodes that are drawn.
        left_out: how many hidden nodes are not.
        links: (from, to, weight) between nodes that are drawn.
    """

    groups: tuple[Group, ...]
    at: dict[int, tuple[float, float]]
    hidden: tuple[int, ...]
    left_out: int
    links: tuple[tuple[int, int, float], ...]

    @property
    def read(self) -> frozenset[int]:
        """Nodes that a link that is drawn comes from."""
        return frozenset(source for source, _, _ in self.links)


def layout_of(loaded: LoadedController) -> Layout:
    """The layout of a controller's network; the same for the same file."""
    network = loaded.network
    number = dict(zip((entry.name for entry in loaded.file.inputs), network.inputs, strict=True))
    groups = tuple(
        Group(name, tuple((entry, number[entry]) for entry in names if entry in number))
        for name, names in GROUPS
        if any(entry in number for entry in names)
    )
    hidden = [node for node in network.nodes if node.key not in network.outputs]
    kept = _strongest(hidden, network.nodes)
    at = _input_places(groups)
    at |= _hidden_places(network.nodes, kept, at)
    at |= dict.fromkeys(network.outputs, (1.0, 0.5))
    links = tuple(
        (source, node.key, weight)
        for node in network.nodes
        if node.key in at
        for source, weight in node.links
        if source in at
    )
    return Layout(groups, at, tuple(node.key for node in hidden if node.key in kept), len(hidden) - len(kept), links)


def depths(nodes: tuple[Node, ...], inputs: tuple[int, ...]) -> dict[int, int]:
    """How many links lie between each node and the inputs on the longest way; 0 for inputs, at least 1 for others."""
    depth = dict.fromkeys(inputs, 0)
    for node in nodes:
        depth[node.key] = 1 + max((depth[source] for source, _ in node.links), default=0)
    return depth


def _strongest(hidden: list[Node], nodes: tuple[Node, ...]) -> set[int]:
    """The hidden nodes that are drawn: those with the greatest sum of the sizes of their weights, in and out."""
    size = dict.fromkeys((node.key for node in hidden), 0.0)
    for node in nodes:
        for source, weight in node.links:
            for key in (source, node.key):
                if key in size:
                    size[key] += abs(weight)
    return set(sorted(size, key=lambda key: (-size[key], key))[:MOST_HIDDEN])


def _input_places(groups: tuple[Group, ...]) -> dict[int, tuple[float, float]]:
    places: dict[int, float] = {}
    down = 0.0
    for group in groups:
        for _, key in group.inputs:
            places[key] = down
            down += 1.0
        down += GAP
    lowest = max(places.values(), default=0.0) or 1.0
    return {key: (0.0, 1.0 - place / lowest) for key, place in places.items()}


def _hidden_places(
    nodes: tuple[Node, ...], kept: set[int], inputs: dict[int, tuple[float, float]]
) -> dict[int, tuple[float, float]]:
    """Columns by depth; within one in the order of the middle of what they read, which lets few links cross."""
    depth = depths(nodes, tuple(inputs))
    columns = sorted({depth[key] for key in kept})
    links = {node.key: node.links for node in nodes}
    at = dict(inputs)
    for place, column in enumerate(columns, start=1):
        inside = [node.key for node in nodes if node.key in kept and depth[node.key] == column]
        inside.sort(key=lambda key: (-_middle(links[key], at), key))
        x = place / (len(columns) + 1)
        # every other column is moved by half a step, so that links do not run through the nodes between
        shift = 0.25 if place % 2 else -0.25
        for row, key in enumerate(inside):
            at[key] = (x, 1.0 - (row + 0.5 + shift) / len(inside) if len(inside) > 1 else 0.5 + 0.3 * shift)
    return {key: place for key, place in at.items() if key in kept}


def _middle(links: tuple[tuple[int, float], ...], at: dict[int, tuple[float, float]]) -> float:
    """The mean height of the nodes that a node reads, each by the size of its weight."""
    known = [(at[source][1], abs(weight)) for source, weight in links if source in at]
    total = sum(weight for _, weight in known)
    return sum(y * weight for y, weight in known) / total if total else 0.5
