"""Evolved networks as controller files, and back: what was evolved and what the rig runs decide alike, to the bit.

A rig evaluates :class:`flora_common.network.Network`; evolution may ask neat-python's ``FeedForwardNetwork``. Both do
the same operations in the same order. What either is fed is made by the one
:meth:`flora_common.controller_file.LoadedController.values` that the rig uses.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, Protocol

import msgspec
from neat.activations import ActivationFunctionSet
from neat.aggregations import AggregationFunctionSet
from neat.export.json_format import FORMAT_VERSION, get_function_info
from neat.nn import FeedForwardNetwork

from flora_common import controller_file
from flora_common.controller_file import (
    INPUT_NAMES,
    OUTPUT_RULE,
    ControllerFile,
    InputScale,
    LoadedController,
    parse_controller,
)
from flora_common.geometry import FloatArray
from flora_common.network import NotFinite
from flora_common.network_export import FunctionName, NetworkExport, NetworkLink, NetworkNode, Topology
from flora_common.runs import ObstacleSection, TargetSection
from flora_common.shapes import Obstacle, Target
from flora_common.stem_range import StemRange
from flora_lab.evolve.task import Task

SCALE_CM: Final = 25.0
"""What all inputs are divided by: a stem at its full height gives about 0.8, and weights of order one can act on it."""
INPUTS: Final = tuple(InputScale(name, 0.0, SCALE_CM) for name in INPUT_NAMES)
"""How evolved networks are fed: the paper's 26 numbers in its order."""

_ACTIVATIONS: Final = ActivationFunctionSet()
_AGGREGATIONS: Final = AggregationFunctionSet()
_INPUT_ACTIVATION: Final = FunctionName("identity")
_INPUT_AGGREGATION: Final = FunctionName("none")


class Controller(Protocol):
    """Anything that steers an episode."""

    def output(self, points_cm: FloatArray, target: Target, obstacle: Obstacle) -> float:
        """The paper's C; at most 0.5 is left.

        Args:
            points_cm: shape (10, 2).
            target, obstacle: of the scenario.

        Raises:
            NotFinite: no answer.
        """


@dataclass(frozen=True, slots=True)
class FromFile:
    """A controller file, asked as the rig asks it."""

    loaded: LoadedController

    def output(self, points_cm: FloatArray, target: Target, obstacle: Obstacle) -> float:
        (output,) = self.loaded.network.activate(self.loaded.values(points_cm.tolist(), target, obstacle))
        return output


@dataclass(frozen=True, slots=True)
class Fed:
    """Any function of the scaled inputs, fed as a controller file says.

    Attributes:
        feed: whose inputs, order and scale; its network is not asked.
        network: from the scaled inputs, 26 where ``feed`` names all, to C.
    """

    feed: LoadedController
    network: Callable[[Sequence[float]], float]

    def output(self, points_cm: FloatArray, target: Target, obstacle: Obstacle) -> float:
        return self.network(self.feed.values(points_cm.tolist(), target, obstacle))


def export_of(network: Any) -> NetworkExport:
    """neat-python's JSON export of its ``FeedForwardNetwork``, without the time of day that it adds.

    Source: ``neat/export/exporters.py`` of neat-python 2.0.0; nodes and links in the order in which it evaluates them.
    """
    nodes, links = [], []
    for key, activation, aggregation, bias, response, into in network.node_evals:
        kind: Literal["output", "hidden"] = "output" if key in network.output_nodes else "hidden"
        act = FunctionName(**get_function_info(activation, "activation"))
        gather = FunctionName(**get_function_info(aggregation, "aggregation"))
        nodes.append(NetworkNode(key, kind, act, gather, bias, response))
        links += [NetworkLink(source, key, weight, enabled=True) for source, weight in into]
    for key in network.input_nodes:
        nodes.append(NetworkNode(key, "input", _INPUT_ACTIVATION, _INPUT_AGGREGATION, 0.0, 1.0))
    inputs, outputs = list(network.input_nodes), list(network.output_nodes)
    topology = Topology(len(inputs), len(outputs), inputs, outputs)
    return NetworkExport(FORMAT_VERSION, "feedforward", {}, topology, nodes, links)


def neat_network(loaded: LoadedController) -> Any:
    """neat-python's ``FeedForwardNetwork`` of a controller file, nodes and links in the file's evaluation order."""
    evals = [
        (
            node.key,
            _ACTIVATIONS.get(node.activation),
            _AGGREGATIONS.get(node.aggregation),
            node.bias,
            node.response,
            list(node.links),
        )
        for node in loaded.network.nodes
    ]
    return FeedForwardNetwork(list(loaded.network.inputs), list(loaded.network.outputs), evals)


def asked_as_neat_does(loaded: LoadedController) -> Fed:
    """A controller whose network neat-python evaluates, with all that it makes of a value that is not finite."""
    network = neat_network(loaded)

    def ask(values: Sequence[float]) -> float:
        try:
            (output,) = network.activate(values)
        except OverflowError as problem:
            raise NotFinite("a node grows beyond all numbers") from problem
        return float(output)

    return Fed(loaded, ask)


def task_of(task: Task) -> controller_file.Task:
    """What a controller file says of a task: the target that all scenarios have in common, and all obstacles once."""
    targets = {(s.target.x_cm, s.target.y_cm, s.target.radius_cm) for s in task.scenarios}
    obstacles = dict.fromkeys(
        ObstacleSection(o.x_cm, o.y_cm, o.width_cm, o.height_cm) for o in (s.obstacle for s in task.scenarios)
    )
    target = TargetSection(*targets.pop()) if len(targets) == 1 else None
    return controller_file.Task(task.name, target, tuple(obstacles))


def controller_bytes(
    name: str,
    network: NetworkExport,
    task: Task,
    provenance: Mapping[str, str | int | float | bool],
    *,
    serial: int = 0,
    stem_range: StemRange | None = None,
) -> bytes:
    """A controller file, not signed. The same arguments give the same bytes.

    Args:
        name: of the controller.
        network: of 26 inputs, in the order of :data:`INPUTS`, and one output.
        task: that it was evolved for.
        provenance: where it is from.
        serial: grows from file to file of one signing key; signing sets it anew.
        stem_range: of the stems that it was evolved with; where it is None a rig goes on with any stem.
    """
    file = ControllerFile(
        format="flora-controller",
        version=1,
        name=name,
        network=network,
        inputs=list(INPUTS),
        output_rule=OUTPUT_RULE,
        task=task_of(task),
        provenance=dict(provenance),
        stem_range=stem_range,
        serial=serial,
    )
    return (json.dumps(msgspec.to_builtins(file), indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def controller_of(
    network: Any, task: Task, *, name: str = "evolved", provenance: Mapping[str, str | int | float | bool] | None = None
) -> LoadedController:
    """neat-python's ``FeedForwardNetwork`` as a controller file that has passed all of the rig's checks.

    Args:
        network: of 26 inputs and one output.
        task, name, provenance: see :func:`controller_bytes`.

    Raises:
        BadController: a network that the rig would refuse.
    """
    data = controller_bytes(name, export_of(network), task, provenance or {})
    return parse_controller(data, where=name)
