"""The built-in rules, alone and on the virtual plant."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from flora_common.arrays import FloatArray
from flora_common.geometry import clearance_cm, collides
from flora_common.open_loop import OpenLoopSection
from flora_common.runs import Light
from flora_common.shapes import Obstacle, Target
from flora_controller.core import ControllerSection
from flora_controller.source import built_in
from flora_controller.steering import (
    Dark,
    OpenLoop,
    Steering,
    TipFollower,
    TipFollowerSection,
    View,
    Waypoint,
    WaypointSection,
    passing_side,
    way_is_blocked,
)
from flora_twin.grow import stem_points_cm
from flora_twin.plant import Plants

HOUR = 3600.0
TARGET, OBSTACLE = Target(-5.12, 17.9), Obstacle(-6.3, 12.5)


def stem_to(x_cm: float, y_cm: float) -> FloatArray:
    """A straight stem."""
    return np.linspace((0.0, 0.0), (x_cm, y_cm), 10)


def view(points: FloatArray | None, *, time_s: float = 0.0, last: Light | None = None) -> View:
    return View(time_s, points, last)


@pytest.mark.parametrize(
    ("hours", "expected"),
    [(0.0, "left"), (5.999, "left"), (6.0, "right"), (11.999, "right"), (12.0, "left"), (71.0, "right")],
)
def test_the_open_loop_changes_every_six_hours(hours: float, expected: str) -> None:
    assert OpenLoop(OpenLoopSection()).decide(view(None, time_s=hours * HOUR), {}).light == expected


def test_the_open_loop_takes_its_hours_and_first_side_from_the_configuration() -> None:
    rule = OpenLoop(OpenLoopSection(hours=1.5, first="right"))

    assert [rule.decide(view(None, time_s=h * HOUR), {}).light for h in (0, 1.4, 1.5, 3.0)] == [
        "right",
        "right",
        "left",
        "right",
    ]
    assert not rule.needs_stem


def test_dark_is_dark() -> None:
    assert Dark().decide(view(stem_to(0, 10)), {}).light == "dark"


def test_the_tip_follower_shines_from_the_targets_side() -> None:
    rule = TipFollower(TARGET, TipFollowerSection())

    assert rule.decide(view(stem_to(0, 10)), {}).light == "left"
    assert rule.decide(view(stem_to(-9, 10)), {}).light == "right"


@pytest.mark.parametrize("last", ["left", "right"])
def test_the_tip_follower_does_not_flicker_near_the_target(last: Light) -> None:
    rule = TipFollower(TARGET, TipFollowerSection(deadband_cm=0.5))

    for x in (-5.6, -5.0, -4.7):
        assert rule.decide(view(stem_to(x, 17), last=last), {}).light == last


@pytest.mark.parametrize(
    "rule", [TipFollower(TARGET, TipFollowerSection()), Waypoint(TARGET, OBSTACLE, WaypointSection())]
)
def test_without_a_stem_there_is_no_decision(rule: Steering) -> None:
    assert rule.decide(view(None), {}).light is None


@pytest.mark.parametrize(
    ("target", "obstacle", "blocked", "side"),
    [
        (TARGET, OBSTACLE, True, "right"),
        (TARGET, Obstacle(-8.24, 8.8), False, "right"),
        (TARGET, Obstacle(-5.57, 8.8), True, "right"),
        (TARGET, Obstacle(2.43, 8.8), True, "left"),
        (Target(0.0, 17.9), Obstacle(3.0, 8.8), True, "left"),
        (Target(0.0, 17.9), Obstacle(-3.0, 8.8), True, "right"),
        (Target(5.12, 17.9), Obstacle(6.3, 12.5), True, "left"),
    ],
)
def test_the_side_on_which_the_obstacle_is_passed(target: Target, obstacle: Obstacle, blocked: bool, side: str) -> None:
    """The paper's scenarios and its reality experiment, and that one mirrored."""
    assert way_is_blocked(target, obstacle, margin_cm=1.2) is blocked
    assert passing_side(target, obstacle, margin_cm=1.2) == side


def test_the_waypoint_rule_goes_away_until_the_tip_is_above_the_obstacle_and_never_back() -> None:
    rule = Waypoint(TARGET, OBSTACLE, WaypointSection(rise_cm=0.8))

    low = rule.decide(view(stem_to(3, 10)), {})
    high = rule.decide(view(stem_to(5, 14.81)), low.memory)
    sunk = rule.decide(view(stem_to(5, 14.0)), high.memory)

    assert (low.light, high.light, sunk.light) == ("right", "left", "left")


