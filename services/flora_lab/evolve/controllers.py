"""Evolved networks as controller files, and back: what was evolved and what the rig runs decide alike, to the bit.

A rig evaluates :class:`flora_common.network.Network`, which does the operations of neat-python's ``FeedForwardNetwork``
in the same order, on what :meth:`flora_common.controller_file.LoadedController.values` makes of stem and scenario.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, Protocol

import msgspec
from neat.export.json_format import FORMAT_VERSION, get_function_info

from flora_common import controller_file
from flora_common.arrays import FloatArray
from flora_common.controller_file import (
    INPUT_NAMES,
    OUTPUT_RULE,
    ControllerFile,
    InputScale,
    LoadedController,
)
from flora_common.network_export import FunctionName, NetworkExport, NetworkLink, NetworkNode, Topology
from flora_common.runs import ObstacleSection, TargetSection
from flora_common.shapes import Obstacle, Target
from flora_common.stem_range import StemRange
from flora_lab.evolve.task import Task

SCALE_CM: Final = 25.0
"""What all inputs are divided by: a stem at its full height gives about 0.8, and weights of order one can act on it."""
INPUTS: Final = tuple(InputScale(name, 0.0, SCALE_CM) for name in INPUT_NAMES)
"""How evolved networks are fed: the paper's 26 numbers in its order."""

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
