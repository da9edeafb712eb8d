"""Episodes: who decides what, when it ends, and what it is worth; on one plant and on several."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numba
import numpy as np
import pytest
from evolve_genomes import followers, random_networks
from evolve_reference import asked_as_neat_does, controller_of, run_episodes
from simulator_fakes import GROWTH_CM_H, LEAN_CM_H, Straight, StraightPlant

from flora_common import geometry
from flora_common.arrays import FloatArray
from flora_common.controller_file import OUTPUT_RULE
from flora_common.errors import BadInput
from flora_common.network import NotFinite
from flora_common.runs import LampsSection
from flora_common.shapes import Obstacle, Target
from flora_controller import evolved
from flora_controller.evolved import Evolved
from flora_controller.steering import View
from flora_lab.evolve.episode import LEFT_AT_MOST, REASONS, run_episode
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.task import LEFT, MIDDLE, Scenario, Task, averages, straight_stem
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.growing import DataRange
from flora_lab.simulator.individual import Prior
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.tropism_traits import prior_mean, prior_spread

SHORT = replace(LEFT, name="short", hours=10.0)
AWAY = Scenario("away", Target(-5.12, 17.9), Obstacle(30.0, 8.8))


@dataclass(frozen=True)
class Rule:
    """A controller that is any function of the stem."""

    of: Callable[[FloatArray], float]

    def output(self, points_cm: FloatArray, target: Target, obstacle: Obstacle) -> float:
        return self.of(points_cm)


ALWAYS_LEFT, ALWAYS_RIGHT = Rule(lambda stem: 0.0), Rule(lambda stem: 1.0)
UPRIGHT = Rule(lambda stem: float(stem[-1, 0] < 0.0))
"""Keeps the tip above the anchor."""


def fast(speed: float = 20.0) -> StraightPlant:
    """Tip 0.2 cm higher and 0.5 cm to the side every step."""
    return StraightPlant(speed=speed)


def rod() -> RodSimulator:
    return RodSimulator(LampsSection(), Prior(prior_mean(), prior_spread()), DriveNoise(), DataRange(20.0, 6.0))


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    yield
    numba.set_num_threads(before)


# One alone


def test_the_rule_is_the_rigs() -> None:
    assert f"at most {LEFT_AT_MOST:g} is left" == OUTPUT_RULE
    assert LEFT_AT_MOST == evolved.LEFT_AT_MOST


@pytest.mark.parametrize(("output", "side"), [(0.0, -1.0), (0.5, -1.0), (math.nextafter(0.5, 1.0), 1.0), (1.0, 1.0)])
def test_at_most_half_is_left(output: float, side: float) -> None:
    course = run_episode(Rule(lambda stem: output), StraightPlant(), SHORT, AWAY)

    assert course.reason == "time"
    assert course.steps == 120
    assert course.hours == 10.0
    assert course.is_right.tolist() == [side > 0.0] * 120
    assert np.abs(course.stems_cm[:, -1, 0] - side * LEAN_CM_H * np.arange(121) / 12.0).max() < 1e-9
    assert abs(course.stems_cm[-1, -1, 1] - (6.5 + 10.0 * GROWTH_CM_H)) < 1e-9


def test_it_ends_when_the_tip_is_high_enough() -> None:
    course = run_episode(UPRIGHT, fast(), LEFT, AWAY)

    assert course.reason == "height"
    assert course.stems_cm[-1, -1, 1] >= 21.0 > course.stems_cm[-2, -1, 1]
    assert course.steps == math.ceil((21.0 - 6.5) / (20.0 * GROWTH_CM_H / 12.0) - 1e-9)
    tip = course.stems_cm[-1, -1]
    assert course.fitness == AWAY.target.fitness(tip[0], tip[1])
    assert course.stems_cm.shape == (course.steps + 1, 10, 2)
    assert course.outputs.shape == course.is_right.shape == (course.steps,)


def test_it_ends_where_the_stem_touches_and_not_before() -> None:
    course = run_episode(UPRIGHT, fast(), MIDDLE, MIDDLE.scenarios[0])

    assert course.reason == "collision"
    obstacle = MIDDLE.scenarios[0].obstacle
    assert [geometry.collides(stem, obstacle) for stem in course.stems_cm] == [False] * course.steps + [True]
    assert course.clearance_cm == 0.0
    tip = course.stems_cm[-1, -1]
    assert 7.3 <= tip[1] < 7.6  # the obstacle's lower edge, and one step
    assert course.fitness == Target(0.0, 17.9).fitness(tip[0], tip[1])  # no penalty but the end itself


def test_a_collision_counts_before_the_height_and_that_before_the_time() -> None:
    above = Scenario("above", Target(0.0, 17.9), Obstacle(0.0, 22.4))  # from 20.9 cm, less than a step below the end
    steps = math.ceil((21.0 - 6.5) / 0.2 - 1e-9)
    for scenario, reason in ((above, "collision"), (AWAY, "height")):
        task = replace(LEFT, scenarios=(scenario,), hours=steps / 12.0)
        course = run_episode(UPRIGHT, fast(), task, scenario)
        assert (course.reason, course.steps, course.stems_cm[-1, -1, 1] >= 21.0) == (reason, steps, True)


def test_it_says_how_near_the_obstacle_the_stem_came() -> None:
    high = Scenario("high", Target(0.0, 17.0), Obstacle(10.0, 8.8))
    course = run_episode(UPRIGHT, fast(), MIDDLE, high)

    least = min(geometry.clearance_cm(stem, high.obstacle) for stem in course.stems_cm)
    assert course.clearance_cm == least > 5.0


def test_a_controller_is_told_stem_target_and_obstacle() -> None:
    told: list[tuple[FloatArray, Target, Obstacle]] = []

    class Listens:
        def output(self, points_cm: FloatArray, target: Target, obstacle: Obstacle) -> float:
            told.append((points_cm.copy(), target, obstacle))
            return float(len(told) % 2)

    course = run_episode(Listens(), StraightPlant(), SHORT, AWAY)

    assert {(target, obstacle) for _, target, obstacle in told} == {(AWAY.target, AWAY.obstacle)}
    assert np.array_equal([stem for stem, _, _ in told], course.stems_cm[:-1])
    assert course.is_right.tolist() == [True, False] * 60


def no_answer(stem: FloatArray) -> float:
    if stem[-1, 1] > 7.0:
        raise NotFinite("node 7 grows beyond all numbers")
    return 0.0


@pytest.mark.parametrize("of", [no_answer, lambda stem: math.nan if stem[-1, 1] > 7.0 else 0.0])
def test_without_an_answer_it_ends_and_is_worth_nothing(of: Callable[[FloatArray], float]) -> None:
    course = run_episode(Rule(of), fast(), LEFT, AWAY)

    assert course.reason == "no answer"
    assert course.stems_cm[-1, -1, 1] > 7.0 >= course.stems_cm[-2, -1, 1]
    assert course.fitness == 0.0
    lost = Scenario("lost", Target(3.0, 3.0), Obstacle(30.0, 8.8))
    assert run_episode(Rule(of), fast(), LEFT, lost).fitness < 0.0


class Breaks(StraightPlant):
    """Gives no number after its tip has passed 8 cm."""

    def stems_cm(self, state: Straight) -> FloatArray:
        stems = super().stems_cm(state)
        stems[state.tip_cm[:, 1] > 8.0, 3, 0] = np.nan
        return stems


def test_a_simulator_that_gives_no_numbers_is_told_in_one_line() -> None:
    task = Task("one", (AWAY,))
    with pytest.raises(BadInput) as told:
        run_episode(UPRIGHT, Breaks(), task, AWAY)
    assert str(told.value) == (
        "the simulator gives a stem that is not finite, task one, scenario away, after 12.6 h; "
        "train it again or take another one"
    )


def test_the_rig_would_have_switched_the_same_lamps() -> None:
    """The rig's own rule, on the stems that it would have seen."""
    switches = 0
    for network in (*random_networks(8, 11), *followers(8, 11)):
        loaded = controller_of(network, LEFT)
        for scenario in LEFT.scenarios:
            course = run_episode(asked_as_neat_does(loaded), fast(5.0), LEFT, scenario)
            rig = Evolved(loaded, scenario.target, scenario.obstacle, "rig")
            decisions = [rig.decide(View(0.0, stem, None), {}) for stem in course.stems_cm[:-1]]
            assert [d.light == "right" for d in decisions] == course.is_right.tolist()
            assert [d.output for d in decisions] == course.outputs.tolist()
            switches += int(np.count_nonzero(np.diff(course.is_right)))
    assert switches > 10


