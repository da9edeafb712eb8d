"""Figures and tables from hand-made truths and diagnoses."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from discovery.judging import claims
from discovery.scoring import (
    Outcome,
    Share,
    calibration_error,
    calibration_error_by_chance,
    confusion,
    gain_share,
    held_out_errors,
    named_share,
    parameter_errors,
    share,
)
from discovery.tables import all_tables, as_markdown, as_text


def cause(effect: str, confidence: float = 0.9, **more: Any) -> dict[str, Any]:
    told = {"effect": effect, "confidence": confidence, "parameters": {}, "interval": {}, "confusable_with": []}
    return {**told, "nats": 20.0, **more}


def outcome(
    kind: str, hidden: dict[str, dict[str, float]], verdict: str | None, *causes: dict[str, Any], **more: Any
) -> Outcome:
    truth = {
        "kind": kind,
        "form": more.pop("form", 0),
        "seed": more.pop("seed", 0),
        "effects": [{"effect": name, "parameters": p} for name, p in hidden.items()],
        "oracle": {"typical": {"end": {"base_mm": 10.0, "extended_mm": 6.0}}},
    }
    diagnosis = None if verdict is None else {"verdict": verdict, "causes": list(causes), **more}
    return Outcome(truth, diagnosis, 30.0)


SAG = {"sag": {"amplitude": 0.7}}


def cells(outcomes: list[Outcome], what: str) -> list[str]:
    """What the summary says in the rows of this name."""
    return [row[2] for row in all_tables(outcomes)[0].rows if row[0] == what]


def test_only_the_first_cause_of_a_claim_counts() -> None:
    assert outcome("single", SAG, "explained", cause("sag")).right
    assert not outcome("single", SAG, "explained", cause("draught"), cause("sag")).right
    assert not outcome("single", SAG, "unexplained", cause("sag")).right
    assert not outcome("single", SAG, "nothing_wrong").right
    assert not outcome("single", SAG, None).right


def test_causes_that_look_alike_are_one_where_the_other_is_named_too() -> None:
    late = {"phototropic_latency": {"delay_h": 0.4}}
    assert outcome("single", late, "explained", cause("clock_offset", confusable_with=["phototropic_latency"])).right
    assert not outcome("single", late, "explained", cause("clock_offset")).right
    roll = {"camera_roll": {"angle_deg": 3.0}}
    named_beside = outcome("single", roll, "explained", cause("draught", confusable_with=["camera_roll"]))
    assert named_beside.right
    assert not named_beside.right_alone
    # No other pair is taken for one, whatever the finder says.
    assert not outcome("single", roll, "explained", cause("sag", confusable_with=["camera_roll"])).right


def test_what_is_not_claimed_has_a_place_by_its_evidence() -> None:
    near = [{"sag": 3.1, "draught": 1.0}, {"draught": 9.0}]
    assert outcome("single", SAG, "nothing_wrong", considered=near).ranked_first
    assert not outcome("single", SAG, "nothing_wrong", considered=[{"sag": 0.9, "draught": 1.0}]).ranked_first
    assert not outcome("single", SAG, "explained", cause("draught"), considered=near).ranked_first
    assert outcome("single", SAG, "explained", cause("sag")).ranked_first
    assert not outcome("single", SAG, "nothing_wrong", considered=[]).ranked_first
    assert not outcome("single", SAG, None).ranked_first


def test_more_evidence_can_be_asked_of_what_was_written_down() -> None:
    told = outcome("single", SAG, "explained", cause("draught", nats=4.5), cause("sag", nats=9.0))
    assert told.if_claims_took(4.0) == told
    assert told.if_claims_took(5.0).right
    assert told.if_claims_took(10.0).verdict == "nothing_wrong"
    assert outcome("outside", SAG, "unexplained", cause("sag", nats=4.5)).if_claims_took(5.0).verdict == "unexplained"
    assert outcome("single", SAG, None).if_claims_took(5.0).verdict == "failed"
    healthy = [outcome("none", {}, "explained", cause("sag", nats=n)) for n in (4.5, 7.0)]
    bars = next(table for table in all_tables([told, *healthy]) if table.title == "Were more evidence asked for")
    alarms = {row[0]: row[4] for row in bars.rows}
    assert alarms["as claimed"].endswith("2 of 2")
    assert alarms["5 nats"].endswith("1 of 2")
    assert alarms["8 nats"].endswith("0 of 2")


def test_shares_come_with_the_interval_of_wilson() -> None:
    assert Share(5, 100).interval() == pytest.approx((0.0215, 0.1118), abs=1e-4)
    assert Share(0, 20).interval() == pytest.approx((0.0, 0.1611), abs=1e-4)
    assert share([True, False]) == Share(1, 2)
    assert str(Share(0, 0)) == "-"
    assert str(Share(1, 2)) == "50 % (9-91), 1 of 2"


def test_parameters_are_compared_in_their_own_way() -> None:
    hidden = {
        "diurnal_growth": {"amplitude": 0.4, "peak_h": 23.0},
        "camera_roll": {"angle_deg": -3.0},
        "sag": {"amplitude": 0.7},
        "stiffening": {"factor": 0.8},
    }
    causes = [
        cause("diurnal_growth", parameters={"amplitude": 0.5, "peak_h": 2.0}, interval={"peak_h": [-2.0, 1.0]}),
        cause("camera_roll", parameters={"angle_deg": 3.3}, interval={"angle_deg": [3.1, 3.5]}),
        cause("sag", parameters={"amplitude": 0.84}, interval={"amplitude": [0.8, 1.1]}),
        cause("draught", parameters={"drive_per_cm_h": 0.1}),
        cause("stiffening", parameters={"factor": 0.8}, interval={"factor": [0.7, 0.9]}),
    ]
    of_all = parameter_errors([outcome("single", hidden, "explained", *causes)])
    errors = {e.parameter: e for e in of_all if e.effect != "sag"}
    assert set(errors) == {"amplitude", "peak_h", "angle_deg", "factor"}
    (sag,) = (e for e in of_all if e.effect == "sag")  # 0.7 of the worlds' units are 1.05 of the finder's
    assert (sag.parameter, sag.relative, sag.held) == ("amplitude", pytest.approx(0.2), True)
    assert errors["amplitude"].relative == pytest.approx(0.25)
    assert errors["amplitude"].held is None
    assert (errors["peak_h"].relative, errors["peak_h"].held) == (pytest.approx(3.0 / 24.0), True)
    assert (errors["angle_deg"].relative, errors["angle_deg"].held) == (pytest.approx(0.1), False)
    assert (errors["factor"].relative, errors["factor"].held) == (0.0, True)


def test_calibration_error_weighs_bins_by_their_claims() -> None:
    sure = [outcome("single", SAG, "explained", cause("sag" if i < 9 else "draught", 0.95)) for i in range(10)]
    unsure = [outcome("single", SAG, "explained", cause("sag" if i < 3 else "draught", 0.55)) for i in range(10)]
    assert calibration_error(sure) == pytest.approx(0.05)
    assert calibration_error(sure + unsure) == pytest.approx((0.05 + 0.25) / 2)
    assert calibration_error([outcome("none", {}, "explained", cause("sag", 1.0))]) == pytest.approx(1.0)
    assert math.isnan(calibration_error([outcome("none", {}, "nothing_wrong")]))


def test_few_exact_claims_have_a_calibration_error_of_their_own() -> None:
    few = [outcome("single", SAG, "explained", cause("sag", 0.5)) for _ in range(4)]
    # 0, 1, 2, 3 or 4 of 4 right: off by a half twice in 16, by a quarter 8 times in 16.
    assert calibration_error_by_chance(few) == pytest.approx(3.0 / 16.0, abs=0.02)
    assert calibration_error_by_chance(few * 50) < 0.04
    assert math.isnan(calibration_error_by_chance([]))


def test_gain_is_pooled_over_right_claims() -> None:
    def gained(extended: float, effect: str = "sag", base: float = 10.0) -> Outcome:
        end = {"base_rms": base, "extended_rms": extended}
        return outcome("single", SAG, "explained", cause(effect), gain={"free_running": {"end": end}})

    share = gain_share([gained(6.0), gained(8.0), gained(99.0, "draught")])
    assert (share.value, share.cases) == (pytest.approx(6.0 / 8.0), 2)
    assert (share.low, share.high) == (pytest.approx(2.0 / 4.0), pytest.approx(4.0 / 4.0))
    better = [gained(7.0, base=8.0)]
    assert gain_share(better).value == pytest.approx(1.0 / 4.0)
    assert gain_share(better, from_one_base=True).value == pytest.approx(1.0 / 2.0)
    nothing = gain_share([outcome("single", SAG, "explained", cause("sag"))])
    assert math.isnan(nothing.value)
    assert nothing.cases == 0


def test_errors_on_held_out_runs_are_those_of_right_names() -> None:
    def told(extended: float, boosted: float, effect: str = "sag") -> Outcome:
        end = {"base_rms": 10.0, "extended_rms": extended, "boosted_rms": boosted, "still_rms": 90.0}
        step = {name: value / 10.0 for name, value in end.items()}
        gain = {"one_step": step, "free_running": {"end": end, "1h": {"base_rms": 1.0}}}
        return outcome("single", SAG, "explained", cause(effect), gain=gain)

    some = [told(6.0, 16.0), told(8.0, 7.0), told(0.0, 0.0, "draught")]
    assert gain_share(some, by="boosted").value == pytest.approx(-3.0 / 8.0)
    errors = held_out_errors(some)
    assert set(errors) == {"one step", "end"}
    assert errors["end"]["extended"] == (6.0, 8.0)
    assert errors["one step"]["boosted"] == (1.6, 0.7)
    (table,) = [table for table in all_tables(some) if table.title.startswith("Tip on held-out runs")]
    assert table.rows[1] == ("end", "10.0", "7.0", "11.5", "90.0", "50 % (9-91), 1 of 2")
    assert cells(some, "gain at the end of gradient boosting, share of the oracle's")[0].startswith("-0.38 (")


def test_what_was_named_is_weighed_about_the_own_plants() -> None:
    def told(kind: str, end_mm: float | None) -> Outcome:
        one = outcome(kind, SAG, "explained", cause("sag"))
        one.truth["oracle"]["own"] = {"end": {"base_mm": 10.0, "extended_mm": 2.0}}
        return replace(one, named_mm=None if end_mm is None else {"end": end_mm})

    share = named_share([told("single", 4.0), told("pair", 10.0), told("outside", 2.0), told("single", None)])
    assert (share.value, share.cases) == (pytest.approx(6.0 / 16.0), 2)
    assert (share.low, share.high) == (pytest.approx(0.0), pytest.approx(0.75))
    assert math.isnan(named_share([]).value)
    assert named_share([told("single", 4.0)], "6h").cases == 0
    early = told("single", 4.0)
    early.truth["oracle"]["own"]["6h"] = {"base_mm": 3.0, "extended_mm": 1.0}
    early = replace(early, named_mm={"end": 4.0, "6h": 1.5})
    assert named_share([early], "6h").value == pytest.approx(0.75)
    assert cells([early], "the same after 6 h")[0].startswith("0.75 (")


def test_rhythms_are_told_by_what_they_are_of_and_by_their_period() -> None:
    hidden = {"rhythm": {"gain_amplitude": 0.5, "period_h": 8.0, "peak_h": 1.0, "in_step": 1.0}}
    bursts = {"growth_bursts": {"period_h": 6.0, "share": 0.3}}

    def described(drive: str, period_h: float | None) -> dict[str, Any]:
        return {"described": {"drive": drive, "period_h": period_h}}

    judged = [
        outcome("outside", hidden, "unexplained", **described("gain", 8.4)),
        outcome("outside", hidden, "unexplained", **described("bias", 12.0)),
        outcome("outside", hidden, "nothing_wrong", described=None),
        outcome("outside", bursts, "unexplained", **described("growth", None)),
        outcome("outside", {"wall": {}}, "unexplained", **described("bias", 6.0)),
    ]
    (table,) = [one for one in all_tables(judged) if one.title == "Rhythms without a name"]
    assert table.rows == [
        ("growth and bending", "each its own", "1", "1", "0", "0", "-"),
        ("the answer to light", "in step", "3", "2", "1", "1", "5.0 %"),
    ]


def test_the_finders_words_become_the_worlds() -> None:
    sag = {"verdict": "explained", "causes": [cause("sag", parameters={"amplitude": 1.5, "softness_cm": 5.0})]}
    (one,) = claims(sag)
    assert (one.name, one.parameters["amplitude"]) == ("sag", pytest.approx(1.0))
    assert sag["causes"][0]["parameters"]["amplitude"] == 1.5
    assert claims({**sag, "verdict": "unexplained"}) == claims(None) == []


def test_the_summary_tells_each_aim_of_each_physics() -> None:
    two = SAG | {"draught": {"drive_per_cm_h": 0.1}}
    wall = {"wall": {"x_cm": 1.0}}
    judged = [
        outcome("single", SAG, "explained", cause("sag")),
        outcome("single", SAG, "nothing_wrong"),
        outcome("single", SAG, "unexplained", cause("sag"), form=1),
        *[outcome("none", {}, "nothing_wrong") for _ in range(8)],
        outcome("none", {}, "unexplained"),
        outcome("none", {}, "explained", cause("sag", 0.6)),
        outcome("pair", two, "explained", cause("draught"), cause("sag"), cause("camera_roll")),
        outcome("pair", two, "explained", cause("sag")),
        outcome("outside", wall, "unexplained"),
        outcome("outside", wall, "unexplained", cause("draught", 0.85)),
        outcome("outside", wall, "explained", cause("draught", 0.7)),
        outcome("outside", wall, None),
    ]
    assert [text.split(" (")[0] for text in cells(judged, "right cause first")] == ["50 %", "0 %"]
    assert cells(judged, "right of those claimed")[0].endswith("1 of 1")
    assert [text[-6:] for text in cells(judged, "right name, called unexplained")] == ["0 of 2", "1 of 1"]
    assert cells(judged, "false alarms")[0].endswith("2 of 10")
    assert cells(judged, "false alarms that name a cause")[0].endswith("1 of 10")
    assert cells(judged, "pairs: both named")[0].endswith("1 of 2")
    assert cells(judged, "pairs: at least one named")[0].endswith("2 of 2")
    assert cells(judged, "pairs: false names per case") == ["0.50"]
    assert cells(judged, "outside: unexplained")[0].endswith("2 of 4")
    assert cells(judged, "outside: confident wrong name")[0].endswith("1 of 4")
    assert cells(judged, "failed")[0].endswith("1 of 19")
    assert confusion(judged)["nothing", "nothing_wrong"] == 8
    assert confusion(judged)["wall", "failed"] == 1
    assert not any(true == "draught" for true, _ in confusion(judged))


def test_false_alarms_are_counted_by_world_where_worlds_are_shared() -> None:
    alarms = [(1, 0), (1, 0), (2, 0), (2, 1), (2, 0)]  # world, form
    loud = [outcome("none", {}, "explained", cause("sag"), seed=seed, form=form) for seed, form in alarms]
    calm = [outcome("none", {}, "nothing_wrong", seed=seed) for seed in (1, 3, 3)]
    assert cells([*loud, *calm], "worlds with a false alarm") == ["67 % (21-94), 2 of 3"]
    failed = outcome("none", {}, None, seed=9)
    assert cells([*loud, *calm, failed], "worlds with a false alarm")[0].endswith("2 of 4")
    alone = [outcome("none", {}, "explained", cause("sag"), seed=seed) for seed in range(3)]
    assert cells(alone, "worlds with a false alarm") == []
    assert cells(alone, "false alarms")[0].endswith("3 of 3")


def test_seconds_are_told_with_and_without_learning() -> None:
    def took(seconds: float, learned: bool) -> Outcome:
        return replace(outcome("none", {}, "nothing_wrong"), seconds=seconds, learned=learned)

    some = [took(90.0, True), took(20.0, False), took(40.0, False), took(22.0, False)]
    assert cells(some, "seconds per case, base learned in it") == ["90 median, 90 longest, 1 cases"]
    assert cells(some, "seconds per case, base given") == ["22 median, 40 longest, 3 cases"]
    assert cells(some[:1], "seconds per case, base given") == []


def test_tables_align_as_text_and_are_tables_in_markdown() -> None:
    tables = all_tables([outcome("single", SAG, "explained", cause("sag")), outcome("none", {}, "nothing_wrong")])
    text = as_text(tables).splitlines()
    at = text[1].index("physics")
    assert all(line[at - 1] == " " and line[at] != " " for line in text[3:6])
    page = as_markdown(tables)
    assert "| hidden | cases | said |\n| --- | --- | --- |\n| nothing | 1 | nothing_wrong 1 |" in page


def test_no_outcomes_make_no_table_but_its_head() -> None:
    assert all_tables([]) == []
