"""The plain way to evaluate controllers: neat-python's network, the simulator's step, one episode after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from neat.nn import FeedForwardNetwork

from flora_common import geometry
from flora_common.controller_file import LEFT_AT_MOST
from flora_lab.evolve.controllers import SCALE_CM
from flora_lab.evolve.episode import REASONS, run_episode
from flora_lab.evolve.task import Scenario, Task
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.paper import CELLS, COORDINATES, INPUTS, PaperSimulator
from lab.evolve_reference import asked_as_neat_does, controller_of


@dataclass(frozen=True, slots=True)
class Episode:
    """What came of an episode.

    Attributes:
        is_right: which lamp shone, one per step.
        reason: place in ``REASONS``.
        fitness: at the end.
        doubts: how far C was from 0.5, one per step.
    """

    is_right: tuple[bool, ...]
    reason: int
    fitness: float
    doubts: tuple[float, ...]


Plain = Callable[[Any, Scenario], Episode]
"""A genome in a scenario."""


def plain_way(simulator: Simulator[Any], task: Task, config: Any) -> Plain:
    """As a user of neat-python and torch would write it; networks are built for each episode."""
    if isinstance(simulator, PaperSimulator):
        return _with_torch(simulator, task, config)

    def run(genome: Any, scenario: Scenario) -> Episode:
        controller = asked_as_neat_does(controller_of(FeedForwardNetwork.create(genome, config), task))
        course = run_episode(controller, simulator, task, scenario)
        doubts = tuple(abs(float(said) - LEFT_AT_MOST) for said in course.outputs)
        return Episode(tuple(map(bool, course.is_right)), REASONS.index(course.reason), course.fitness, doubts)

    return run


def _with_torch(simulator: PaperSimulator, task: Task, config: Any) -> Plain:
    cell, dense = simulator.network.cell, simulator.network.dense
    lstm, head = torch.nn.LSTM(INPUTS, CELLS), torch.nn.Linear(CELLS, COORDINATES)
    lstm.load_state_dict(
        {
            "weight_ih_l0": torch.from_numpy(cell.w_ih),
            "weight_hh_l0": torch.from_numpy(cell.w_hh),
            "bias_ih_l0": torch.from_numpy(cell.b),
            "bias_hh_l0": torch.zeros(4 * CELLS),
        }
    )
    head.load_state_dict({"weight": torch.from_numpy(dense.w), "bias": torch.from_numpy(dense.b)})
    start = torch.from_numpy(simulator.start(task.start_stem_cm[None]).points)

    def run(genome: Any, scenario: Scenario) -> Episode:
        network = FeedForwardNetwork.create(genome, config)
        target, o = scenario.target, scenario.obstacle
        told = [v / SCALE_CM for v in (target.x_cm, target.y_cm, o.left_cm, o.bottom_cm, o.right_cm, o.top_cm)]
        points, memory = start, None
        lamps: list[bool] = []
        doubts: list[float] = []
        stem = np.zeros((10, 2))
        with torch.inference_mode():
            while True:
                stem[1:] = points.numpy().reshape(9, 2)
                stem[1:] *= simulator.unit_cm
                x, y = stem[-1].tolist()
                if geometry.collides(stem, o):
                    reason = "collision"
                elif y >= task.stop_height_cm:
                    reason = "height"
                elif len(lamps) >= task.most_steps:
                    reason = "time"
                else:
                    (said,) = network.activate([*(stem / SCALE_CM).ravel().tolist(), *told])
                    lamps.append(said > LEFT_AT_MOST)
                    doubts.append(abs(said - LEFT_AT_MOST))
                    inputs = torch.cat([points, torch.tensor([[float(lamps[-1])]])], dim=1)
                    hidden, after = lstm(inputs, memory)
                    memory = after if simulator.stateful else None
                    points = head(hidden)
                    continue
                return Episode(tuple(lamps), REASONS.index(reason), target.fitness(x, y), tuple(doubts))

    return run
