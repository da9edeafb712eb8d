"""A controller steers a simulated plant: the plain reference, step by step.

Wahby et al. 2018, section "Evolutionary approach": every five minutes the controller is asked; C <= 0.5 lights the left
lamp, otherwise the right; a run ends when the tip is about 21 cm high or the plant touches the obstacle, and fitness is
that of the tip at the end, whatever ended the run. Here a run also ends when its time is over.

A controller without an answer would be held and then overruled by the rig. Such an episode ends there, with no more
fitness than a plant that never grew.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from flora_common import geometry
from flora_common.arrays import Array, FloatArray
from flora_common.controller_file import LEFT_AT_MOST
from flora_common.errors import BadInput
from flora_common.network import NotFinite
from flora_common.runs import LEVELS, Light
from flora_common.shapes import Obstacle, Target
from flora_lab.evolve.controllers import Controller
from flora_lab.evolve.task import Scenario, Task
from flora_lab.simulator.interface import Chance, Simulator
from flora_lab.simulator.measured import STEP_S

Reason = Literal["collision", "height", "time", "no answer"]

NO_ANSWER_FITNESS: Final = 0.0
"""That of a tip at the anchor."""
REASONS: Final[tuple[Reason, ...]] = ("collision", "height", "time", "no answer")
"""In the order in which they count where several hold; :class:`Outcomes` gives their places."""
COLLISION, HEIGHT, TIME, NO_ANSWER = range(len(REASONS))
_SIDES: Final = np.array([LEVELS["left"], LEVELS["right"]])


@dataclass(frozen=True, slots=True)
class Course:
    """One episode from its start to its end.

    Attributes:
        scenario: that it was run in.
        stems_cm: shape (steps + 1, 10, 2); the first is the start, the last the end.
        outputs: of the controller, shape (steps,).
        is_right: which lamp shone from each stem to the next, shape (steps,), bool.
        reason: why it ended.
        fitness: at the end.
    """

    scenario: Scenario
    stems_cm: FloatArray
    outputs: FloatArray
    is_right: Array
    reason: Reason
    fitness: float

    @property
    def steps(self) -> int:
        """Of five minutes each."""
        return len(self.outputs)

    @property
    def lamps(self) -> list[Light]:
        """The lamp that shone before each stem; before the first one it was dark."""
        return ["dark", *("right" if right else "left" for right in self.is_right)]

    @property
    def hours(self) -> float:
        return self.steps * STEP_S / 3600.0

    @property
    def clearance_cm(self) -> float:
        """The least distance from stem to obstacle; 0 where they touched."""
        return min(geometry.clearance_cm(stem, self.scenario.obstacle) for stem in self.stems_cm)


@dataclass(frozen=True, slots=True)
class Outcomes:
    """Many episodes; all arrays of shape (controllers, scenarios, plants), ``is_right`` with another axis.

    Attributes:
        fitness: at the end.
        reason: place in :data:`REASONS`.
        steps: of five minutes each.
        tip_cm: at the end, with another axis of 2.
        is_right: which lamp shone in each step, shape (controllers, scenarios, plants, most steps), bool; False after
            the end.
    """

    fitness: FloatArray
    reason: Array
    steps: Array
    tip_cm: FloatArray
    is_right: Array


def run_episode(
    controller: Controller, simulator: Simulator[Any], task: Task, scenario: Scenario, seed: int | None = None
) -> Course:
    """One controller in one scenario, step by step.

    Args:
        controller: whom.
        simulator: of the plant.
        task: start and end.
        scenario: target and obstacle; need not be one of the task's.
        seed: of the plant that is drawn; the typical plant, to which nothing happens by chance, where None.

    Raises:
        BadInput: the simulator gives a stem that is not finite, or knows no steps of five minutes.
    """
    chance = None if seed is None else Chance(np.array([seed]))
    state = simulator.start(task.start_stem_cm[None], chance)
    stems = [simulator.stems_cm(state)[0]]
    outputs: list[float] = []
    while True:
        _check_finite(stems[-1], task, scenario, len(outputs))
        reason = _over(stems[-1], len(outputs), task, scenario.obstacle)
        if reason is not None:
            break
        output = _answer(controller, stems[-1], scenario)
        if output is None:
            reason = "no answer"
            break
        outputs.append(output)
        state, points = simulator.step(state, _SIDES[[int(output > LEFT_AT_MOST)]], STEP_S)
        stems.append(points[0])
    told = np.array(outputs)
    fitness = _fitness(stems[-1], scenario.target, task, reason)
    return Course(scenario, np.stack(stems), told, told > LEFT_AT_MOST, reason, fitness)


def _over(stem_cm: FloatArray, steps: int, task: Task, obstacle: Obstacle) -> Reason | None:
    if geometry.collides(stem_cm, obstacle):
        return "collision"
    if stem_cm[-1, 1] >= task.stop_height_cm:
        return "height"
    return "time" if steps >= task.most_steps else None


def _answer(controller: Controller, stem_cm: FloatArray, scenario: Scenario) -> float | None:
    """C, or None where it is no finite number."""
    try:
        output = controller.output(stem_cm, scenario.target, scenario.obstacle)
    except NotFinite:
        return None
    return output if np.isfinite(output) else None


def _fitness(stem_cm: FloatArray, target: Target, task: Task, reason: Reason) -> float:
    fitness = target.fitness(float(stem_cm[-1, 0]), float(stem_cm[-1, 1]))
    return float(scored(task, np.array(fitness), np.array(REASONS.index(reason))))


def scored(task: Task, fitness: FloatArray, reason: Array) -> FloatArray:
    """What runs are worth.

    Args:
        task: says what a collision may be worth.
        fitness: of the tips at the end, any shape.
        reason: place in :data:`REASONS`, the same shape.
    """
    most = np.full(len(REASONS), np.inf)
    most[NO_ANSWER] = NO_ANSWER_FITNESS
    if task.collision_at_most is not None:
        most[COLLISION] = task.collision_at_most
    return np.asarray(np.minimum(fitness, most[reason]))


def _check_finite(stems_cm: FloatArray, task: Task, scenario: Scenario, steps: int) -> None:
    if not np.isfinite(stems_cm).all():
        raise BadInput(
            f"the simulator gives a stem that is not finite, task {task.name}, scenario {scenario.name}, after "
            f"{steps * STEP_S / 3600.0:.1f} h; train it again or take another one"
        )