def test_a_start_that_is_over_at_once_takes_no_step() -> None:
    high = replace(LEFT, name="high", start_cm=straight_stem(20.999), stop_height_cm=20.99)
    course = run_episode(UPRIGHT, fast(), high, AWAY)

    assert (course.steps, course.reason) == (0, "height")


# Several plants


def test_more_plants_are_the_same_ones_and_some_more() -> None:
    few, many = Individuals(3, seed=5).seeds(), Individuals(50, seed=5).seeds()

    assert few is not None
    assert many is not None
    assert many[:3] == few
    assert len(set(many)) == 50
    assert min(many) >= 0
    assert max(many) < 2**63
    assert Individuals(3, seed=6).seeds() != few
    assert Individuals().seeds() is None


def test_fitness_over_plants_is_their_mean_or_that_of_the_worst() -> None:
    fitness = np.array([[[0.9, 0.5, 0.7]], [[0.2, 0.4, 0.6]]])

    assert np.abs(Individuals(3, judge="mean").judged(fitness) - [[0.7], [0.4]]).max() < 1e-12
    assert Individuals(3, judge="worst").judged(fitness).tolist() == [[0.5], [0.2]]


def test_plants_differ_and_every_controller_meets_the_same() -> None:
    plants = Individuals(4, seed=1)
    task = replace(LEFT, name="day", hours=24.0, scenarios=(replace(AWAY, name="a"), replace(AWAY, name="b")))

    told = run_episodes([UPRIGHT, UPRIGHT, ALWAYS_LEFT], rod(), task, plants.seeds())

    assert told.fitness[0].tobytes() == told.fitness[1].tobytes()
    assert told.fitness[:, 0].tobytes() == told.fitness[:, 1].tobytes()
    assert len(np.unique(told.fitness[0, 0])) == 4
    mean = averages(task, plants.judged(told.fitness)).of_all
    worst = averages(task, replace(plants, judge="worst").judged(told.fitness)).of_all
    assert (worst < mean).all()
    typical = run_episodes([UPRIGHT], rod(), task)
    assert np.abs(typical.fitness[0, 0] - mean[0]).max() < 0.2


@pytest.mark.parametrize(("count", "seed"), [(-1, 1), (3, -1)])
def test_fewer_than_no_plants_are_refused(count: int, seed: int) -> None:
    with pytest.raises(BadInput, match="both must be 0 or above"):
        Individuals(count, seed)


def test_a_collision_is_worth_no_more_than_the_task_says() -> None:
    bound = replace(LEFT, collision_at_most=0.1)
    as_in_paper, less = (run_episodes([ALWAYS_LEFT, UPRIGHT], fast(), task) for task in (LEFT, bound))
    touched = as_in_paper.reason == REASONS.index("collision")
    assert touched.any()
    assert not touched.all()
    assert np.array_equal(less.fitness, np.where(touched, np.minimum(as_in_paper.fitness, 0.1), as_in_paper.fitness))
    assert (less.fitness < as_in_paper.fitness).any()
    course = run_episode(ALWAYS_LEFT, fast(), bound, bound.scenarios[2])
    assert (course.reason, course.fitness) == ("collision", less.fitness[0, 2, 0])
