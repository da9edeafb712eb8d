"""Whole episodes of many controllers in one compiled loop, in which no plant is simulated twice.

A plant does not care which network switched its lamps. All controllers start with the same plant, so that as long as
two of them have switched alike, in whatever scenario, they look at one and the same plant: it is simulated once. Where
the controllers of one plant disagree it becomes two. Results are those of every episode simulated alone, to the bit.

It holds for a plant that is determined by its light: the typical plant, or one that was drawn together with all that
happens to it by chance.

Plants in use stand in the first rows, so that their arithmetic can go over them side by side; the last one moves to the
row of a plant that nobody looks at any more. There are never more plants than episodes that go on.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from flora_common.arrays import Array
from flora_common.shapes import STEM_POINTS
from flora_lab.evolve.episode import NO_ANSWER
from flora_lab.evolve.genome_activate import Networks
from flora_lab.evolve.genome_decide import NO_DECISION, decide
from flora_lab.evolve.plant_looks import GOES_ON, STEM, Looks, Scenarios, look
from flora_lab.evolve.plants import Plants
from flora_lab.evolve.scenario_batch import fitness_lane
from flora_lab.simulator.rod import jit

_NONE: Final = -1


class Episodes(NamedTuple):
    """What comes of the episodes of one plant; see :class:`flora_lab.evolve.episode.Outcomes`.

    Attributes:
        fitness, reason, steps: shape (networks, scenarios); fitness is that of the tip, whatever ended the run.
        tip_cm, is_right: with another axis.
    """

    fitness: Array
    reason: Array
    steps: Array
    tip_cm: Array
    is_right: Array


class _Views(NamedTuple):
    """Who looks at which plant.

    Attributes:
        going: networks of which an episode goes on; only the first so many count.
        plant: row of each episode's plant, or none where it has ended; shape (networks, scenarios).
        decision: of each, see :func:`flora_lab.evolve.genome_decide.decide`.
        moved: by row before the last step: the row now.
        is_watched: by row: in which scenarios an episode goes on there; shape (rows, scenarios).
        is_looked_at, is_right: by row: whether one goes on at all, and which lamp it switches on.
        sibling: by row: the row of those who switched on the other lamp, or none.
        source, target: rows that plants are copied from and to.
    """

    going: Array
    plant: Array
    decision: Array
    moved: Array
    is_watched: Array
    is_looked_at: Array
    is_right: Array
    sibling: Array
    source: Array
    target: Array


@jit
def run_shared(
    networks: Networks, scenarios: Scenarios, plants: Plants, episodes: Episodes, slots: Array, share: bool
) -> int:
    """Run every network in every scenario.

    Args:
        networks: with one output.
        scenarios: of a task.
        plants: in row 0 stands the start, the others are room: as many rows as there are episodes.
        episodes: written.
        slots: room for one network's values, shape (LANES, inputs and nodes).
        share: simulate equal plants once; without it every episode has its own.

    Returns:
        How many steps of plants were simulated.
    """
    going, most = len(episodes.fitness), episodes.is_right.shape[2]
    rows = episodes.fitness.size
    looks = _looks(rows, len(scenarios.edges_cm))
    views = _views(episodes, share)
    used = 1
    if not share:
        used = rows
        views.source[:] = 0
        plants.copy_rows(views.source, np.arange(1, rows + 1), rows - 1)
    simulated = 0
    for k in range(most + 1):
        plants.points(used, looks.points_cm)
        look(looks, used, views.is_watched, scenarios, k >= most)
        going = _end_episodes(scenarios, episodes, looks, views, going, k)
        if going == 0:
            break
        decide(networks, views.going, going, views.plant, looks.scaled, scenarios.told, slots, views.decision)
        total = _part_plants(scenarios, episodes, looks, views, going, used, k)
        plants.copy_rows(views.source, views.target, total - used)
        used = moves = 0
        for row in range(total):
            views.moved[row] = row
        while used < total:
            if not views.is_looked_at[used]:
                total -= 1
                while total > used and not views.is_looked_at[total]:
                    total -= 1
                if total == used:
                    break
                views.source[moves], views.target[moves] = total, used
                moves += 1
                views.is_right[used], views.is_watched[used] = views.is_right[total], views.is_watched[total]
                views.moved[total] = used
            used += 1
        plants.copy_rows(views.source, views.target, moves)
        plants.advance(used, views.is_right, k)
        simulated += used
    return simulated


@jit
def _looks(rows: int, scenarios: int) -> Looks:
    points, scaled = np.empty((rows, STEM_POINTS, 2)), np.empty((rows, STEM))
    return Looks(points, scaled, np.empty((rows, scenarios), dtype=np.int8))


@jit
def _views(episodes: Episodes, share: bool) -> _Views:
    """At the start all look at one plant, or each at its own."""
    networks, scenarios = episodes.fitness.shape
    rows = networks * scenarios
    plant = np.zeros((networks, scenarios), dtype=np.int64)
    if not share:
        plant[:] = np.arange(rows).reshape(networks, scenarios)
    decision = np.zeros((networks, scenarios), dtype=np.int8)
    is_watched = np.zeros((rows, scenarios), dtype=np.bool_)
    for g in range(networks):
        for s in range(scenarios):
            is_watched[plant[g, s], s] = True
    is_looked_at, is_right = np.empty(rows, dtype=np.bool_), np.empty(rows, dtype=np.bool_)
    sibling, source, target = (
        np.empty(rows, dtype=np.int64),
        np.empty(rows, dtype=np.int64),
        np.empty(rows, dtype=np.int64),
    )
    going, moved = np.arange(networks), np.arange(rows)
    return _Views(going, plant, decision, moved, is_watched, is_looked_at, is_right, sibling, source, target)


@jit
def _end_episodes(scenarios: Scenarios, episodes: Episodes, looks: Looks, views: _Views, going: int, k: int) -> int:
    """End the episodes that end before step k; returns of how many networks one goes on."""
    plant, kept = views.plant, 0
    for i in range(going):
        g, goes_on = views.going[i], False
        for s in range(plant.shape[1]):
            if plant[g, s] == _NONE:
                continue
            row = views.moved[plant[g, s]]
            plant[g, s] = row
            if looks.ends[row, s] == GOES_ON:
                goes_on = True
            else:
                _end(episodes, scenarios, looks, g, s, row, looks.ends[row, s], k)
                plant[g, s] = _NONE
        if goes_on:
            views.going[kept] = g
            kept += 1
    return kept


@jit
def _part_plants(
    scenarios: Scenarios, episodes: Episodes, looks: Looks, views: _Views, going: int, used: int, k: int
) -> int:
    """Give those a plant of their own who decided otherwise than the first who looked at theirs.

    Returns:
        Rows of plants, siblings included.
    """
    plant, decision, total = views.plant, views.decision, used
    for row in range(used):
        views.is_looked_at[row], views.sibling[row] = False, _NONE
        for s in range(plant.shape[1]):
            views.is_watched[row, s] = False
    for i in range(going):
        g = views.going[i]
        for s in range(plant.shape[1]):
            row = plant[g, s]
            if row == _NONE:
                continue
            if decision[g, s] == NO_DECISION:
                _end(episodes, scenarios, looks, g, s, row, NO_ANSWER, k)
                plant[g, s] = _NONE
                continue
            is_right = decision[g, s] == 1
            episodes.is_right[g, s, k] = is_right
            if not views.is_looked_at[row]:
                views.is_looked_at[row], views.is_right[row] = True, is_right
            elif views.is_right[row] != is_right:
                if views.sibling[row] == _NONE:
                    views.sibling[row] = total
                    views.source[total - used], views.target[total - used] = row, total
                    views.is_looked_at[total], views.is_right[total] = True, is_right
                    for other in range(plant.shape[1]):
                        views.is_watched[total, other] = False
                    total += 1
                row = plant[g, s] = views.sibling[row]
            views.is_watched[row, s] = True
    return total


@jit
def _end(
    episodes: Episodes, scenarios: Scenarios, looks: Looks, g: int, s: int, row: int, why: int, steps: int
) -> None:
    x, y = looks.points_cm[row, -1, 0], looks.points_cm[row, -1, 1]
    episodes.fitness[g, s] = fitness_lane(x, y, scenarios.targets_cm[s, 0], scenarios.targets_cm[s, 1])
    episodes.reason[g, s], episodes.steps[g, s] = why, steps
    episodes.tip_cm[g, s, 0], episodes.tip_cm[g, s, 1] = x, y
