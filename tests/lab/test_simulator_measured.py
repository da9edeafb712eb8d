"""Tracks in equal steps: gaps, a beat that is not exact, photographs taken twice, light and covariates over gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flora_common.arrays import FloatArray
from flora_common.errors import BadInput
from flora_common.runs import LEVELS, LampsSection, Light
from flora_common.tracks import Track
from flora_lab.run_tracks import RunTrack
from flora_lab.simulator.measured import NEAR_SHARE, MeasuredRun, by_step, in_steps, side_by_side

STEP_S = 300.0
ALONG = np.linspace(0.0, 1.0, 10)


def stems(heights_cm: Sequence[float]) -> FloatArray:
    """Straight stems that lean a little to the right, told apart by their heights."""
    return np.stack([ALONG[:, None] * np.array([0.1 * h, h]) for h in heights_cm])


def a_run(
    times_s: Sequence[float],
    lights: Sequence[Light] | None = None,
    *,
    name: str = "run",
    plant: str = "bean",
    lamps: LampsSection | None = None,
    **covariates: Sequence[float],
) -> RunTrack:
    """A track whose stem is ``5 + row`` cm high in each row."""
    track = Track(
        np.array(times_s, dtype=np.float64),
        tuple(lights or ["left"] * len(times_s)),
        stems([5.0 + i for i in range(len(times_s))]),
        {key: np.array(values, dtype=np.float64) for key, values in covariates.items()},
    )
    return RunTrack(name, plant, Path(f"{name}.csv"), "ab" * 32, track, lamps)


def rows_of(run: MeasuredRun) -> list[int | None]:
    """Which row of the track of :func:`a_run` stands in each step; None where there is none."""
    tips = run.points_cm[:, -1, 1]
    return [None if np.isnan(tip) else round(tip - 5.0) for tip in tips]


def lamps_of(run: MeasuredRun) -> list[str]:
    names = {levels: light for light, levels in LEVELS.items()}
    return [names[tuple(levels)] for levels in run.light.tolist()]


def test_a_track_without_a_fault_is_taken_as_it_is() -> None:
    lamps = LampsSection(40.0, 20.0)
    source = a_run([900, 1200, 1500, 1800], ["dark", "left", "both", "right"], lamps=lamps, warm=[20, 21, 22, 24])
    run = in_steps(source)
    assert (run.name, run.plant, run.sha256, run.lamps, run.step_s) == ("run", "bean", "ab" * 32, lamps, 300.0)
    assert len(run) == 4
    assert run.hours == 0.25
    assert run.points_cm.tobytes() == source.track.points_cm.tobytes()
    assert run.time_s.tolist() == [900.0, 1200.0, 1500.0, 1800.0]
    assert lamps_of(run) == ["left", "both", "right"]  # the lamp of the first row shone before it
    assert run.covariates["warm"].tolist() == [20.5, 21.5, 23.0]
    assert run.is_measured.tolist() == [True] * 4


def test_what_was_measured_besides_is_bridged_where_it_is_missing_and_unknown_where_it_never_was() -> None:
    nan = float("nan")
    run = in_steps(a_run([0, 300, 600, 900], warm=[20, nan, nan, 26], damp=[nan] * 4))
    assert run.covariates["warm"].tolist() == [21.0, 23.0, 25.0]
    assert list(run.covariates) == ["warm"]


def test_times_in_hours_and_stems_upside_down_are_told_as_what_they_are() -> None:
    with pytest.raises(BadInput, match=r"no two rows are 300 s apart, most 0\.0833333 s; time_s is in seconds"):
        in_steps(a_run([k / 12.0 for k in range(40)]))
    run = a_run([0, 300, 600])
    upside_down = replace(run, track=replace(run.track, points_cm=run.track.points_cm * np.array([1.0, -1.0])))
    with pytest.raises(BadInput, match="most tips lie below the anchor; y counts up"):
        in_steps(upside_down)


def test_gaps_are_empty_rows_and_lamps_are_taken_to_change_in_their_middle() -> None:
    run = in_steps(a_run([0, 300, 1200, 1500, 2400], ["dark", "left", "right", "both", "left"]))
    assert rows_of(run) == [0, 1, None, None, 2, 3, None, None, 4]
    assert run.is_measured.tolist() == [True, True, False, False, True, True, False, False, True]
    assert np.isnan(run.points_cm[2:4]).all()
    assert lamps_of(run) == ["left", "left", "right", "right", "both", "both", "left", "left"]
    assert [(gap.start, gap.stop, gap.changes) for gap in run.unseen] == [(1, 3, True), (5, 7, True)]
    assert run.unseen[0].before.tolist() == list(LEVELS["left"])
    assert run.unseen[0].after.tolist() == list(LEVELS["right"])
    mirrored = run.mirrored().unseen[0]
    assert (mirrored.before.tolist(), mirrored.after.tolist()) == (list(LEVELS["right"]), list(LEVELS["left"]))
    assert run.time_s.tolist() == (STEP_S * np.arange(9)).tolist()


def test_rows_without_a_stem_tell_what_shone_in_a_gap() -> None:
    run = a_run([0, 300, 1200, 1500, 3000], ["dark", "left", "left", "left", "left"])
    alone: list[tuple[float, Light]] = [
        (-300.0, "both"), (10.0, "both"), (600.0, "right"), (890.0, "dark"), (1190.0, "both"), (2400.0, "right"),
        (2500.0, "both"), (3300.0, "both"),
    ]  # fmt: skip
    run = replace(run, track=replace(run.track, lamps_alone=tuple(alone)))
    steps = in_steps(run)
    assert rows_of(steps) == [0, 1, None, None, 2, 3, None, None, None, None, 4]
    assert lamps_of(steps) == ["left", "right", "dark", "left", "left", "left", "right", "right", "right", "left"]
    assert [(gap.start, gap.stop) for gap in steps.unseen] == [(5, 7), (8, 9)]


def test_rows_whose_points_are_all_in_one_place_tell_their_lamp() -> None:
    run = a_run([0, 300, 600, 900], ["dark", "left", "right", "left"])
    run.track.points_cm[2] = 0.0
    assert lamps_of(in_steps(run)) == ["left", "right", "left"]


def test_a_gap_after_the_first_row_is_lit_as_the_row_after_it_tells() -> None:
    """The first row's lamp shone before the run."""
    run = in_steps(a_run([0, 900, 1200], ["dark", "left", "right"]))
    assert lamps_of(run) == ["left", "left", "left", "right"]
    assert [(gap.start, gap.stop, gap.changes) for gap in run.unseen] == [(0, 2, False)]


