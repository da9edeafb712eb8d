"""The plain reference of evolution: neat-python's own networks, asked one by one, and one episode after the other.

Tests and benches compare with it what evolution's compiled loops come to.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from neat.activations import ActivationFunctionSet
from neat.aggregations import AggregationFunctionSet
from neat.nn import FeedForwardNetwork

from flora_common.arrays import Array, FloatArray
from flora_common.controller_file import LoadedController, parse_controller
from flora_common.network import MAX_NUMBER, NotFinite
from flora_common.shapes import Obstacle, Target
from flora_lab.evolve.controllers import Controller, controller_bytes, export_of
from flora_lab.evolve.episode import REASONS, Outcomes, run_episode
from flora_lab.evolve.genome_activate import Networks, activation_value, aggregate, networks_of
from flora_lab.evolve.genome_arrays import GenomeArrays
from flora_lab.evolve.task import Task
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.rod import jit

OUTCOMES: Final = ("fitness", "reason", "steps", "tip_cm", "is_right")
"""The arrays of :class:`flora_lab.evolve.episode.Outcomes`."""
_ACTIVATIONS: Final = ActivationFunctionSet()
_AGGREGATIONS: Final = AggregationFunctionSet()


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


def run_episodes(
    controllers: Sequence[Controller], simulator: Simulator[Any], task: Task, seeds: Sequence[int] | None = None
) -> Outcomes:
    """Every controller in every scenario on every plant, each by :func:`flora_lab.evolve.episode.run_episode`.

    Args:
        controllers: whom.
        simulator: of the plant.
        task: scenarios, start and end.
        seeds: one for each plant that is drawn; the typical plant alone where None.

    Raises:
        BadInput: see :func:`flora_lab.evolve.episode.run_episode`.
    """
    plants = [None] if seeds is None else seeds
    shape = (len(controllers), len(task.scenarios), len(plants))
    out = Outcomes(
        np.empty(shape),
        np.empty(shape, dtype=np.int8),
        np.empty(shape, dtype=np.int64),
        np.empty((*shape, 2)),
        np.zeros((*shape, task.most_steps), dtype=np.bool_),
    )
    for at in np.ndindex(shape):
        who, where, plant = at
        course = run_episode(controllers[who], simulator, task, task.scenarios[where], plants[plant])
        out.fitness[at], out.reason[at], out.steps[at] = course.fitness, REASONS.index(course.reason), course.steps
        out.tip_cm[at] = course.stems_cm[-1, -1]
        out.is_right[(*at, slice(course.steps))] = course.is_right
    return out


def same(one: Outcomes, other: Outcomes) -> bool:
    """Equal to the last bit, where there is no number too."""
    return all(np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True) for name in OUTCOMES)


def activate(arrays: GenomeArrays, inputs: npt.ArrayLike) -> Array:
    """Ask every network.

    Args:
        arrays: G networks.
        inputs: shape (I,) for all, or (G, I), already scaled.

    Returns:
        Shape (G, number of outputs); NaN where a network has no answer: an input that is not finite or larger than
        ``MAX_NUMBER``, or a node whose sum or value is not finite.

    Raises:
        ValueError: another shape of inputs.
    """
    values = np.asarray(inputs, dtype=np.float64)
    if values.shape not in ((arrays.inputs,), (len(arrays), arrays.inputs)):
        raise ValueError(f"inputs of shape {values.shape} for {len(arrays)} networks of {arrays.inputs} inputs")
    values = np.ascontiguousarray(np.broadcast_to(values, (len(arrays), arrays.inputs)))
    return np.asarray(_activate_all(values, networks_of(arrays), np.empty(arrays.slots)))


@jit
def _activate_all(inputs: Array, networks: Networks, slots: Array) -> Array:
    output = networks.output
    answers = np.empty(output.shape)
    width = inputs.shape[1]
    for g in range(len(inputs)):
        is_sound = True
        for i in range(width):
            slots[i] = inputs[g, i]
            # written so that NaN fails it too
            is_sound = is_sound and abs(inputs[g, i]) <= MAX_NUMBER
        is_sound = is_sound and _fill_slots(g, width, networks, slots)
        for o in range(output.shape[1]):
            answers[g, o] = slots[output[g, o]] if is_sound else np.nan
    return answers


@jit
def _fill_slots(g: int, inputs: int, networks: Networks, slots: Array) -> bool:
    """Evaluate network g, whose inputs stand in the first slots; False as soon as a node is not finite."""
    first = networks.node_start[g]
    for n in range(first, networks.node_start[g + 1]):
        start, end = networks.edge_start[n], networks.edge_start[n + 1]
        gathered = aggregate(networks.aggregation[n], slots, networks.source, networks.weight, start, end)
        before = networks.bias[n] + networks.response[n] * gathered
        value = activation_value(networks.activation[n], before)
        if not (np.isfinite(before) and np.isfinite(value)):
            return False
        slots[inputs + n - first] = value
    return True
