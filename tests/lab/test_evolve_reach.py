"""The range of stems that an evolution's controllers bear: as far as the simulated plants can be led at all."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from evolve_genomes import random_networks
from evolve_reference import controller_of
from evolve_simulators import learned, mechanistic, paper
from simulator_fakes import GROWTH_CM_H, LEAN_CM_H, Straight, StraightPlant

from flora_common.arrays import FloatArray
from flora_common.errors import BadInput
from flora_lab.evolve.controllers import FromFile
from flora_lab.evolve.episode import run_episode
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.reach import check_stems, reach
from flora_lab.evolve.task import LEFT, Task
from flora_lab.simulator.interface import Simulator

HOURS = 30.0
TASK = replace(LEFT, hours=HOURS)


class Torn(StraightPlant):
    """Its stems are no numbers when the tip is farther to the left than 5 cm."""

    def stems_cm(self, state: Straight) -> FloatArray:
        stems = super().stems_cm(state)
        stems[state.tip_cm[:, 0] < -5.0] = np.nan
        return stems


def test_it_is_what_the_plant_does_under_either_lamp_alone_and_both_in_turn() -> None:
    met = reach(StraightPlant(), TASK, Individuals())

    aside, top = LEAN_CM_H * HOURS, 6.5 + GROWTH_CM_H * HOURS
    assert (met.left_cm, met.right_cm) == pytest.approx((-aside, aside), abs=0.011)
    assert (met.lowest_tip_cm, met.highest_tip_cm) == pytest.approx((6.5, top), abs=0.011)
    assert (met.shortest_cm, met.longest_cm) == pytest.approx((6.5, np.hypot(aside, top)), abs=0.011)


def test_plants_that_are_as_high_as_the_task_asks_go_no_farther() -> None:
    met = reach(StraightPlant(), replace(TASK, stop_height_cm=8.0), Individuals())

    hours = (8.0 - 6.5) / GROWTH_CM_H
    assert met.highest_tip_cm == pytest.approx(8.0, abs=0.03)
    assert met.right_cm == pytest.approx(LEAN_CM_H * hours, abs=0.06)


def test_stems_that_are_no_numbers_are_not_told_of() -> None:
    met = reach(Torn(), TASK, Individuals())

    assert met.left_cm == pytest.approx(-5.0, abs=0.05)
    assert met.right_cm == pytest.approx(LEAN_CM_H * HOURS, abs=0.011)


class Bulging(StraightPlant):
    """The middle of its stems is 26 m away when the tip is farther to the right than 5 cm; the tip is at its place."""

    def stems_cm(self, state: Straight) -> FloatArray:
        stems = super().stems_cm(state)
        stems[state.tip_cm[:, 0] > 5.0, 5, 0] = 2600.0
        return stems


def test_a_simulator_whose_stems_are_no_plants_is_refused_before_anything_is_evolved() -> None:
    check_stems(StraightPlant(), TASK)
    hours = 5.0 / LEAN_CM_H
    with pytest.raises(
        BadInput, match=r"a stem that is not finite, task left, after \d+\.\d h; train it again"
    ) as torn:
        check_stems(Torn(), TASK)
    with pytest.raises(BadInput, match=r"a stem that reaches 2\.6e\+03 cm, task left, after") as bulging:
        check_stems(Bulging(), TASK)
    for refused in (torn, bulging):
        told = float(str(refused.value).split("after ")[1].split(" h")[0])
        assert told == pytest.approx(hours, abs=0.2)
    check_stems(Bulging(), replace(TASK, hours=0.9 * hours))


@pytest.mark.parametrize("plants", [0, 5])
@pytest.mark.parametrize("make", [mechanistic, learned])
def test_whatever_a_controller_does_with_these_plants_is_in_it(make: Any, plants: int) -> None:
    simulator: Simulator[Any] = make()
    task = Task("short", TASK.scenarios[2:], TASK.start_cm, hours=12.0)
    individuals = Individuals(plants)

    met = reach(simulator, task, individuals)

    farthest_cm = 0.0
    for network in random_networks(6, 3):
        controller = FromFile(controller_of(network, task))
        for scenario in task.scenarios:
            for seed in individuals.seeds() or [None]:
                course = run_episode(controller, simulator, task, scenario, seed)
                farthest_cm = max(farthest_cm, *(met.beyond(stem)[0] for stem in course.stems_cm))
    assert farthest_cm < 0.3


def test_more_drawn_plants_reach_farther() -> None:
    typical, five, many = (reach(mechanistic(), TASK, Individuals(count)) for count in (0, 5, 20))

    assert many.left_cm <= five.left_cm < typical.left_cm
    assert many.right_cm >= five.right_cm > typical.right_cm


def test_the_papers_simulator_has_no_individuals_and_a_reach() -> None:
    met = reach(paper(), TASK, Individuals())

    assert met.is_ordered
    assert met.left_cm < 0.0 < met.right_cm