def test_a_beat_that_is_not_exact_is_put_in_its_place() -> None:
    run = in_steps(a_run([100, 100 + 299, 100 + 640, 100 + 850, 100 + 1260]))
    assert rows_of(run) == [0, 1, 2, 3, 4]
    assert run.time_s.tolist() == [100.0, 400.0, 700.0, 1000.0, 1300.0]


def test_what_lies_between_two_places_is_left_out_with_its_light() -> None:
    near_s = NEAR_SHARE * STEP_S
    times_s = [0, 300, 450, 600 + near_s - 1, 900 + near_s + 1, 1500]
    run = in_steps(a_run(times_s, ["dark", "left", "right", "dark", "left", "both"]))
    assert rows_of(run) == [0, 1, 3, None, None, 5]
    assert lamps_of(run) == ["left", "dark", "dark", "both", "both"]


def test_of_photographs_taken_twice_the_nearest_counts() -> None:
    run = in_steps(a_run([0, 10, 290, 300, 310, 600], ["dark", "left", "left", "right", "both", "dark"]))
    assert rows_of(run) == [0, 3, 5]
    assert lamps_of(run) == ["right", "dark"]


def test_covariates_are_those_in_the_middle_of_a_step_and_lines_over_gaps() -> None:
    run = in_steps(a_run([0, 300, 1500, 1800], warm=[10, 20, 60, 60], dim=[0, 0, 0, 4]))
    assert run.covariates["warm"] == pytest.approx([15.0, 25.0, 35.0, 45.0, 55.0, 60.0])
    assert run.covariates["dim"] == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.0, 2.0])


def test_other_steps_than_five_minutes() -> None:
    run = in_steps(a_run([0, 60, 120, 240]), 60.0)
    assert rows_of(run) == [0, 1, 2, None, 3]
    assert run.step_s == 60.0
    assert rows_of(in_steps(a_run([0, 300, 600, 900, 1200]), 600.0)) == [0, 2, 4]


@pytest.mark.parametrize(
    ("times_s", "said"),
    [
        ([0], "holds one stem; at least two are needed"),
        ([0, 600, 1200], "no two rows are 300 s apart"),
        ([0, 150], "no two rows are 300 s apart"),
        ([0, 20, 40], "no two rows are 300 s apart"),
    ],
)
def test_tracks_that_tell_no_movement_are_refused(times_s: list[float], said: str) -> None:
    with pytest.raises(BadInput, match=said) as told:
        in_steps(a_run(times_s))
    assert str(told.value).startswith("run.csv: ")
    assert "\n" not in str(told.value)


def test_points_that_no_stem_has_are_refused_with_their_row() -> None:
    off, inches = a_run([0, 300, 600]), a_run([0, 300, 600])
    off.track.points_cm[1, 0, 0] = 0.5
    inches.track.points_cm[2, -1, 1] = 72.0
    with pytest.raises(BadInput, match=r"run\.csv row 2 \(time_s 300\): point 1 is the anchor"):
        in_steps(off)
    with pytest.raises(BadInput, match=r"run\.csv row 3 \(time_s 600\): a point is more than 60 cm from the anchor"):
        in_steps(inches)


