"""Whole episodes of many controllers in one compiled loop, in which no plant is simulated twice.

A plant does not care which network switched its lamps. All controllers start with the same plant, so that as long as
two of them have switched alike, in whatever scenario, they look at one and the same plant: it is simulated once. Where
the controllers of one plant disagree it becomes two. Results are those of every episode simulated alone, to the bit.

It holds for a plant that is determined by its light: the typical plant, or one that was drawn, without drives.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from flora_common.network import MAX_NUMBER
from flora_lab.evolve.episode import COLLISION, HEIGHT, NO_ANSWER, NO_ANSWER_FITNESS, REASONS, TIME
from flora_lab.evolve.genome_activate import fill_slots
from flora_lab.evolve.scenario_batch import collides_lane, fitness_lane
from flora_lab.simulator import neural_law, tropism
from flora_lab.simulator.rod import LONGEST_STEP_H, jit, points_lane

Array = npt.NDArray[Any]

NOT_FINITE: Final = len(REASONS)
"""The simulator has left the numbers; whoever calls this says so."""
_RUNNING: Final = -1

_learned_step = neural_law.step_lane
_tropism_step = tropism.step_lane


@jit
def _answer(
    g: int,
    stem: Array,
    told: Array,
    node_start: Array,
    bias: Array,
    response: Array,
    activation: Array,
    aggregation: Array,
    edge_start: Array,
    source: Array,
    weight: Array,
    output: Array,
    slots: Array,
) -> float:
    """What network g says of a stem and a scenario, both scaled; NaN where it has no answer.

    See :mod:`flora_lab.evolve.genome_activate`.
    """
    width, first = len(stem), len(stem) + len(told)
    slots[:width], slots[width:first] = stem, told
    is_sound = fill_slots(
        g, first, node_start, bias, response, activation, aggregation, edge_start, source, weight, slots
    )
    return float(slots[output[g, 0]]) if is_sound else np.nan


@jit
def run_shared(
    node_start: Array,
    bias: Array,
    response: Array,
    activation: Array,
    aggregation: Array,
    edge_start: Array,
    source: Array,
    weight: Array,
    output: Array,
    offset: Array,
    scale: Array,
    slots: Array,
    edges_cm: Array,
    targets_cm: Array,
    stop_height_cm: float,
    left_at_most: float,
    share: bool,
    is_learned: bool,
    length: Array,
    angle: Array,
    count: Array,
    seen: Array,
    hidden: Array,
    traits: Array,
    constants: Array,
    lamps_cm: Array,
    w_ih: Array,
    w_hh: Array,
    b: Array,
    w_out: Array,
    b_out: Array,
    zone_cm: float,
    fitness: Array,
    reason: Array,
    steps: Array,
    tip_cm: Array,
    is_right: Array,
) -> int:
    """Run every network in every scenario.

    Args:
        node_start, ..., output: see :class:`flora_lab.evolve.genome_arrays.GenomeArrays`; one output.
        offset, scale: of the inputs, shape (26,).
        slots: room for one network's values.
        edges_cm, targets_cm: see :class:`flora_lab.evolve.scenario_batch.ScenarioArrays`.
        stop_height_cm, left_at_most: see :mod:`flora_lab.evolve.episode`.
        share: simulate equal plants once; without it every episode has its own.
        is_learned: which law: the learned one, or the mechanistic.
        length, angle, count, seen, hidden: plants, one row each; row 0 holds the start, the others are room; ``seen``
            and ``hidden`` are the memories of either law, that of the other one has no size.
        traits: of the plant under the learned law; ``constants`` under the mechanistic one.
        constants, lamps_cm, w_ih, w_hh, b, w_out, b_out, zone_cm: of the laws.
        fitness, reason, steps, tip_cm, is_right: written, shape (networks, scenarios, ...).

    Returns:
        How many steps of plants were simulated.
    """
    networks, scenarios = fitness.shape
    lanes = networks * scenarios
    most = is_right.shape[2]
    points = np.empty((length.shape[0], 10, 2))
    scaled = np.empty((length.shape[0], 20))
    is_sound = np.empty(length.shape[0], dtype=np.bool_)
    touches = np.empty((length.shape[0], scenarios), dtype=np.bool_)
    plant = np.zeros(lanes, dtype=np.int64)
    active = np.arange(lanes)
    told = np.empty((scenarios, 6))
    for s in range(scenarios):
        told[s, :2], told[s, 2:] = targets_cm[s], edges_cm[s]
        told[s] = (told[s] - offset[20:]) / scale[20:]
    free = np.arange(length.shape[0] - 1, -1, -1)  # a stack; row 0 is on top
    room = length.shape[0] - 1
    live = np.zeros(length.shape[0], dtype=np.int64)
    lives = 1
    if not share:
        room, lives = length.shape[0] - lanes, lanes
        for lane in range(lanes):
            plant[lane] = live[lane] = lane
            length[lane], angle[lane], count[lane] = length[0], angle[0], count[0]
            seen[lane], hidden[lane] = seen[0], hidden[0]
    side = np.empty(length.shape[0], dtype=np.int64)
    sibling = np.empty(length.shape[0], dtype=np.int64)
    simulated = 0
    for k in range(most + 1):
        for i in range(lives):
            u = live[i]
            points_lane(length[u], angle[u], count[u], points[u])
            side[u], sibling[u] = -1, -1
            is_sound[u] = True
            for j in range(20):
                scaled[u, j] = (points[u, j // 2, j % 2] - offset[j]) / scale[j]
                # written so that NaN fails it too
                is_sound[u] = is_sound[u] and abs(scaled[u, j]) <= MAX_NUMBER
            for s in range(scenarios):
                touches[u, s] = collides_lane(points[u], edges_cm[s, 0], edges_cm[s, 1], edges_cm[s, 2], edges_cm[s, 3])
        kept = 0
        for i in range(len(active)):
            lane = active[i]
            g, s, u = lane // scenarios, lane % scenarios, plant[lane]
            why = _RUNNING
            if not is_sound[u]:
                why = NOT_FINITE
            elif touches[u, s]:
                why = COLLISION
            elif points[u, -1, 1] >= stop_height_cm:
                why = HEIGHT
            elif k >= most:
                why = TIME
            else:
                said = _answer(
                    g,
                    scaled[u],
                    told[s],
                    node_start,
                    bias,
                    response,
                    activation,
                    aggregation,
                    edge_start,
                    source,
                    weight,
                    output,
                    slots,
                )
                if not np.isfinite(said):
                    why = NO_ANSWER
            if why != _RUNNING:
                x, y = points[u, -1, 0], points[u, -1, 1]
                worth = fitness_lane(x, y, targets_cm[s, 0], targets_cm[s, 1])
                fitness[g, s] = min(worth, NO_ANSWER_FITNESS) if why == NO_ANSWER else worth
                reason[g, s], steps[g, s] = why, k
                tip_cm[g, s, 0], tip_cm[g, s, 1] = x, y
                continue
            right = 1 if said > left_at_most else 0
            is_right[g, s, k] = right == 1
            active[kept] = lane
            kept += 1
            if side[u] < 0:
                side[u] = right
            elif side[u] != right:
                if sibling[u] < 0:
                    v = free[room - 1]
                    room -= 1
                    length[v], angle[v], count[v] = length[u], angle[u], count[u]
                    seen[v], hidden[v] = seen[u], hidden[u]
                    side[v], sibling[v], sibling[u] = right, -1, v
                plant[lane] = sibling[u]
        active = active[:kept]
        if kept == 0:
            break
        # Plants that somebody still looks at; the others' rows are room again.
        before = lives
        kept_lives = np.empty(min(2 * before, length.shape[0]), dtype=np.int64)
        lives = 0
        for i in range(before):
            u = live[i]
            if side[u] >= 0:
                kept_lives[lives] = u
                lives += 1
                if sibling[u] >= 0:
                    kept_lives[lives] = sibling[u]
                    lives += 1
            else:
                free[room] = u
                room += 1
        live[:lives] = kept_lives[:lives]
        for i in range(lives):
            u = live[i]
            left, right_level = (0.0, 1.0) if side[u] == 1 else (1.0, 0.0)
            if is_learned:
                count[u] = _learned_step(
                    length[u],
                    angle[u],
                    count[u],
                    hidden[u],
                    traits,
                    w_ih,
                    w_hh,
                    b,
                    w_out,
                    b_out,
                    zone_cm,
                    left,
                    right_level,
                    0.0,
                    1.0,
                )
            else:
                count[u] = _tropism_step(
                    length[u],
                    angle[u],
                    count[u],
                    seen[u],
                    constants,
                    lamps_cm,
                    left,
                    right_level,
                    0.0,
                    1.0,
                    LONGEST_STEP_H,
                )
        simulated += lives
    return simulated
