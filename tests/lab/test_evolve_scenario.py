"""Collision and fitness for many stems, and compiled: the very same as flora_common.geometry gives for one."""

from __future__ import annotations

import numba
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from flora_common import geometry
from flora_common.arrays import Array
from flora_common.shapes import Obstacle, Target
from flora_lab.evolve import scenario_batch
from flora_lab.evolve.scenario_batch import arrays_of, collide, collides_lane, fitness_lane
from flora_lab.evolve.task import LEFT, MIDDLE

# Few values beside many: edges that meet exactly, upright and level segments and points that coincide are common.
PLACES = st.one_of(st.sampled_from([0.0, -3.5, 3.5, 7.3, 8.8, 10.3, 1e-12]), st.floats(-25.0, 25.0))
STEMS = hnp.arrays(np.float64, (10, 2), elements=PLACES)
SIZES = st.one_of(st.sampled_from([7.0, 3.0]), st.floats(0.01, 20.0))
OBSTACLES = st.builds(Obstacle, PLACES, PLACES, SIZES, SIZES)


def edges_of(obstacle: Obstacle) -> tuple[float, float, float, float]:
    return obstacle.left_cm, obstacle.bottom_cm, obstacle.right_cm, obstacle.top_cm


@settings(max_examples=400, deadline=None)
@given(st.lists(st.tuples(STEMS, OBSTACLES), min_size=1, max_size=6))
def test_collisions_are_those_of_one_stem_alone(drawn: list[tuple[Array, Obstacle]]) -> None:
    with np.errstate(over="ignore"):
        wanted = [geometry.collides(stem, obstacle) for stem, obstacle in drawn]

    stems, edges = np.stack([stem for stem, _ in drawn]), np.array([edges_of(obstacle) for _, obstacle in drawn])

    assert collide(stems, edges).tolist() == wanted
    assert [collides_lane(stem, *edges_of(obstacle)) for stem, obstacle in drawn] == wanted


def test_grown_stems_touch_or_pass_as_one_by_one() -> None:
    """Smooth stems around the paper's obstacles: about half of them touch."""
    rng = np.random.default_rng(1)
    bend = np.cumsum(rng.normal(scale=0.25, size=(3000, 10)), axis=1)
    stems = np.cumsum(np.stack([np.sin(bend), np.cos(bend)], axis=-1) * rng.uniform(0.7, 2.3, (3000, 1, 1)), axis=1)
    stems -= stems[:, :1]
    obstacles = [scenario.obstacle for task in (LEFT, MIDDLE) for scenario in task.scenarios]
    edges = np.concatenate([arrays_of(LEFT).edges, arrays_of(MIDDLE).edges])
    which = np.arange(3000) % len(obstacles)

    found = collide(stems, edges[which])

    assert found.tolist() == [geometry.collides(s, obstacles[k]) for s, k in zip(stems, which, strict=True)]
    assert found.tolist() == [collides_lane(s, *edges[k]) for s, k in zip(stems, which, strict=True)]
    assert 0.2 < found.mean() < 0.8
    order = rng.permutation(3000)
    assert collide(stems[order], edges[which[order]]).tolist() == found[order].tolist()


def test_a_stem_that_touches_an_edge_or_a_corner_collides() -> None:
    edges = np.array([[-3.5, 7.3, 3.5, 10.3]] * 4)
    upright = np.linspace(0.0, 1.0, 10)[:, None] * np.array([0.0, 20.0])
    level = np.stack([np.linspace(-20.0, 20.0, 10), np.full(10, 10.3)], axis=1)
    stems = np.stack([upright, upright, level, level])
    stems += np.array([(-3.5, 0.0), (3.5 + 1e-9, 0.0), (0.0, 0.0), (0.0, 1e-9)])[:, None]

    assert collide(stems, edges).tolist() == [True, False, True, False]
    assert [collides_lane(s, *edges[0]) for s in stems] == [True, False, True, False]


def test_a_single_common_point_is_enough() -> None:
    obstacle = Obstacle(0.0, 9.0, 8.0, 4.0)  # corners at whole numbers, so that nothing is rounded
    along = np.linspace(0.0, 1.0, 3)[:, None]
    past_the_corner = np.array([-5.0, 10.0]) + along * np.array([2.0, 2.0])  # through (-4, 11)
    up_to_the_edge = along * np.array([0.0, 7.0])
    for stem in (past_the_corner, up_to_the_edge):
        assert geometry.collides(stem, obstacle)
        assert collide(stem[None], np.array([edges_of(obstacle)])).all()
        assert collides_lane(stem, *edges_of(obstacle))


@given(hnp.arrays(np.float64, (5, 2), elements=PLACES), PLACES, st.floats(0.5, 25.0))
def test_fitness_is_the_papers_to_the_last_bit(tips: Array, x_cm: float, y_cm: float) -> None:
    wanted = [Target(x_cm, y_cm).fitness(x, y) for x, y in tips.tolist()]

    assert scenario_batch.fitness(tips, np.array([x_cm, y_cm])).tolist() == wanted
    assert [fitness_lane(x, y, x_cm, y_cm) for x, y in tips] == wanted


def test_fitness_by_hand() -> None:
    # left: 5.12 + 17.9 = 23.02; at the anchor nothing is gained, 1 cm beside the centre costs 1 / 23.02
    targets = arrays_of(LEFT).targets
    tips = np.array([[-5.12, 17.9], [-4.12, 17.9], [0.0, 0.0], [5.12, 0.0]])

    assert np.abs(scenario_batch.fitness(tips, targets) - [1.0, 22.02 / 23.02, 0.0, -5.12 / 23.02]).max() < 1e-12


def test_both_can_be_used_in_a_compiled_loop() -> None:
    @numba.njit(error_model="numpy")
    def judged(stems: Array, edges: Array, target_x_cm: float, target_y_cm: float) -> tuple[int, float]:
        hits, total = 0, 0.0
        for k in range(stems.shape[0]):
            hits += collides_lane(stems[k], edges[0], edges[1], edges[2], edges[3])
            total += fitness_lane(stems[k, 9, 0], stems[k, 9, 1], target_x_cm, target_y_cm)
        return hits, total

    height = np.array([6.5, 7.29, 7.31, 17.9])
    stems = np.linspace(0.0, 1.0, 10)[None, :, None] * np.stack([np.zeros(4), height], axis=1)[:, None]

    hits, total = judged(stems, arrays_of(LEFT).edges[2], 0.0, 17.9)

    assert hits == 2
    assert abs(total - height.sum() / 17.9) < 1e-12
