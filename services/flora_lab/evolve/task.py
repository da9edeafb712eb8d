"""What a controller is evolved for: targets, obstacles, the stem that a run starts from, and when it ends.

The built-in tasks are those of Wahby et al. 2018: ``left`` and ``middle`` of its section "Task: Obstacle avoidance by
shaping the plant", and ``reality``, which its controllers met with real plants and were not evolved for. ``round`` is
flora's own, for controllers that are. The paper averages fitness over all scenarios of a task, also over the one of
which it says that the plant cannot reach the target there; ``is_possible`` marks it, so that the average can be told
without it too.

In the paper there is no penalty for touching the obstacle: the run ends there, far from the target. Not always far:
controllers find out that a stem may touch it from above when its tip has come to the target. A task can say that such
a run is worth less.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.paper_experiment import REALITY_OBSTACLE, REALITY_TARGET, RUN_HOURS, STOP_HEIGHT_CM
from flora_common.shapes import STEM_POINTS, Obstacle, Target
from flora_lab.simulator.measured import STEP_S

START_CM: Final = 6.5
"""Height of the stem that runs start from, where nothing else is said: below all of the paper's obstacles."""
Stem = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Scenario:
    """One target and one obstacle.

    Attributes:
        name: unique in its task.
        target, obstacle: what the controller is told.
        is_possible: False where no plant can reach the target; such a scenario counts in the average all the same.
    """

    name: str
    target: Target
    obstacle: Obstacle
    is_possible: bool = True


def straight_stem(height_cm: float = START_CM, tip_x_cm: float = 0.0) -> Stem:
    """A straight stem from the anchor to its tip, ten points at even heights."""
    share = np.linspace(0.0, 1.0, STEM_POINTS)
    return tuple(zip((share * tip_x_cm).tolist(), (share * height_cm).tolist(), strict=True))


STRAIGHT_STEM: Final = straight_stem()


@dataclass(frozen=True, slots=True)
class Task:
    """Scenarios, their common start and their common end.

    Attributes:
        name: of the task.
        scenarios: one or more.
        start_cm: the stem at the start, ten points (x, y) in cm, anchor first.
        stop_height_cm: a run ends when the tip is as high.
        hours: a run ends after this time at the latest.
        collision_at_most: a run that ended at the obstacle is worth this at most; None: as much as its tip, as in the
            paper.
    """

    name: str
    scenarios: tuple[Scenario, ...]
    start_cm: Stem = STRAIGHT_STEM
    stop_height_cm: float = STOP_HEIGHT_CM
    hours: float = RUN_HOURS
    collision_at_most: float | None = None

    @property
    def most_steps(self) -> int:
        """Decisions in a run that ends by time: one every five minutes."""
        return round(self.hours * 3600.0 / STEP_S)

    @property
    def start_stem_cm(self) -> FloatArray:
        """The stem at the start, shape (10, 2)."""
        return np.array(self.start_cm)

    @property
    def is_possible(self) -> FloatArray:
        """Which scenarios are, shape (scenarios,), bool."""
        return np.array([scenario.is_possible for scenario in self.scenarios])


LEFT_TARGET: Final = REALITY_TARGET
MIDDLE_TARGET: Final = Target(0.0, 17.9)

LEFT: Final = Task(
    "left",
    (
        Scenario("first", LEFT_TARGET, Obstacle(-8.24, 8.8)),
        Scenario("second", LEFT_TARGET, Obstacle(-5.57, 8.8)),
        Scenario("third", LEFT_TARGET, Obstacle(-2.90, 8.8), is_possible=False),
        Scenario("fourth", LEFT_TARGET, Obstacle(2.43, 8.8)),
    ),
)
MIDDLE: Final = Task(
    "middle",
    (
        Scenario("right", MIDDLE_TARGET, Obstacle(3.0, 8.8)),
        Scenario("left", MIDDLE_TARGET, Obstacle(-3.0, 8.8)),
    ),
)
REALITY: Final = Task("reality", (Scenario("reality", REALITY_TARGET, REALITY_OBSTACLE),))
_ROOM_CM: Final = (1.0, 1.0)
"""By which the obstacles of ``round`` are wider and higher than that of the real plants: half of it on each side."""


def _larger(obstacle: Obstacle, right_cm: float, up_cm: float) -> Obstacle:
    return Obstacle(
        obstacle.x_cm + right_cm,
        obstacle.y_cm + up_cm,
        obstacle.width_cm + _ROOM_CM[0],
        obstacle.height_cm + _ROOM_CM[1],
    )


ROUND: Final = Task(
    "round",
    (
        Scenario("reality", REALITY_TARGET, _larger(REALITY_OBSTACLE, 0.0, 0.0)),
        Scenario("nearer", REALITY_TARGET, _larger(REALITY_OBSTACLE, 0.5, -0.5)),
        Scenario("farther", REALITY_TARGET, _larger(REALITY_OBSTACLE, -0.5, 0.5)),
    ),
    stop_height_cm=18.5,
    hours=96.0,
    collision_at_most=0.3,
)
"""For controllers that are to steer real plants past the obstacle of ``reality``: with room to spare, no gain from
touching it, time for slow plants, and an end at the target's height."""
BUILT_IN: Final[Mapping[str, Task]] = {task.name: task for task in (LEFT, MIDDLE, REALITY, ROUND)}


@dataclass(frozen=True, slots=True)
class Averages:
    """Fitness over the scenarios of a task.

    Attributes:
        of_all: over all scenarios, as the paper averages.
        of_possible: without those that no plant can do.
    """

    of_all: FloatArray
    of_possible: FloatArray


def averages(task: Task, fitness: FloatArray) -> Averages:
    """Means over the last axis of ``fitness``, shape (..., scenarios); one number for each of the others."""
    return Averages(fitness.mean(axis=-1), fitness[..., task.is_possible].mean(axis=-1))
