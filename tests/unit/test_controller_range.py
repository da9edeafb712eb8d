"""How far virtual plants go beyond what a simulator's plants could reach, which is what leaving must be told from."""

from __future__ import annotations

from typing import Final

import numpy as np
import pytest

from flora_common.open_loop import PAPERS_TURNS
from flora_common.paper_experiment import STOP_HEIGHT_CM
from flora_common.shapes import Obstacle, Target
from flora_common.stem_range import StemRange
from flora_controller.shadow import MOST_TICKS_OUTSIDE, RANGE_MARGIN_CM
from flora_controller.steering import (
    Memory,
    OpenLoop,
    Steering,
    TipFollower,
    TipFollowerSection,
    View,
    Waypoint,
    WaypointSection,
)
from flora_twin.grow import stem_points_cm
from flora_twin.plant import Plants

TICKS_PER_H = 12
NOISE_CM: Final = 0.06
LEFT: Final = StemRange(
    left_cm=-11.02, right_cm=11.02, lowest_tip_cm=6.4, highest_tip_cm=20.94, shortest_cm=6.5, longest_cm=22.85
)
"""Reach of the typical plant of a mechanistic simulator of the paper's nine dataset runs, in task ``left``."""
ROUND: Final = StemRange(
    left_cm=-10.0, right_cm=10.0, lowest_tip_cm=6.4, highest_tip_cm=18.61, shortest_cm=6.5, longest_cm=21.17
)
"""The same in task ``round``, whose runs end at 18.5 cm."""
TARGET, OBSTACLE = Target(-5.12, 17.9), Obstacle(-6.3, 12.5)
RULES: Final[dict[str, Steering]] = {
    "lamps in turn": OpenLoop(PAPERS_TURNS),
    "tip-follower": TipFollower(TARGET, TipFollowerSection()),
    "waypoint": Waypoint(TARGET, OBSTACLE, WaypointSection()),
}


def farthest_cm(rule: Steering, ranges: list[StemRange], *, plants: int, hours: int) -> list[float]:
    """By how much any plant was outside of each range for as many stems in a row as give a controller up."""
    grown, draw = Plants(range(300, 300 + plants)), np.random.default_rng(1)
    memories: list[Memory] = [{} for _ in range(plants)]
    lights = [OpenLoop(PAPERS_TURNS).decide(View(0.0, None, None), {}).light] * plants
    beyond_cm = np.zeros((len(ranges), plants, hours * TICKS_PER_H))
    for tick in range(hours * TICKS_PER_H):
        for i, line in enumerate(grown.centreline_cm()):
            seen = stem_points_cm(line[: grown.segments[i] + 1]) + NOISE_CM * draw.standard_normal((10, 2))
            decision = rule.decide(View(tick * 300.0, seen, lights[i]), memories[i])
            lights[i], memories[i] = decision.light, decision.memory
            if seen[-1, 1] < STOP_HEIGHT_CM:
                beyond_cm[:, i, tick] = [met.beyond(seen)[0] for met in ranges]
        left = [float(light == "left") for light in lights]
        for _ in range(3):
            grown.step(left, [1.0 - lit for lit in left])
    in_a_row = np.lib.stride_tricks.sliding_window_view(beyond_cm, MOST_TICKS_OUTSIDE + 1, axis=2).min(axis=3)
    return [float(most) for most in in_a_row.max(axis=(1, 2))]


def test_a_plant_that_grows_as_usual_does_not_leave_the_range() -> None:
    (most_cm,) = farthest_cm(RULES["tip-follower"], [LEFT], plants=2, hours=24)
    assert most_cm <= RANGE_MARGIN_CM


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "left_cm", "round_cm"), [("lamps in turn", 2.7, 2.3), ("tip-follower", 0.4, 2.3), ("waypoint", 1.1, 2.3)]
)
def test_the_figures_of_the_readme(name: str, left_cm: float, round_cm: float) -> None:
    """Forty plants, 96 hours."""
    found_cm = farthest_cm(RULES[name], [LEFT, ROUND], plants=40, hours=96)
    print(f"\n{name}: at most {found_cm[0]:.1f} and {found_cm[1]:.1f} cm outside, three stems in a row")
    assert [round(most_cm, 1) for most_cm in found_cm] == [left_cm, round_cm]
    assert max(found_cm) <= RANGE_MARGIN_CM
