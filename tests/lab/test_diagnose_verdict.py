"""From evidence to words: confidences, what cannot be told apart, intervals, and whether something is left."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from diagnose_runs import LAW, known, run_of, scenes_of
from hypothesis import given, settings
from hypothesis import strategies as st

from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.explanation import Accepted, Explanation, Stage, Tried
from flora_lab.diagnose.hypothesis import Cause, Hypothesis
from flora_lab.diagnose.joint import Found, Joint
from flora_lab.diagnose.knowledge import blocks
from flora_lab.diagnose.scene import Scene
from flora_lab.diagnose.summary import nearest, summary
from flora_lab.diagnose.verdict import (
    LEAST_P,
    SUREST,
    Left,
    beside_a_knock,
    left_of,
    left_words,
    named,
    verdict_of,
)
from flora_lab.effects.catalogue import BY_NAME, CATALOGUE
from flora_lab.threads import one_blas_thread

SAGGING = [0.7, float(np.log(5.0)), float(np.log(0.05))]
"""Coordinates of a typical sag."""
NONE_LEFT, MUCH_LEFT = Left(share=1.0, p_value=0.8, explained=0.9), Left(share=3.0, p_value=1e-5, explained=0.1)


def found_of(name: str, coordinates: list[float], sd: float = 0.05, form: int = 0) -> Found:
    q = len(coordinates)
    return Found(
        Hypothesis((Cause(BY_NAME[name], form),)),
        np.array(coordinates),
        np.zeros((1, 9)),
        np.zeros((1, 2)),
        covariance=sd**2 * np.eye(q),
    )


def explanation_of(gains: dict[str, float], found: Found) -> Explanation:
    """As if causes with these gains had been tried, and the best had been taken."""
    null = Found(Hypothesis(), np.zeros(0), np.zeros((1, 9)), np.zeros((1, 2)))
    order = sorted(gains, key=lambda name: -gains[name])
    tried = [Tried(BY_NAME[name], gains[name], found if name == order[0] else null) for name in order]
    stage = Stage(null, tuple(tried))
    return Explanation(null, found, None, (stage,), (Accepted(stage.tried[0], stage),), Joint([], known().base))


def cause_of(gains: dict[str, float], name: str, coordinates: list[float], left: Left = NONE_LEFT, sd: float = 0.05):  # type: ignore[no-untyped-def]
    (cause,) = named(explanation_of(gains, found_of(name, coordinates, sd)), left)
    assert cause.effect == name
    return cause


@settings(deadline=None)
@given(
    st.dictionaries(
        st.sampled_from([e.name for e in CATALOGUE if e.name != "circumnutation"]),
        st.floats(-500.0, 5000.0),
        max_size=12,
    ),
    st.floats(6.0, 5000.0),
)
def test_confidences_are_probabilities(gains: dict[str, float], best: float) -> None:
    others = {name: min(gain, best - 1e-6) for name, gain in gains.items() if name != "sag"}
    cause = cause_of({"sag": best, **others}, "sag", SAGGING)
    assert 0.0 <= cause.confidence <= 1.0
    assert 0.0 <= cause.p_value <= 1.0
    assert cause.nats == round(best, 1)
    assert set(cause.confusable_with) <= set(others)
    assert "\n" not in cause.evidence
    assert "nan" not in cause.evidence
    assert cause.evidence.endswith(".")


def test_more_evidence_is_more_confidence() -> None:
    sure = [cause_of({"sag": gain, "draught": 1.0}, "sag", SAGGING).confidence for gain in (2.0, 12.0, 30.0, 300.0)]
    assert sure == sorted(sure)
    assert sure[0] < 0.9
    assert sure[-1] > 0.99
    p_values = [cause_of({"sag": gain, "draught": 1.0}, "sag", SAGGING).p_value for gain in (6.0, 12.0, 30.0)]
    assert p_values == sorted(p_values, reverse=True)
    assert p_values[0] == pytest.approx(2.0 * np.exp(-6.0))
    assert p_values[-1] == LEAST_P
    assert cause_of({"sag": 2000.0, "draught": 1.0}, "sag", SAGGING).confidence == SUREST


def test_of_as_much_evidence_a_later_cause_is_less_sure() -> None:
    """A first one has come to its claim; of later ones with some nats one in three is there."""
    whole = explanation_of({"sag": 6.0, "draught": -1.0, "adaptation": -2.0}, found_of("sag", SAGGING))
    first, later = named(replace(whole, accepted=2 * whole.accepted), NONE_LEFT)
    assert first.confidence > 0.9
    assert 0.2 < later.confidence < 0.6


def test_a_rival_takes_confidence_as_long_as_it_is_told_apart() -> None:
    alone = cause_of({"sag": 15.0}, "sag", SAGGING)
    rival = cause_of({"sag": 15.0, "draught": 9.5}, "sag", SAGGING)
    assert rival.confidence < alone.confidence
    assert rival.confusable_with == []
    near = cause_of({"sag": 15.0, "draught": 14.5}, "sag", SAGGING)
    assert near.confusable_with == ["draught"]
    assert near.confidence > rival.confidence  # it is one of the two
    assert "do not tell it from steady push to a side" in near.evidence


def test_what_no_light_tells_apart_is_named_with_it() -> None:
    """Even if the shape of a prior lies between them."""
    cause = cause_of({"clock_offset": 300.0, "phototropic_latency": 295.0, "sag": 20.0}, "clock_offset", [0.4])
    assert cause.confusable_with == ["phototropic_latency"]


def test_what_light_hardly_tells_apart_is_named_with_it_unless_it_is_far_behind() -> None:
    near = cause_of({"growth_rate": 30.0, "camera_scale": 23.0}, "growth_rate", [-0.4])
    assert near.confusable_with == ["camera_scale"]
    far = cause_of({"growth_rate": 30.0, "camera_scale": 20.0}, "growth_rate", [-0.4])
    assert far.confusable_with == []


def test_where_much_is_left_nothing_is_sure() -> None:
    gains = {"sag": 300.0, "draught": 1.0}
    sure, unsure = (cause_of(gains, "sag", SAGGING, left) for left in (NONE_LEFT, MUCH_LEFT))
    assert sure.confidence > 0.95
    assert unsure.confidence <= 0.5
    assert verdict_of([sure], NONE_LEFT) == "explained"
    assert verdict_of([unsure], MUCH_LEFT) == "unexplained"
    assert verdict_of([], NONE_LEFT) == "nothing_wrong"
    assert verdict_of([], MUCH_LEFT) == "unexplained"


def test_runs_in_which_something_was_knocked_are_not_told_as_if_nothing_was() -> None:
    cause = cause_of({"sag": 300.0}, "sag", SAGGING)
    assert verdict_of([], NONE_LEFT, is_knocked=True) == "unexplained"
    assert verdict_of([cause], NONE_LEFT, is_knocked=True) == "explained"
    told = summary([], NONE_LEFT, knocks=["run1 then", "run2 now"])
    assert told.startswith("Camera or pot was knocked: run1 then; run2 now. Beside that: Nothing is wrong")
    told = summary([cause], NONE_LEFT, knocks=["run1 then"])
    assert told.startswith("Camera or pot was knocked: run1 then. Beside that: Sagging")


def test_a_pot_that_was_tipped_is_not_told_as_a_rolled_camera_with_confidence() -> None:
    rolled, sagging = cause_of({"camera_roll": 30.0}, "camera_roll", [5.0]), cause_of({"sag": 300.0}, "sag", SAGGING)
    assert rolled.confidence > 0.9
    told, other = beside_a_knock([rolled, sagging])
    assert told.confidence == 0.3
    assert told.evidence.endswith("A pot that was tipped looks like that, too.")
    assert told.parameters == rolled.parameters
    assert other == sagging
    assert verdict_of([told], NONE_LEFT, is_knocked=True) == "unexplained"
    assert verdict_of([told, other], NONE_LEFT, is_knocked=True) == "explained"
    assert verdict_of([rolled], NONE_LEFT) == "explained"


@settings(deadline=None)
@given(st.sampled_from([e.name for e in CATALOGUE if e.name != "circumnutation"]), st.data(), st.floats(1e-6, 0.5))
def test_intervals_hold_the_value(name: str, data: st.DataObject, sd: float) -> None:
    coordinates = [
        data.draw(st.floats(-60.0, 60.0) if p.scale == "day" else st.floats(*p.reach)) for p in BY_NAME[name].parameters
    ]
    cause = cause_of({name: 50.0}, name, coordinates, sd=sd)
    assert set(cause.parameters) == set(cause.interval) == set(BY_NAME[name].names)
    for p in BY_NAME[name].parameters:
        low, high = cause.interval[p.name]
        assert low < cause.parameters[p.name] < high
        if p.scale == "day":
            assert 0.0 <= cause.parameters[p.name] <= 24.0
        narrower = cause_of({name: 50.0}, name, coordinates, sd=0.5 * sd).interval[p.name]
        assert low <= narrower[0] < narrower[1] <= high


def test_intervals_are_wider_than_the_likelihood_has_them() -> None:
    low, high = cause_of({"draught": 50.0}, "draught", [0.1], sd=0.01).interval["drive_per_cm_h"]
    assert high - low > 2.0 * 1.645 * 0.01
    low, high = cause_of({"draught": 50.0}, "draught", [0.1], sd=1e-6).interval["drive_per_cm_h"]
    assert high - low > 0.005  # the law is not the plant


def test_summaries_are_sentences() -> None:
    cause = cause_of({"sag": 30.0}, "sag", SAGGING)
    told = {summary(causes, left) for causes in ([], [cause]) for left in (NONE_LEFT, MUCH_LEFT)}
    assert len(told) == 4
    assert all(text.endswith(".") and "\n" not in text for text in told)
    assert any("Sagging" in text and "Something else is at work" in text for text in told)


@pytest.mark.parametrize(("factor", "alike"), [(2.5, []), (4.0, ["adaptation"])])
def test_a_cause_beyond_what_is_plausible_may_be_a_related_one(factor: float, alike: list[str]) -> None:
    gains = {"proprioception": 25.0, "adaptation": 15.0, "phototropic_gain": 12.5, "sag": 14.0}
    cause = cause_of(gains, "proprioception", [float(np.log(factor))])
    assert cause.confusable_with == alike


def test_causes_that_were_dropped_are_told() -> None:
    found = found_of("sag", [0.1, *SAGGING[1:]])
    kept, other = explanation_of({"sag": 30.0}, found), explanation_of({"draught": 40.0}, found)
    taken = (*other.stages, *kept.stages, *other.stages)
    explanation = replace(kept, stages=(*taken, *kept.stages))  # after the last one nothing was taken
    assert explanation.dropped == ("draught",)
    told = summary([cause_of({"sag": 30.0}, "sag", SAGGING)], NONE_LEFT, dropped=explanation.dropped)
    assert "Steady push to a side seemed to be there, and is not needed" in told


@pytest.mark.parametrize(("p_value", "says"), [(0.3, "no more than chance"), (0.02, "one set of healthy runs in 50")])
def test_runs_that_are_unusual_as_a_whole_are_not_said_to_be_usual(p_value: float, says: str) -> None:
    assert says in summary([], NONE_LEFT, p_value=p_value)


def test_what_comes_nearest_to_a_name_is_told_where_none_is_given() -> None:
    found = found_of("sag", [0.1, *SAGGING[1:]])
    named_one = explanation_of({"phototropic_gain": 1.8, "sag": 1.2}, found)
    none_named = replace(named_one, accepted=())
    text = nearest(none_named)
    assert "pull of the light" in text
    assert "6 times as probable" in text
    assert text.endswith("a name takes 20 times.")  # e^1.8, and e^3
    assert text in summary([], NONE_LEFT, text)
    assert text not in summary([], MUCH_LEFT, text)
    just_short = replace(explanation_of({"phototropic_gain": 2.99}, found), accepted=())
    assert nearest(just_short).endswith("20 times as probable as without; a name takes a little more.")
    assert nearest(named_one) == ""
    assert nearest(replace(explanation_of({"sag": 0.2, "draught": -3.0}, found), accepted=())) == ""


# What is left


@functools.cache
def explained(kick_cm: float) -> Explanation:
    """Two runs; in both something leans on the stem for four hours."""
    scenes = []
    for seed in (90, 91):
        run = run_of(seed)
        points = run.points_cm.copy()
        hour = run.time_s / 3600.0
        course = np.where((hour > 10.0) & (hour < 14.0), np.sin(np.pi * (hour - 10.0) / 4.0) ** 2, 0.0)
        points[:, :, 0] += kick_cm * course[:, None] * np.linspace(0.0, 1.0, 10) ** 2
        scenes.append(Scene(replace(run, points_cm=points), LAW))
    with one_blas_thread():
        return Explainer(scenes, known()).explain()


def test_a_kick_that_no_cause_explains_is_left_and_told() -> None:
    explanation = explained(1.0)
    left = left_of(explanation, known())
    assert left.is_much
    assert left.share > 1.5
    words = left_words(left, explanation, known())
    assert "plant9" in words
    assert "about 1" in words  # the hour
    assert "It shows most in" in words
    assert verdict_of(named(explanation, left), left) == "unexplained"


def test_of_healthy_runs_nothing_is_left() -> None:
    explanation = explained(0.0)
    left = left_of(explanation, known())
    assert not left.is_much
    assert 0.0 < left.p_value <= 1.0
    assert left.share == pytest.approx(1.0, abs=0.5)
    assert left_words(left, explanation, known()) == ""


def test_a_little_is_left_of_a_strong_effect() -> None:
    """No term is quite what nature does."""
    assert not replace(MUCH_LEFT, explained=0.99).is_much
    assert not replace(NONE_LEFT, explained=0.0).is_much
    assert MUCH_LEFT.is_much


def test_left_is_what_reference_runs_would_hardly_leave() -> None:
    explanation = explained(0.0)
    p_values = []
    for times in (1.0, 1.5, 3.0):
        found = replace(explanation.found, residuals=[times * r for r in explanation.found.residuals])
        p_values.append(left_of(replace(explanation, found=found), known()).p_value)
    assert p_values == sorted(p_values, reverse=True)
    assert p_values[-1] < 1e-3
    usual = np.mean([blocks(r)[0] for r in explanation.found.residuals])
    assert 0.2 < usual < 2.0
    assert len(scenes_of((90, 91))) == len(explanation.found.residuals)
