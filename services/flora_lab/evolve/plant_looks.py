"""What there is to see of simulated plants: their stems as networks are told them, and which episodes end with them."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from flora_common.arrays import Array
from flora_common.network import MAX_NUMBER
from flora_common.shapes import STEM_POINTS
from flora_lab.evolve import scenario_batch
from flora_lab.evolve.controllers import INPUTS
from flora_lab.evolve.episode import COLLISION, HEIGHT, NO_ANSWER, REASONS, TIME
from flora_lab.evolve.scenario_batch import collides_lane
from flora_lab.evolve.task import Task
from flora_lab.simulator.rod import jit

NOT_FINITE: Final = len(REASONS)
"""The simulator has left the numbers; whoever runs episodes says so."""
GOES_ON: Final = -1
STEM: Final = 2 * STEM_POINTS
"""Numbers of a stem; the first that a network is told."""
TOLD: Final = len(INPUTS) - STEM
"""Those of target and obstacle; the last."""
_ASIDE_CM: Final = 1e-3
_FAR_CM: Final = 1e4
_PIECES: Final = STEM_POINTS - 1


class Scenarios(NamedTuple):
    """What controllers are told and judged by.

    Attributes:
        edges_cm, targets_cm: see :class:`flora_lab.evolve.scenario_batch.ScenarioArrays`.
        told: target and obstacle as networks are told them, shape (scenarios, 6).
        offset, scale: of the stem as networks are told it, shape (20,).
        stop_height_cm: ends an episode.
    """

    edges_cm: Array
    targets_cm: Array
    told: Array
    offset: Array
    scale: Array
    stop_height_cm: float


class Looks(NamedTuple):
    """Of each plant, one row.

    Attributes:
        points_cm: its stem, shape (rows, 10, 2).
        scaled: the same as networks are told it, shape (rows, 20).
        ends: why an episode ends with this plant in each scenario, or that it goes on; shape (rows, scenarios).
    """

    points_cm: Array
    scaled: Array
    ends: Array


def scenarios_of(task: Task) -> Scenarios:
    """Those of a task."""
    arrays = scenario_batch.arrays_of(task)
    offset = np.array([entry.offset for entry in INPUTS], dtype=np.float64)
    scale = np.array([entry.scale for entry in INPUTS], dtype=np.float64)
    told = (np.concatenate([arrays.targets, arrays.edges], axis=1) - offset[STEM:]) / scale[STEM:]
    return Scenarios(
        arrays.edges, arrays.targets, told, offset[:STEM].copy(), scale[:STEM].copy(), float(task.stop_height_cm)
    )


@jit
def look(looks: Looks, rows: int, is_watched: Array, scenarios: Scenarios, is_late: bool) -> None:
    """Fill in all but the points.

    An obstacle is touched where :func:`flora_lab.evolve.scenario_batch.collides_lane` says so. It is asked only for
    stems near the obstacle: a piece of which both ends lie to one side of it, a thousandth of a centimetre from it or
    more, does not touch it, nor does any rounding make it, where numbers are not too large.

    Args:
        looks: changed.
        rows: how many are in use.
        is_watched: in which scenarios an episode has this plant, shape (rows, scenarios); the others are left out.
        scenarios: of the task.
        is_late: the time is over.
    """
    points, scaled, ends = looks.points_cm, looks.scaled, looks.ends
    offset, scale, edges_cm = scenarios.offset, scenarios.scale, scenarios.edges_cm
    stems = points.reshape(-1, STEM)
    low_x, high_x, low_y, high_y = np.empty(_PIECES), np.empty(_PIECES), np.empty(_PIECES), np.empty(_PIECES)
    for u in range(rows):
        finite = small = near = 0
        for j in range(STEM):
            scaled[u, j] = (stems[u, j] - offset[j]) / scale[j]
        for j in range(STEM):
            finite += abs(stems[u, j]) < np.inf
            # written so that NaN fails it too
            small += abs(scaled[u, j]) <= MAX_NUMBER
            near += abs(stems[u, j]) < _FAR_CM
        for j in range(_PIECES):
            x0, y0, x1, y1 = stems[u, 2 * j], stems[u, 2 * j + 1], stems[u, 2 * j + 2], stems[u, 2 * j + 3]
            low_x[j], high_x[j] = min(x0, x1), max(x0, x1)
            low_y[j], high_y[j] = min(y0, y1), max(y0, y1)
        for s in range(len(edges_cm)):
            if not is_watched[u, s]:
                continue
            if finite < STEM:
                ends[u, s] = NOT_FINITE
                continue
            left, bottom, right, top = edges_cm[s, 0], edges_cm[s, 1], edges_cm[s, 2], edges_cm[s, 3]
            left_of, right_of, below, above = left - _ASIDE_CM, right + _ASIDE_CM, bottom - _ASIDE_CM, top + _ASIDE_CM
            touches = False
            for j in range(_PIECES):
                is_beside = high_x[j] < left_of or low_x[j] > right_of or high_y[j] < below or low_y[j] > above
                if not is_beside or near < STEM:
                    touches = collides_lane(points[u], left, bottom, right, top)
                    break
            why = GOES_ON
            if touches:
                why = COLLISION
            elif stems[u, STEM - 1] >= scenarios.stop_height_cm:
                why = HEIGHT
            elif is_late:
                why = TIME
            elif small < STEM:
                why = NO_ANSWER
            ends[u, s] = why