def test_stems_without_length_are_none_and_no_run_begins_with_one() -> None:
    run = a_run([0, 300, 600, 900, 1200])
    run.track.points_cm[[2, 4]] = 0.0
    assert rows_of(in_steps(run)) == [0, 1, None, 3]
    run.track.points_cm[0] = 0.0
    with pytest.raises(BadInput, match=r"run\.csv row 1 \(time_s 0\): the first stem is shorter than 1 mm"):
        in_steps(run)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_whatever_is_missing_and_however_the_beat_strays(data: st.DataObject) -> None:
    """Each row that is near its beat is found there; each step's lamp is that of the nearer row, counted in steps."""
    count = data.draw(st.integers(3, 30))
    kept = [0, 1, *sorted(data.draw(st.sets(st.integers(2, count), max_size=count)))]
    strays = [0.0, *(data.draw(st.floats(-0.34, 0.34)) for _ in kept[1:])]
    lights: list[Light] = [data.draw(st.sampled_from(["left", "right", "dark", "both"])) for _ in kept]
    run = in_steps(a_run([STEP_S * (k + s) for k, s in zip(kept, strays, strict=True)], lights))
    assert len(run) == kept[-1] + 1
    assert rows_of(run) == [kept.index(k) if k in kept else None for k in range(len(run))]
    for step, lamp in enumerate(lamps_of(run)):
        after = next(i for i, k in enumerate(kept) if k > step)
        before, end = kept[after - 1], kept[after]
        is_told = step + 1 == end
        assert lamp == lights[after if is_told or 2 * step >= before + end - 1 else after - 1]


def test_mirrored_is_the_other_side_and_twice_mirrored_the_same() -> None:
    run = in_steps(a_run([0, 300, 900], ["dark", "left", "both"], warm=[1, 2, 3]))
    other = run.mirrored()
    assert np.array_equal(other.points_cm[..., 0], -run.points_cm[..., 0], equal_nan=True)
    assert np.array_equal(other.points_cm[..., 1], run.points_cm[..., 1], equal_nan=True)
    assert lamps_of(run) == ["left", "left", "both"]
    assert lamps_of(other) == ["right", "right", "both"]
    assert (other.name, other.plant, other.sha256) == (run.name, run.plant, run.sha256)
    again = other.mirrored()
    assert np.array_equal(again.points_cm, run.points_cm, equal_nan=True)
    assert again.light.tobytes() == run.light.tobytes()


def test_side_by_side_all_are_as_long_as_the_longest() -> None:
    long = in_steps(a_run([0, 300, 900, 1200], ["dark", "left", "left", "right"], warm=[1, 2, 4, 5], wet=[1, 1, 1, 1]))
    short = in_steps(a_run([60, 360, 660], ["dark", "right", "both"], dim=[0, 0, 0], warm=[7, 8, 9]))
    batch = side_by_side([long, short])
    assert batch.step_s == 300.0
    assert batch.rows.tolist() == [5, 3]
    assert np.array_equal(batch.points_cm[:, 0], long.points_cm, equal_nan=True)
    assert np.array_equal(batch.points_cm[:3, 1], short.points_cm)
    assert np.isnan(batch.points_cm[3:, 1]).all()
    assert batch.light[:, 0].tobytes() == long.light.tobytes()
    assert batch.light[:, 1].tolist() == [[0, 1], [1, 1], [1, 1], [1, 1]]  # its last lamp stays on
    assert list(batch.covariates) == ["warm"]  # what not all runs have is nobody's
    assert batch.covariates["warm"].T.tolist() == [[1.5, 2.5, 3.5, 4.5], [7.5, 8.5, 8.5, 8.5]]


def test_runs_of_different_steps_do_not_go_side_by_side() -> None:
    often, seldom = in_steps(a_run([0, 300, 600])), in_steps(a_run([0, 600, 1200]), 600.0)
    with pytest.raises(ValueError, match="different steps"):
        side_by_side([often, seldom])
    assert [places.tolist() for places in by_step([seldom, often, seldom])] == [[0, 2], [1]]


def test_a_run_alone_side_by_side_is_itself() -> None:
    run = in_steps(a_run([0, 300, 600], warm=[1, 2, 3]))
    batch = side_by_side([run])
    assert batch.points_cm[:, 0].tobytes() == run.points_cm.tobytes()
    assert batch.light[:, 0].tobytes() == run.light.tobytes()
    assert batch.covariates["warm"][:, 0].tobytes() == run.covariates["warm"].tobytes()
