"""When a run is over, and that nothing after it counts."""

from __future__ import annotations

import numpy as np
import pytest

from flora_common.arrays import FloatArray
from flora_common.shapes import STEM_POINTS, Obstacle, Target
from flora_lab.judging import judge, reason

TARGET = Target(-5.0, 15.0)
OBSTACLE = Obstacle(6.0, 8.0, 4.0, 2.0)


def stems(*tips: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Straight stems, one an hour."""
    points = np.stack([np.outer(np.linspace(0.0, 1.0, STEM_POINTS), tip) for tip in tips])
    return 3600.0 * np.arange(len(tips)), points


def test_a_target_that_is_reached_after_the_end_is_not_reached() -> None:
    judged = judge(*stems((0.0, 7.0), (8.0, 10.0), (-5.0, 15.0)), TARGET, OBSTACLE)

    assert (judged.ended, judged.stop_row, judged.collided_h) == ("collision", 1, 1.0)
    assert (judged.fitness_at_target, judged.reached_h) == (None, None)
    assert judged.fitness_at_stop == pytest.approx((20.0 - 13.0 - 5.0) / 20.0)
    assert judged.best_fitness == pytest.approx((20.0 - 5.0 - 8.0) / 20.0)
    assert judged.clearance_cm == 0.0


def test_an_obstacle_that_is_touched_after_the_end_is_not_touched() -> None:
    judged = judge(*stems((0.0, 7.0), (-4.0, 16.0), (-5.0, 21.0), (8.0, 10.0)), TARGET, OBSTACLE)

    assert (judged.ended, judged.stop_row, judged.collided_h) == ("height", 2, None)
    assert (judged.fitness_at_target, judged.reached_h) == (pytest.approx(0.9), 1.0)
    assert judged.clearance_cm == pytest.approx(4.0)
    assert judged.fitness_over_time is not None
    assert len(judged.fitness_over_time) == 4


def test_the_obstacle_counts_before_the_height_and_the_height_is_what_was_asked() -> None:
    over = stems((0.0, 7.0), (12.0, 22.0))
    assert judge(*over, TARGET, Obstacle(6.0, 11.0)).ended == "collision"
    assert judge(*over, TARGET, None, stop_height_cm=23.0).ended == "time"
    assert judge(*over, TARGET, None, stop_height_cm=7.0).stop_row == 0
    assert reason("height", 23.0) == "the tip was 23 cm high"


def test_without_target_and_obstacle_there_is_only_an_end() -> None:
    judged = judge(*stems((0.0, 7.0), (0.0, 12.0)), None, None)

    assert (judged.ended, judged.stop_row) == ("time", 1)
    assert (judged.fitness_at_stop, judged.best_fitness, judged.fitness_over_time, judged.clearance_cm) == (None,) * 4


def test_what_comes_after_the_time_is_over_does_not_count() -> None:
    run = stems((0.0, 6.0), (0.0, 7.0), (0.0, 8.0), (0.0, 9.0))
    judged = judge(*run, TARGET, None, hours=2.0 + 0.2 / 3600.0)
    assert (judged.stop_row, judged.ended) == (2, "time")
    assert judged.best_fitness == judged.fitness_at_stop
    assert judge(*run, TARGET, None).stop_row == 3
