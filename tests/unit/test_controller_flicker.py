"""How often the quickest sensible controller switches, which is what flickering must be told from."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from flora_common.controller_file import load_controller
from flora_common.shapes import Obstacle, Target
from flora_controller.evolved import Evolved
from flora_controller.shadow import MOST_SWITCHES_PER_H
from flora_controller.steering import View
from flora_twin.grow import stem_points_cm
from flora_twin.plant import Plants
from signing_keys import TIP_ONLY

TICKS_PER_H = 12


def most_switches_in_an_hour(target: Target, *, noise_cm: float, plants: int, hours: int) -> int:
    """Of virtual plants whose lamp is always the one on the target's side of the tip."""
    rule = Evolved(load_controller(TIP_ONLY), target, Obstacle(-6.3, 12.5), "tip-only")
    seeds = range(300, 300 + plants)
    grown, draw = Plants(seeds), np.random.default_rng(1)
    went_left: NDArray[np.float64] = np.zeros((plants, hours * TICKS_PER_H))
    for tick in range(hours * TICKS_PER_H):
        for i, line in enumerate(grown.centreline_cm()):
            seen = stem_points_cm(line[: grown.segments[i] + 1]) + noise_cm * draw.standard_normal((10, 2))
            went_left[i, tick] = rule.decide(View(tick * 300.0, seen, None), {}).light == "left"
        left = went_left[:, tick].tolist()
        for _ in range(3):
            grown.step(left, [1.0 - lit for lit in left])
    switches = np.abs(np.diff(went_left, axis=1))
    within_an_hour = np.cumsum(np.pad(switches, ((0, 0), (TICKS_PER_H, 0))), axis=1)
    return int((within_an_hour[:, TICKS_PER_H:] - within_an_hour[:, :-TICKS_PER_H]).max())


def test_a_network_that_follows_the_tip_is_not_taken_for_one_that_flickers() -> None:
    assert 0 < most_switches_in_an_hour(Target(0.0, 17.9), noise_cm=0.06, plants=2, hours=24) <= MOST_SWITCHES_PER_H


@pytest.mark.slow
@pytest.mark.parametrize(("noise_cm", "expected"), [(0.0, 5), (0.06, 7), (0.15, 9)])
def test_the_figures_of_the_readme(noise_cm: float, expected: int) -> None:
    """Twelve plants, 72 hours, the paper's two targets."""
    targets = Target(0.0, 17.9), Target(-5.12, 17.9)
    found = max(most_switches_in_an_hour(target, noise_cm=noise_cm, plants=12, hours=72) for target in targets)
    print(f"\n{noise_cm * 10:g} mm of noise: at most {found} switches in any hour")
    assert found == expected <= MOST_SWITCHES_PER_H
