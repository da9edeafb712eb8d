"""The geometry of :mod:`flora_common.geometry` for many episodes at once, and inside of compiled loops.

Every function does the same operations in the same order as its counterpart there, so that results are equal to the
last bit, and do not depend on what else is computed with them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flora_common.arrays import Array, FloatArray
from flora_lab.evolve.task import Task
from flora_lab.simulator.rod import jit


@dataclass(frozen=True, slots=True)
class ScenarioArrays:
    """The scenarios of a task as numbers, cm.

    Attributes:
        edges: of the obstacles: left, bottom, right, top; shape (scenarios, 4).
        targets: centres x, y; shape (scenarios, 2).
    """

    edges: FloatArray
    targets: FloatArray


def arrays_of(task: Task) -> ScenarioArrays:
    """A task's scenarios in their order."""
    obstacles = [scenario.obstacle for scenario in task.scenarios]
    edges = np.array([(o.left_cm, o.bottom_cm, o.right_cm, o.top_cm) for o in obstacles])
    return ScenarioArrays(edges, np.array([(s.target.x_cm, s.target.y_cm) for s in task.scenarios]))


def collide(points_cm: FloatArray, edges_cm: FloatArray) -> Array:
    """Which stems touch their obstacle; see :func:`flora_common.geometry.collides`.

    Args:
        points_cm: shape (batch, n, 2), n >= 2.
        edges_cm: left, bottom, right, top; shape (batch, 4).

    Returns:
        Shape (batch,), bool.
    """
    start, step = points_cm[:, :-1], np.diff(points_cm, axis=1)
    low, high = edges_cm[:, None, :2], edges_cm[:, None, 2:]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        t_a = (low - start) / step
        t_b = (high - start) / step
    parallel = step == 0.0
    outside = parallel & ((start < low) | (start > high))
    t_enter = np.where(parallel, -np.inf, np.minimum(t_a, t_b)).max(axis=2)
    t_leave = np.where(parallel, np.inf, np.maximum(t_a, t_b)).min(axis=2)
    hit = (np.maximum(t_enter, 0.0) <= np.minimum(t_leave, 1.0)) & ~outside.any(axis=2)
    return np.asarray(hit.any(axis=1))


def fitness(tips_cm: FloatArray, targets_cm: FloatArray) -> FloatArray:
    """The paper's F; see :func:`flora_common.shapes.Target.fitness`.

    Args:
        tips_cm, targets_cm: shapes (..., 2) that broadcast.

    Returns:
        Shape (...).
    """
    best = np.abs(targets_cm[..., 0]) + np.abs(targets_cm[..., 1])
    missed_x, missed_y = np.moveaxis(np.abs(targets_cm - tips_cm), -1, 0)
    return np.asarray((best - missed_x - missed_y) / best)


@jit
def collides_lane(points_cm: Array, left_cm: float, bottom_cm: float, right_cm: float, top_cm: float) -> bool:
    """Whether one stem, shape (n, 2), touches the rectangle. Points must be finite."""
    for j in range(points_cm.shape[0] - 1):
        enter, leave = 0.0, 1.0
        outside = False
        for axis in range(2):
            low, high = (left_cm, right_cm) if axis == 0 else (bottom_cm, top_cm)
            start = points_cm[j, axis]
            step = points_cm[j + 1, axis] - start
            if step == 0.0:
                outside = outside or start < low or start > high
            else:
                t_a, t_b = (low - start) / step, (high - start) / step
                enter, leave = max(enter, min(t_a, t_b)), min(leave, max(t_a, t_b))
        if enter <= leave and not outside:
            return True
    return False


@jit
def fitness_lane(tip_x_cm: float, tip_y_cm: float, target_x_cm: float, target_y_cm: float) -> float:
    """The paper's F of one tip; the target does not lie on the anchor."""
    best = abs(target_x_cm) + abs(target_y_cm)
    return (best - abs(target_x_cm - tip_x_cm) - abs(target_y_cm - tip_y_cm)) / best
