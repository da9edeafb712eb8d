"""When a run was over and what it came to, by the rules of Wahby et al. 2018, for measured and simulated plants alike.

A run is over when the stem touches the obstacle or the tip is about 21 cm high (section "Evolutionary approach");
whatever comes after does not count. Its evolved controllers are judged by the fitness of the tip at the end. Of its
real plants the paper tells the fitness "when the plant tip reaches the target area" (section "Performance of
controllers in reality"), because a stiffened stem hits no single point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common import geometry
from flora_common.arrays import FloatArray
from flora_common.experiment_file import Ended
from flora_common.paper_experiment import STOP_HEIGHT_CM
from flora_common.shapes import Obstacle, Target

_SAME_TIME_S: Final = 1.0
"""Tables tell times in milliseconds, and a tick may be late by a little."""


@dataclass(frozen=True, slots=True)
class Judged:
    """What a run came to; None where there is no target or no obstacle.

    Attributes:
        stop_row: stem at which the run was over.
        ended: why.
        fitness_over_time: the paper's F of the tip, shape (stems,).
        fitness_at_stop: F at ``stop_row``.
        best_fitness: the largest F up to ``stop_row``.
        fitness_at_target: F when the tip first lay in the target's circle.
        reached_h: hour of that.
        collided_h: hour at which the stem touched the obstacle.
        clearance_cm: the least distance of stem and obstacle.
    """

    stop_row: int
    ended: Ended
    fitness_over_time: FloatArray | None
    fitness_at_stop: float | None
    best_fitness: float | None
    fitness_at_target: float | None
    reached_h: float | None
    collided_h: float | None
    clearance_cm: float | None


def judge(
    time_s: FloatArray,
    points_cm: FloatArray,
    target: Target | None,
    obstacle: Obstacle | None,
    *,
    stop_height_cm: float = STOP_HEIGHT_CM,
    hours: float = math.inf,
) -> Judged:
    """Judge a run.

    Args:
        time_s: of each stem, shape (stems,), one or more.
        points_cm: shape (stems, 10, 2).
        target, obstacle: of the run.
        stop_height_cm: height of the tip at which it is over.
        hours: time at which it is over; a rig may have gone on for a tick.
    """
    in_time = max(1, int((time_s <= hours * 3600.0 + _SAME_TIME_S).sum()))
    stop_row, ended = _stop(points_cm[:in_time], obstacle, stop_height_cm)
    tips, at_h = points_cm[:, -1], time_s / 3600.0
    over_time = best = at_target = at_stop = reached_h = None
    if target is not None:
        over_time = np.array([target.fitness(x, y) for x, y in tips.tolist()])
        at_stop, best = float(over_time[stop_row]), float(over_time[: stop_row + 1].max())
        inside = [target.contains(x, y) for x, y in tips[: stop_row + 1].tolist()]
        if True in inside:
            row = inside.index(True)
            at_target, reached_h = float(over_time[row]), float(at_h[row])
    clearance_cm = None
    if obstacle is not None:
        clearance_cm = min(geometry.clearance_cm(points, obstacle) for points in points_cm[: stop_row + 1])
    return Judged(
        stop_row=stop_row,
        ended=ended,
        fitness_over_time=over_time,
        fitness_at_stop=at_stop,
        best_fitness=best,
        fitness_at_target=at_target,
        reached_h=reached_h,
        collided_h=float(at_h[stop_row]) if ended == "collision" else None,
        clearance_cm=clearance_cm,
    )


def percent(fitness: float) -> str:
    """A fitness as people read it."""
    return f"{100.0 * fitness:.1f} %"


def reason(ended: Ended, stop_height_cm: float = STOP_HEIGHT_CM) -> str:
    """Why a run was over, as the end of a sentence."""
    words: dict[Ended, str] = {
        "collision": "the stem touched the obstacle",
        "height": f"the tip was {stop_height_cm:g} cm high",
        "time": "the run ended",
    }
    return words[ended]


def _stop(points_cm: FloatArray, obstacle: Obstacle | None, stop_height_cm: float) -> tuple[int, Ended]:
    """The first stem at which the run is over; the obstacle counts first where both hold."""
    for row, points in enumerate(points_cm):
        if obstacle is not None and geometry.collides(points, obstacle):
            return row, "collision"
        if points[-1, 1] >= stop_height_cm:
            return row, "height"
    return len(points_cm) - 1, "time"
