"""Plants that grow as their simulator says, and such as do not: told while the run lasts, once each way."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import msgspec
import numpy as np
import pytest
from diagnose_runs import LAMPS, LAW, base, change_of, known, run_of

from flora_common.errors import BadInput
from flora_common.runs import LEVELS, Light
from flora_lab.diagnose import stored_base
from flora_lab.serve import departing, expecting
from flora_lab.serve.departing import Watched
from flora_lab.serve.expecting import Hour
from flora_lab.serve.heard import Row
from flora_lab.serve.looking import measured
from flora_lab.serve.tasks import LookTask, work
from flora_lab.simulator.growing import DataRange
from flora_lab.simulator.measured import MeasuredRun
from flora_lab.simulator.store import Provenance

RATE = 0.01
HEALTHY = (200, 201)


def followed(run: MeasuredRun, before: Watched | None = None) -> Watched:
    return departing.followed(run, LAW, None, known(), before or Watched(), RATE)


@functools.cache
def healthy(seed: int) -> Watched:
    return followed(run_of(seed, hours=36.0))


def rows_of(run: MeasuredRun) -> list[Row]:
    """A run as it was heard."""
    names: dict[tuple[float, ...], Light] = {value: name for name, value in LEVELS.items()}
    lights = [names[tuple(run.light[max(k - 1, 0)].tolist())] for k in range(len(run))]
    return [
        Row(k + 1, float(run.time_s[k]), lights[k], tuple((float(x), float(y)) for x, y in run.points_cm[k]))
        for k in range(len(run))
    ]


@pytest.mark.parametrize("seed", HEALTHY)
def test_a_plant_that_is_as_its_simulator_says_does_not_depart(seed: int) -> None:
    watched = healthy(seed)
    assert watched.departed_at is None
    assert [h.hour for h in watched.hours] == list(range(1, len(watched.hours) + 1))
    assert [h.is_watched for h in watched.hours] == [h.hour > expecting.WATCHED_H for h in watched.hours]
    # what is expected is neither too narrow nor too wide
    beyond = [departing.distance_mm(h) > h.expected_mm for h in watched.hours]
    assert sum(beyond) <= 8


def test_innovations_of_healthy_plants_are_as_large_as_those_of_reference_plants() -> None:
    hours = [hour for seed in HEALTHY for hour in healthy(seed).hours]
    usual = float(np.mean(known().residuals.misfit))
    assert sum(h.squares for h in hours) / sum(h.count for h in hours) == pytest.approx(usual, rel=0.4)


def test_a_watched_plant_is_known_better_than_a_typical_one() -> None:
    hours = healthy(HEALTHY[0]).hours
    assert hours[28].expected_mm < 0.8 * hours[22].expected_mm


def test_a_steady_push_is_told_within_hours_and_to_its_side() -> None:
    change = change_of({"draught": {"drive_per_cm_h": -0.1}})
    watched = followed(run_of(203, hours=10.2, change=change))
    assert watched.departed_at is not None
    assert watched.departed_at <= 10
    told = departing.sentence(watched, RATE)
    assert f"departs from its simulator since hour {watched.departed_at} (by chance in at most 1 % of runs)" in told
    assert "mm to the left of" in told
    last = watched.hours[-1].error_mm
    assert last is not None
    assert last[0] < 0.0


def test_a_camera_that_is_knocked_and_put_back_is_told_and_the_return_too() -> None:
    run = run_of(204, hours=34.0)
    points = run.points_cm.copy()
    points[12 * 12 + 3 : 15 * 12, 1:, 0] += 2.0
    knocked = dataclasses.replace(run, points_cm=points)
    watched, states = Watched(), []
    for hours in (14, 20, 33):
        watched = followed(_until(knocked, hours), watched)
        states.append(watched.departed_at)
    assert states == [13, 13, None]
    ((since, until),) = watched.left_out
    assert since == 12
    assert 15 <= until <= 18
    assert watched.bets_since == until + departing.BACK_H
    assert len(watched.hours) == 33
    before, after = watched.hours[11].error_mm, watched.hours[12].error_mm
    assert before is not None
    assert after is not None
    assert after[0] - before[0] > 12.0


def _until(run: MeasuredRun, hours: int) -> MeasuredRun:
    rows = hours * 12 + 3
    return dataclasses.replace(
        run, points_cm=run.points_cm[:rows], light=run.light[: rows - 1], time_s=run.time_s[:rows], covariates={}
    )


def test_what_was_kept_is_gone_on_with_as_if_nothing_had_been() -> None:
    first = followed(run_of(200, hours=9.2))
    kept = msgspec.convert(msgspec.json.decode(msgspec.json.encode(msgspec.to_builtins(first))), Watched)
    assert kept == first
    again, at_once = followed(run_of(200, hours=12.2), kept), followed(run_of(200, hours=12.2), first)
    assert again == at_once
    assert again.hours[: len(first.hours)] == first.hours
    assert followed(run_of(200, hours=12.2), again) == again


def hour(number: int, *, error_mm: float = 1.0, squares: float = 5.0, bet: float = -0.1) -> Hour:
    return Hour(number, squares, 5, (bet,) * 10, True, (error_mm, 0.0), 5.0)


def test_a_plant_is_back_when_it_is_as_expected_for_long_enough() -> None:
    good = [hour(k) for k in range(departing.BACK_H)]
    assert departing.is_back(good, 2.0)
    assert departing.is_back([hour(0, error_mm=9.0), *good[1:]], 2.0)
    assert not departing.is_back([hour(0, error_mm=9.0), hour(1, error_mm=9.0), *good[2:]], 2.0)
    assert not departing.is_back([*good[1:], hour(99, squares=200.0)], 2.0)
    assert not departing.is_back([hour(k, bet=0.2) for k in range(departing.BACK_H)], 2.0)


def test_hours_without_a_stem_are_no_sign_of_either() -> None:
    empty = Hour(3, 0.0, 0, (0.0,) * 10, False, None, 0.0)
    assert departing.judged(Watched(), empty, RATE).departed_at is None
    assert not departing.is_back([empty] * 30, 2.0)
    assert departing.sentence(Watched((empty,)), RATE) == "No stem has been measured yet."


def test_a_gap_of_hours_is_no_departure() -> None:
    run = run_of(205, hours=16.0)
    points = run.points_cm.copy()
    points[60:110] = np.nan
    watched = followed(dataclasses.replace(run, points_cm=points))
    assert watched.departed_at is None
    assert [h.error_mm is None for h in watched.hours].count(True) >= 3


def test_rows_tell_which_lamp_shone_where_there_is_no_stem() -> None:
    rows = rows_of(run_of(200, hours=4.0))
    rows = [Row(r.tick, r.time_s, "left" if r.tick <= 20 else "right", r.points_cm) for r in rows]
    heard = [Row(r.tick, r.time_s, r.light) if 10 < r.tick < 40 else r for r in rows]
    run = measured("bean", heard, LAMPS)
    assert run.light[:19].tolist() == [[1.0, 0.0]] * 19
    assert run.light[19:].tolist() == [[0.0, 1.0]] * (len(run) - 20)
    assert np.isnan(run.points_cm[12]).all()
    silent = [Row(r.tick, r.time_s, None) if 10 < r.tick < 40 else r for r in rows]
    assert measured("bean", silent, LAMPS).light[15:38].tolist() == [[1.0, 0.0]] * 23
    with pytest.raises(BadInput, match="no two stems"):
        measured("bean", heard[:1], LAMPS)


def test_a_look_is_made_against_a_simulator_on_the_disk(tmp_path: Path) -> None:
    simulator = stored_base.simulator_of(base(), LAMPS, DataRange(60.0, 30.0), None)
    provenance = Provenance(recipe="diagnose", seed=0, software="", split="")
    stored_base.write_known(tmp_path / "base.simulator", simulator, known(), provenance)
    rows = rows_of(run_of(200, hours=5.2))
    looked = work(LookTask("bean", rows, None, tmp_path / "base.simulator", None, RATE))
    assert (looked.hours, looked.departed_at, looked.is_watched) == (5, None, False)
    assert "is as its simulator expects: after 5 h" in looked.sentence
    assert work(LookTask("bean", rows, None, tmp_path / "base.simulator", looked.watched, RATE)) == looked
