"""What the simulator gets wrong: where, when, how much, and whether by chance."""

from __future__ import annotations

import functools
import math
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from diagnose_fakes import BASE, found_of, scene_of

from flora_lab.diagnose import residual_statistics as statistics
from flora_lab.diagnose import residual_words
from flora_lab.diagnose.diagnosis import Residuals
from flora_lab.diagnose.replayed import replayed
from flora_lab.diagnose.residual_words import mm, p_text
from flora_lab.diagnose.residuals import (
    FINE_BINS,
    SWING_PERIODS_H,
    ReferenceResiduals,
    ResidualTables,
    as_arrays,
    from_arrays,
    reference_residuals,
    residuals_of,
)
from flora_lab.effects.effect import Change
from flora_lab.simulator import terms


@functools.cache
def reference() -> ReferenceResiduals:
    runs = [scene_of(f"reference{seed}", seed) for seed in range(9)]
    misfits = np.linspace(0.9, 1.1, 9)
    fits = [found_of([scene], [traits], misfit) for (scene, traits), misfit in zip(runs, misfits, strict=True)]
    return reference_residuals([scene for scene, _ in runs], BASE, fits)


def judged(misfit: float = 1.0, **how: object) -> tuple[Residuals, ResidualTables]:
    """Three runs with something hidden, by simulated plants that have the true constants."""
    runs = [scene_of(f"run{seed}", seed, **how) for seed in (20, 21, 22)]  # type: ignore[arg-type]
    scenes = [scene for scene, _ in runs]
    return residuals_of(scenes, BASE, found_of(scenes, [t for _, t in runs], misfit), reference())


def push(change: Change) -> None:
    change.terms[terms.PUSH] += 0.06


def rhythm(change: Change) -> None:
    change.terms[terms.DIURNAL], change.terms[terms.PEAK_H] = 0.6, 4.0


def test_where_nothing_is_wrong_nothing_is_said_to_be() -> None:
    said, tables = judged()
    assert not said.significant
    assert "no more than plants and chance" in said.description
    assert "to the left" not in said.description
    assert said.when["p_value"] > 0.05
    assert said.when["ways_to_exchange"] == math.comb(12, 3)
    # own constants are the true ones: what is left is the noise of 0.2 mm per coordinate
    assert said.where["tip"]["rms_own_constants_mm"] == pytest.approx(0.2 * math.sqrt(2.0), rel=0.2)
    assert said.size_mm > 3.0
    assert len(tables.runs) == 3


def test_a_push_to_the_right_is_told_with_its_side_and_size() -> None:
    said, tables = judged(2.0, effect=push)
    assert said.significant
    assert tables.plant == "own"
    assert "farther to the right than simulated, whichever lamp shines" in said.description
    own = [run.error_mm("own")[:, -1, 0].mean() for run in tables.runs]
    assert min(own) > 3.0
    where = [said.where[place]["right_mm"] for place in ("point_2", "point_6", "tip")]
    assert where == sorted(where)
    assert 0.0 < said.when["one_step"]["right_mm"] < 1.0
    steps = [said.when["one_step_along_the_stem"][place]["right_mm"] for place in ("point_2", "point_6", "tip")]
    assert steps == sorted(steps)
    assert steps[-1] == said.when["one_step"]["right_mm"]


def test_a_day_rhythm_of_growth_is_told_with_its_hours() -> None:
    said, tables = judged(2.0, effect=rhythm)
    assert said.significant
    assert "the stem grows" in said.description
    assert "mm/h faster than simulated in hours" in said.description
    assert "mm/h more slowly than simulated in hours" in said.description
    by_hour = tables.shown.by_clock_mm_h["own"].mean(axis=0)
    assert int(np.argmax(by_hour)) in (0, 1, 2)
    assert int(np.argmin(by_hour)) in (4, 5, 6)


def test_growth_that_is_slower_at_all_hours_is_nowhere_called_faster(monkeypatch: pytest.MonkeyPatch) -> None:
    rates = np.array([-0.02, -0.02, -0.02, -0.6, -0.02, -0.02, -0.02, -0.02])
    monkeypatch.setattr(residual_words, "_means", lambda *_: rates)
    monkeypatch.setattr(residual_words, "_differ", lambda *_: "")
    said = residual_words._growth(SimpleNamespace(numbers={"own": None}, clearer_plant="own"))
    assert said == (
        "Counted from the start of each day, the stem grows 0.02 mm/h more slowly than simulated in hours 0-3 and "
        "0.60 mm/h more slowly than simulated in hours 9-12."
    )


def test_a_swing_stands_out_at_its_period() -> None:
    said, tables = judged(2.0, swing_cm=0.5)
    assert "by 5.1 mm to either side every 1.7 h" in said.description
    for curve in tables.shown.swing_mm:
        assert SWING_PERIODS_H[np.argmax(curve)] == pytest.approx(1.7, rel=0.05)
        assert curve.max() == pytest.approx(5.0, rel=0.35)


