"""What the paper says in words, as numbers from tracks and histories."""

from __future__ import annotations

import numpy as np
import paper_fakes
import pytest

from flora_lab.paper.measures import converged_generation, growth_cm_per_day, hours_to_height, steering, switching_h


def test_growth_height_and_switching_of_a_plant_that_rises_steadily() -> None:
    track = paper_fakes.dataset_run("open-1").track

    assert growth_cm_per_day(track) == pytest.approx(7.2)
    assert hours_to_height(track, 20.0) == 60.0
    assert hours_to_height(track, 100.0) is None
    assert switching_h(track) == 6.0


def test_a_run_whose_lamps_never_change_has_no_time_between_changes() -> None:
    assert switching_h(paper_fakes.track(np.ones((4, 2)), ["dark", "left", "left", "left"])) is None


def test_steering_as_in_the_papers_first_experiment_is_told_with_its_numbers() -> None:
    hours = np.arange(76.0)
    x = np.where(hours <= 37, 0.2 * hours, np.maximum(7.4 - 4.0 * (hours - 37), -5.0))
    tips = np.column_stack([x, 0.4 * hours])
    told = steering(3600.0 * hours, ["dark", *["right"] * 37, *["left"] * 38], tips)

    assert told.right_h == 37.0
    assert told.tip_cm == pytest.approx((7.4, 14.8))
    assert told.to_middle_h == 2.0
    assert told.left_h == 38.0


def test_short_flickers_do_not_end_the_first_light() -> None:
    light = ["dark", *["right"] * 30, "left", *["right"] * 10, *["left"] * 20]
    tips = np.column_stack([np.full(62, 5.0), np.arange(62.0)])

    told = steering(3600.0 * np.arange(62.0), light, tips)

    assert told.right_h == 41.0
    assert told.to_middle_h is None


def test_a_run_that_starts_to_the_left_has_no_right_light_at_first() -> None:
    tips = np.column_stack([np.linspace(0.0, -5.0, 10), np.arange(10.0)])

    told = steering(3600.0 * np.arange(10.0), ["dark", *["left"] * 9], tips)

    assert (told.right_h, told.to_middle_h, told.left_h) == (0.0, None, 9.0)


@pytest.mark.parametrize(
    ("rows", "generation"),
    [
        ([[0.1, 0.5, 0.8, 0.8]], 2),
        ([[0.8, 0.8, 0.8, 0.8]], 0),
        ([[0.1, 0.2, 0.3, 0.4]], 3),
        ([[0.1, 0.795, 0.8, 0.8], [0.0, 0.79, 0.8, 0.8], [0.9, 0.9, 0.9, 0.9]], 1),
    ],
)
def test_convergence_is_where_the_median_stays_within_a_point_of_its_end(
    rows: list[list[float]], generation: int
) -> None:
    assert converged_generation(np.array(rows)) == generation