def test_the_waypoint_rule_keeps_off_the_obstacle_and_lets_go_later_than_it_began() -> None:
    rule = Waypoint(TARGET, OBSTACLE, WaypointSection(guard_cm=1.2, release_cm=1.7))
    passed = rule.decide(view(stem_to(8, 15)), {})
    near, between, free = (np.vstack([stem_to(x, 14)[:-1], (x, 15.0)]) for x in (-2.2, -1.5, -0.5))
    distances = [clearance_cm(points, OBSTACLE) for points in (near, between, free)]
    assert distances[0] < 1.2 < distances[1] < 1.7 < distances[2]

    guarded = rule.decide(view(near), passed.memory)
    still = rule.decide(view(between), guarded.memory)
    fresh = rule.decide(view(between), passed.memory)
    over = rule.decide(view(free), still.memory)

    assert [d.light for d in (guarded, still, fresh, over)] == ["right", "right", "left", "left"]


def test_a_stem_that_had_to_pass_near_by_is_not_held_off_for_ever() -> None:
    rule = Waypoint(Target(0.0, 17.9), Obstacle(3.0, 8.8), WaypointSection())
    near = np.linspace((0.0, 0.0), (-2.0, 13.0), 10)
    room = clearance_cm(near, Obstacle(3.0, 8.8))
    assert 0.5 < room < 1.2

    assert rule.decide(view(near), {}).light == "right"


def steer(use: str, seeds: Sequence[int], *, hours: float, noise_cm: float = 0.0) -> list[list[FloatArray]]:
    """Per plant, its ten points every five minutes until the tip is at 21 cm; the rule sees them with some noise."""
    rule = built_in(ControllerSection(use=use), TARGET, OBSTACLE)
    plants, draw = Plants(seeds), np.random.default_rng(1)
    stems: list[list[FloatArray]] = [[] for _ in seeds]
    memories: list[dict[str, float]] = [{} for _ in seeds]
    lights: list[Light | None] = [None for _ in seeds]
    for tick in range(int(hours * 12)):
        for i, line in enumerate(plants.centreline_cm()):
            if stems[i] and stems[i][-1][-1, 1] >= 21.0:
                continue
            stems[i].append(stem_points_cm(line[: plants.segments[i] + 1]))
            seen = stems[i][-1] + noise_cm * draw.standard_normal((10, 2))
            decision = rule.decide(View(tick * 300.0, seen, lights[i]), memories[i])
            lights[i], memories[i] = decision.light, dict(decision.memory)
        if all(s[-1][-1, 1] >= 21.0 for s in stems):
            break
        for _ in range(3):
            plants.step([float(x == "left") for x in lights], [float(x == "right") for x in lights])
    return stems


def judge(run: list[FloatArray]) -> tuple[bool, bool, float, float]:
    """(collided, target reached, best fitness, least clearance)."""
    return (
        any(collides(points, OBSTACLE) for points in run),
        any(TARGET.contains(*points[-1]) for points in run),
        max(TARGET.fitness(*points[-1]) for points in run),
        min(clearance_cm(points, OBSTACLE) for points in run),
    )


def test_the_waypoint_rule_does_the_papers_reality_experiment_on_the_virtual_plant() -> None:
    for run in steer("waypoint", [1, 2, 3], hours=110):
        collided, reached, best, _ = judge(run)
        assert (collided, reached) == (False, True)
        assert best > 0.88
        assert run[-1][-1, 1] >= 21.0
        assert max(points[-1, 0] for points in run) > 4.0  # far to the other side first, as in the paper


@pytest.mark.slow
def test_the_waypoint_rule_on_forty_plants() -> None:
    """The figures of the service's README: run it with ``-s``."""
    judged = [judge(run) for run in steer("waypoint", range(200, 240), hours=110, noise_cm=0.1)]

    best = [j[2] for j in judged]
    print(
        f"\ncollisions {sum(j[0] for j in judged)}, target reached {sum(j[1] for j in judged)} of {len(judged)}, "
        f"best fitness {np.mean(best):.3f} (least {min(best):.3f}), least clearance {min(j[3] for j in judged):.2f} cm"
    )
    assert not any(j[0] for j in judged)
    assert sum(j[1] for j in judged) >= 38


def test_following_the_tip_alone_runs_into_the_obstacle() -> None:
    """Why there is a waypoint rule at all."""
    (run,) = steer("tip-follower", [1], hours=60)

    assert judge(run)[0]