def test_a_restless_tip_is_not_said_to_have_a_period() -> None:
    said, _ = judged(2.0, noise_cm=0.12)
    assert "at no period of its own" in said.description
    assert "swings by" not in said.description


def test_runs_that_fit_badly_are_significant_whatever_they_look_like() -> None:
    for misfit, expected in ((1.0, False), (3.0, True)):
        said, _ = judged(misfit)
        assert said.significant is expected
        assert said.when["p_value_by_exchange"] > 0.05
        assert ("no more than plants and chance" in said.description) is not expected


def test_what_is_said_is_json_and_reference_residuals_are_arrays() -> None:
    said, _ = judged()
    again = msgspec.json.decode(msgspec.json.encode(said), type=Residuals)
    assert again.when == said.when
    arrays = as_arrays(reference())
    assert all(isinstance(own, np.ndarray) for own in arrays.values())
    back = as_arrays(from_arrays(arrays))
    assert back.keys() == arrays.keys()
    assert all(np.array_equal(back[name], arrays[name], equal_nan=True) for name in arrays)
    with pytest.raises(KeyError):
        from_arrays({name: own for name, own in arrays.items() if name != "misfit"})


def test_a_run_with_gaps_and_one_of_an_hour_are_told_as_far_as_they_go() -> None:
    holes, traits = scene_of("gaps", 5, hidden=slice(50, 150))
    short, own = scene_of("short", 6, hours=1.0)
    said, tables = residuals_of([holes, short], BASE, found_of([holes, short], [traits, own]), reference())
    assert np.isnan(tables.shown.numbers["own"]).any()
    assert np.isfinite(said.size_mm)
    assert said.when["age"]["day 3"]["rms_mm"] is None
    msgspec.json.encode(said)


def test_one_step_from_a_measured_stem_is_what_the_law_does_next() -> None:
    scene, traits = scene_of("clean", 7, noise_cm=0.0, hours=12.0)
    run = replayed(scene, BASE, traits, traits, np.zeros(2), Change())
    # The chain is laid anew through ten points: a tenth of a millimetre.
    assert np.abs(10.0 * run.step_error_cm).max() < 0.1
    assert np.abs(run.error_mm("own")).max() < 0.5
    moved = 10.0 * np.abs(np.diff(run.measured_cm[:, -1], axis=0)).max()
    assert moved > 0.5


def test_hours_since_a_switch_count_from_each_change() -> None:
    scene, traits = scene_of("switches", 8, hours=13.0)
    run = replayed(scene, BASE, traits, traits, np.zeros(2), Change())
    assert run.since_h[0] == pytest.approx(1.0 / 12.0)
    assert run.since_h[71] == pytest.approx(6.0)
    assert run.since_h[72] == pytest.approx(1.0 / 12.0)
    assert (run.is_left ^ run.is_right).all()
    assert run.is_left[0] != run.is_left[72]
    assert (run.chance_cm[0] <= run.chance_cm[1]).all()
    assert reference().shown.by_switch_mm["own"].shape == (9, 2, FINE_BINS)


def test_exchanging_whole_runs_gives_the_exact_share() -> None:
    rng = np.random.default_rng(1)
    other = rng.standard_normal((9, 4))
    group = [np.arange(4)]
    far = rng.standard_normal((3, 4)) + np.array([9.0, 0.0, 0.0, 0.0])
    compared = statistics.compared(far, other, group)
    assert compared.p_value == 1.0 / math.comb(12, 3)
    assert int(np.argmax(np.abs(compared.away))) == 0
    assert compared.away[0] > compared.remarkable
    # One run against nine cannot tell more than one in ten.
    assert statistics.compared(far[:1], other, group).p_value == pytest.approx(0.1)
    # A number that few runs tell does not count.
    unknown = far.copy()
    unknown[:2, 0] = np.nan
    assert math.isnan(statistics.compared(unknown, other, group).away[0])


def test_exchanges_are_fair_where_nothing_is_wrong() -> None:
    rng = np.random.default_rng(2)
    values = [
        statistics.compared(rng.standard_normal((3, 6)), rng.standard_normal((9, 6)), [np.arange(6)]).p_value
        for _ in range(200)
    ]
    assert 0.01 < np.mean(np.array(values) <= 0.05) < 0.1
    assert 0.4 < np.median(values) < 0.6
    many = statistics.compared(rng.standard_normal((9, 6)), rng.standard_normal((9, 6)), [np.arange(6)])
    assert many.ways == 3000
    assert 0.0 < many.p_value <= 1.0


def test_numbers_as_people_read_them() -> None:
    assert (mm(3.14), mm(12.6)) == ("3.1 mm", "13 mm")
    assert (p_text(0.00001), p_text(0.0182)) == ("p < 0.001", "p = 0.018")
