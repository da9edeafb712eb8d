"""From runs to causes: the search, one cause after another, and nothing where nothing is."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from diagnose_runs import change_of, known, run_of, scenes_of, shorter, turns, warm_course

from flora_lab.diagnose import claims, explain, rhythm, search, trials
from flora_lab.diagnose.clocks import left_out
from flora_lab.diagnose.courses import COURSES
from flora_lab.diagnose.explain import MOST_CAUSES, Explainer
from flora_lab.diagnose.explanation import FIRST, SECOND, THIRD, Accepted, Explanation, Stage, Tried
from flora_lab.diagnose.hypothesis import Hypothesis
from flora_lab.diagnose.joint import Found, Joint, evidence_for_last
from flora_lab.diagnose.nameless import Unnamed
from flora_lab.diagnose.rivals import last_choice, rivals
from flora_lab.diagnose.trials import Trials
from flora_lab.diagnose.verdict import left_of, named, verdict_of
from flora_lab.effects.catalogue import BY_NAME, CATALOGUE
from flora_lab.effects.effect import Effect
from flora_lab.threads import one_blas_thread

Effects = Mapping[str, Mapping[str, float]]

NOTHING: Effects = {}
LATE: Effects = {"clock_offset": {"offset_h": -0.7}}
SLOW: Effects = {"phototropic_latency": {"delay_h": 0.6}}
UNEQUAL: Effects = {"lamp_asymmetry": {"right_to_left": 0.5}}
BOTH: Effects = {"clock_offset": {"offset_h": -0.5}, "draught": {"drive_per_cm_h": 0.12}}


@functools.cache
def explained(which: str, seeds: tuple[int, ...] = (80, 81)) -> Explanation:
    effects = {"nothing": NOTHING, "late": LATE, "slow": SLOW, "unequal": UNEQUAL, "both": BOTH}[which]
    with one_blas_thread():
        return Explainer(scenes_of(seeds, effects), known()).explain()


def names(explanation: Explanation) -> tuple[str, ...]:
    return explanation.found.hypothesis.names()


def test_what_was_hidden_is_named() -> None:
    assert names(explained("late")) == ("clock_offset",)
    assert explained("late").found.values()[0]["offset_h"] == pytest.approx(-0.7, abs=0.15)
    assert names(explained("unequal")) == ("lamp_asymmetry",)
    assert explained("unequal").found.values()[0]["right_to_left"] == pytest.approx(0.5, rel=0.3)


@pytest.mark.slow
def test_a_lamp_that_changes_after_the_record_ends_is_taken_for_nothing_else() -> None:
    """After two days the clock is two hours behind, and the plants saw a change that no record tells of."""
    light = turns(52.0, 48.2 / 8)
    change = change_of({"clock_skew": {"per_hour": -0.05}})
    scenes = [shorter(run_of(seed, light=light, change=change), 48.0) for seed in (80, 81)]
    whole = [scene.size for scene in scenes]
    with one_blas_thread():
        explainer = Explainer(scenes, known())
        explanation = explainer.explain()
    left = left_of(explanation, known())
    assert names(explanation) == ("clock_skew",)
    assert explanation.found.values()[0]["per_hour"] == pytest.approx(-0.05, abs=0.003)
    assert verdict_of(named(explanation, left), left) == "explained"
    assert all(scene.size < size for scene, size in zip(explainer.scenes, whole, strict=True))
    assert all(44.0 < scene.time_h[scene.window].max() < 45.8 for scene in explainer.scenes)
    assert [scene.size for scene in scenes] == whole
    told = left_out(scenes, explainer.scenes)
    assert len(told) == len(scenes)
    assert told[0].startswith("plant80: the plant's last 2 h are not compared")
    assert left_out(scenes, scenes) == []


@pytest.mark.parametrize("which", ["late", "slow", "unequal", "both"])
def test_what_has_a_name_leaves_nothing_without_one(which: str) -> None:
    assert explained(which).unnamed is None


def test_two_hidden_effects_are_named_both() -> None:
    explanation = explained("both")
    assert set(names(explanation)) == {"clock_offset", "draught"}
    assert [one.tried.effect.name for one in explanation.accepted] == list(names(explanation))
    causes = named(explanation, left_of(explanation, known()))
    assert {cause.effect for cause in causes} == set(names(explanation))


@pytest.mark.slow
def test_a_cause_that_comes_to_nothing_gives_back_what_it_made_worthless(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the second cause the first seems not to be needed; weighed again, the second is next to nothing."""
    real = Explainer._with_the_best

    def displaced(self: Explainer, joint: Joint, found: Found, accepted: list[Accepted]) -> Found:
        accepted[:] = accepted[-1:]
        return found

    def second_vanishes(self: Explainer, reached: explain._Reached, stage: Stage) -> explain._Reached | Stage:
        with monkeypatch.context() as patch:
            patch.setattr(Explainer, "_pruned", displaced)
            if reached.accepted:
                patch.setattr(trials, "_is_worth_a_name", lambda fit: False)
            return real(self, reached, stage)

    monkeypatch.setattr(Explainer, "_with_the_best", second_vanishes)
    with one_blas_thread():
        explanation = Explainer(scenes_of((80, 81), BOTH), known()).explain()
    assert len(explanation.stages) == 2
    assert [one.tried.effect.name for one in explanation.accepted] == list(names(explanation))
    assert len(names(explanation)) == 1
    assert explanation.dropped == ()


def test_a_cause_must_be_worth_its_claim_about_the_plants_that_have_it_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chance answers about other plants than those without the cause; there it has a tenth of a nat too little."""
    real = Explainer._with_the_best
    weighed: list[float] = []
    asked: list[float] = []

    def about_itself(self: Explainer, reached: explain._Reached, stage: Stage) -> explain._Reached | Stage:
        with monkeypatch.context() as patch:
            asked.append(self.claims.first + BY_NAME["lamp_asymmetry"].first_needs)
            patch.setattr(trials, "evidence_for_last", lambda before, fit: asked[0] + weighed[-1])
            return real(self, reached, stage)

    monkeypatch.setattr(Explainer, "_with_the_best", about_itself)
    for besides, expected in ((0.1, ("lamp_asymmetry",)), (-0.1, ())):
        weighed.append(besides)
        with one_blas_thread():
            explanation = Explainer(scenes_of((80, 81), UNEQUAL), known()).explain()
        assert names(explanation) == expected
        assert [one.tried.effect.name for one in explanation.accepted] == list(expected)
        (told,) = [one.gain for one in explanation.stages[0].tried if one.effect.name == "lamp_asymmetry"]
        assert expected or told == pytest.approx(asked[0] - 0.1), "and that is what speaks for it"


def test_a_late_answer_is_named_with_the_clock_that_may_be_wrong() -> None:
    explanation = explained("slow")
    (cause,) = named(explanation, left_of(explanation, known()))
    assert {cause.effect, *cause.confusable_with} >= {"phototropic_latency", "clock_offset"}
    assert "These runs do not tell it from" in cause.evidence
    assert next(iter(cause.parameters.values())) == pytest.approx(0.6, abs=0.15)


def test_where_nothing_is_hidden_nothing_is_named() -> None:
    claims = 0
    for seeds in ((90, 91), (92, 93), (94, 95)):
        explanation = explained("nothing", seeds)
        claims += bool(explanation.accepted) + (explanation.unnamed is not None)
        if not explanation.accepted:
            assert explanation.found.hypothesis.causes == ()
            assert explanation.swing is None
            assert (
                verdict_of(named(explanation, left_of(explanation, known())), left_of(explanation, known()))
                != "explained"
            )
    assert claims <= 1


def test_beside_a_cause_a_second_one_needs_less_than_the_first() -> None:
    explainer = Explainer(scenes_of((80,)), known())
    explanation = explained("late")
    late, stage = explanation.accepted, explanation.stages[0]  # a clock has no form that could be wrong
    assert explainer._needed(stage, ()) == explainer.claims.first
    assert explainer._needed(stage, late) == explainer.claims.causes[1] < FIRST <= explainer.claims.first
    assert explainer._needed(stage, (*late, *late)) == explainer.claims.causes[2]


@pytest.mark.parametrize(
    ("gains", "besides"),
    [
        ({"growth_rate": 5.0, "camera_roll": 1.0}, 0.0),
        ({"growth_rate": 5.0, "camera_roll": 4.5}, 4.0),  # it may be the other one
        ({"camera_roll": 5.0, "growth_rate": 4.5}, 4.0),
        ({"proprioception": 5.0, "growth_rate": 1.0}, 4.0),
        ({"stiffening": 5.0, "growth_rate": 1.0}, 1.0),
        ({"phototropic_gain": 2.0, "growth_rate": 0.5}, -1.2),  # no healthy plant looks like it
        ({"phototropic_gain": 2.0, "growth_rate": 1.5}, 0.0),
    ],
)
def test_what_plants_of_another_law_look_like_needs_more_to_be_named_first(
    gains: dict[str, float], besides: float
) -> None:
    explainer, explanation = Explainer(scenes_of((80,)), known()), explained("late")
    tried = tuple(Tried(BY_NAME[name], gain, None) for name, gain in gains.items())
    stage = replace(explanation.stages[0], tried=tried)
    assert explainer._needed(stage, ()) == explainer.claims.first + besides
    assert explainer._needed(stage, explanation.accepted) == explainer.claims.causes[1]


def test_what_is_too_little_to_be_told_hides_no_cause_with_plain_evidence() -> None:
    explainer = Explainer(scenes_of((80,)), known())
    (late,) = explained("late").accepted
    nameless = Unnamed("gain", COURSES[0], 40.0 + explainer.claims.nameless, np.array([-0.3]))
    clear, weak = (replace(late.tried, gain=gain + explainer.claims.nameless) for gain in (1.0, -1.0))
    strong = Accepted(replace(late.tried, gain=10.0 * nameless.gain), late.stage)
    for best, beside, is_outdone in ((clear, (), True), (clear, (strong,), False), (weak, (strong,), True)):
        stage = Stage(late.stage.before, (best,), nameless)
        assert explainer._is_outdone(stage, beside) == is_outdone


@pytest.mark.parametrize(("is_a_swing", "is_told"), [(False, False), (True, True)])
def test_beside_a_swing_more_is_told_than_beside_a_cause_of_as_much_evidence(is_a_swing: bool, is_told: bool) -> None:
    """Growth in bursts has sharp edges that swing; what is left in the hours' means is not the swing's."""
    explainer = Explainer(scenes_of((80,)), known())
    (late,) = explained("late").accepted
    swing = rhythm.Swing(2.0, 0.5, 6.0, 4500.0, (1.9, 2.1), (0.4, 0.6)) if is_a_swing else None
    strong = Accepted(replace(late.tried, gain=4500.0, swing=swing), late.stage)
    nameless = Unnamed("gain", COURSES[0], 285.0, np.array([-0.3]))
    stage = Stage(late.stage.before, (replace(late.tried, gain=1.0),), nameless)
    assert (explainer._beside(stage, (strong,)) is nameless) == is_told


@pytest.mark.parametrize(("of_a_cause", "is_told"), [(1.5, True), (2.5, False)])
def test_what_has_no_name_needs_less_where_no_cause_comes_to_anything(of_a_cause: float, is_told: bool) -> None:
    explainer = Explainer(scenes_of((80,)), known())
    (late,) = explained("late").accepted
    middle = 0.5 * (explainer.claims.nameless + explainer.claims.nameless_alone)
    nameless = Unnamed("bias", COURSES[0], middle, np.array([-0.03]))
    stage = Stage(late.stage.before, (replace(late.tried, gain=of_a_cause),), nameless)
    assert (explainer._beside(stage, ()) is nameless) == is_told


@pytest.mark.parametrize(("runs", "is_outdone"), [(1, True), (3, True), (4, True), (9, False)])
def test_with_more_runs_more_is_asked_of_what_has_no_name(runs: int, is_outdone: bool) -> None:
    explainer = Explainer(list(scenes_of((80,))) * runs, known())
    (late,) = explained("late").accepted
    best = replace(late.tried, gain=100.0)
    nameless = Unnamed("gain", COURSES[0], best.gain + 9.0, np.array([-0.3]))
    assert explainer._is_outdone(Stage(late.stage.before, (best,), nameless), ()) == is_outdone


def test_one_run_will_do() -> None:
    explanation = explained("late", (80,))
    assert names(explanation) == ("clock_offset",)
    assert explanation.found.traits.shape == (1, 9)


@pytest.mark.parametrize("which", ["nothing", "late", "both"])
def test_an_explanation_holds_together(which: str) -> None:
    explanation = explained(which)
    assert 1 <= len(explanation.stages) <= MOST_CAUSES + 1
    assert len(explanation.accepted) <= MOST_CAUSES
    assert explanation.null.hypothesis.causes == ()
    assert len(explanation.found.residuals) == len(explanation.joint.runs) == 2
    for stage in explanation.stages:
        there = set(stage.before.hypothesis.names())
        told = [tried.effect.name for tried in stage.tried]
        assert len(set(told)) == len(told)
        assert not there & set(told)
        slow = [tried for tried in stage.tried if tried.swing is None]
        assert [t.gain for t in slow] == sorted((t.gain for t in slow), reverse=True)
        assert set(told) >= {e.name for e in CATALOGUE if e.forms} - there - {"circumnutation", "temperature_growth"}
        assert "temperature_growth" not in told  # nobody told how warm it was
        best = slow[0].found
        assert best is not None
        assert best.jacobians  # the best one is no guess
        assert best.hypothesis.names() == (*stage.before.hypothesis.names(), slow[0].effect.name)
    for one in explanation.accepted:
        assert one.tried is one.stage.tried[0]
        assert one.tried.gain >= (FIRST if one is explanation.accepted[0] else SECOND)


def test_temperature_is_looked_at_where_it_is_told() -> None:
    with one_blas_thread():
        scenes = scenes_of((80, 81), {"temperature_growth": {"per_degree": 0.12}}, warm_c=warm_course(24.0))
        explanation = Explainer(scenes, known()).explain()
    assert "temperature_growth" in {tried.effect.name for tried in explanation.stages[0].tried}
    assert names(explanation) == ("temperature_growth",)


def test_a_swing_of_the_tip_is_named() -> None:
    with one_blas_thread():
        explanation = Explainer(scenes_of((82, 83), swing=(1.7, 0.8)), known()).explain()
    assert explanation.swing is not None
    assert explanation.swing.period_h == pytest.approx(1.7, rel=0.05)
    assert explanation.swing.amplitude_cm == pytest.approx(0.8, rel=0.25)
    assert [one.tried.effect.name for one in explanation.accepted] == ["circumnutation"]
    (cause,) = named(explanation, left_of(explanation, known()))
    assert cause.effect == "circumnutation"
    for name, (low, high) in cause.interval.items():
        assert low <= cause.parameters[name] <= high


@pytest.mark.slow
def test_what_hours_keep_of_a_slow_swing_is_not_something_else(monkeypatch: pytest.MonkeyPatch) -> None:
    with one_blas_thread():
        explainer = Explainer(scenes_of((82,), swing=(2.4, 0.8)), known())
        stage = explainer.explain().stages[0]
        assert stage.tried[0].swing is not None
        assert stage.has_no_name(explainer.claims.nameless, explainer.claims.better) is False
        # As if what is left in the hours' means spoke for it more than the swing does for itself.
        monkeypatch.setattr(explainer.trials, "claims", replace(explainer.claims, better=-1e6))
        again = explainer.explain()
    assert [one.tried.effect.name for one in again.accepted] == ["circumnutation"]
    assert again.unnamed is None


def test_the_order_of_runs_does_not_matter() -> None:
    there, back = explained("late"), explained("late", (81, 80))
    assert names(there) == names(back)
    assert back.found.coordinates == pytest.approx(there.found.coordinates, abs=0.02)
    assert back.found.evidence == pytest.approx(there.found.evidence, abs=1.0)


def test_the_same_runs_are_explained_by_the_same_to_the_bit() -> None:
    there = explained("late")
    back = explained.__wrapped__("late")
    assert there.found.coordinates.tobytes() == back.found.coordinates.tobytes()
    assert there.found.evidence == back.found.evidence


def test_what_else_might_be_is_kept() -> None:
    explanation = explained("late")
    stage = last_choice(explanation)
    assert stage is not None
    assert stage.tried[0] is explanation.accepted[-1].tried
    others = rivals(explanation)
    assert "clock_offset" not in {tried.effect.name for tried in others}
    assert all(tried.found is not None for tried in others)
    nothing = replace(explanation, accepted=())
    assert last_choice(nothing) is None
    assert rivals(nothing) == []


# The look at each cause


def test_the_most_promising_are_fitted_in_full() -> None:
    explanation = explained("unequal")
    null = explanation.stages[0].before
    effects = [BY_NAME[name] for name in ("lamp_asymmetry", "growth_rate", "camera_scale")]
    fits = {effect.name: fit for effect, fit in search.best_of_each(explanation.joint, null, effects)}
    assert set(fits) == {effect.name for effect in effects}
    assert fits["lamp_asymmetry"].evidence == max(fit.evidence for fit in fits.values())
    assert fits["lamp_asymmetry"].jacobians
    assert np.isfinite([fit.evidence for fit in fits.values()]).all()


def test_every_form_and_every_start_is_looked_at() -> None:
    assert [cause.form for cause in search.forms_of(BY_NAME["diurnal_growth"])] == [0, 1, 2]
    starts = list(search._starts(BY_NAME["diurnal_growth"].parameters))
    assert {float(start[1]) for start in starts} == {3.0, 9.0, 15.0, 21.0}
    hours = {round(float(np.exp(start[0])), 6) for start in search._starts(BY_NAME["adaptation"].parameters)}
    assert hours == {0.8, 1.6, 3.2}


def test_what_is_too_small_has_no_name_however_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    late = ("phototropic_latency", "clock_offset")
    assert names(explained("slow")) == (late[0],)
    less = [replace(e, parameters=(replace(e.parameters[0], least=1.0),)) if e.name in late else e for e in CATALOGUE]
    monkeypatch.setattr(trials, "CATALOGUE", tuple(less))
    with one_blas_thread():
        explanation = Explainer(scenes_of((80, 81), SLOW), known()).explain()
    tried = {one.effect.name: one for one in explanation.stages[0].tried}
    for name in late:
        fit = tried[name].found
        assert fit is not None
        assert evidence_for_last(explanation.stages[0].before, fit) > THIRD
        assert tried[name].gain <= 0.0
    assert not set(names(explanation)) & set(late)


def test_as_much_is_asked_of_another_constant_of_the_plant_as_of_any_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    of_constants = {effect.name for effect in CATALOGUE if effect.forms and effect.is_of_constants}
    assert of_constants == {"growth_rate", "stiffening", "gravitropism", "proprioception", "phototropic_gain"}
    monkeypatch.setattr(claims, "FIRST", 1000.0)
    slow: Effects = {"growth_rate": {"factor": 0.45}}
    with one_blas_thread():
        grown, unequal = (Explainer(scenes_of((80, 81), hidden), known()).explain() for hidden in (slow, UNEQUAL))
    for explanation, first in ((grown, "growth_rate"), (unequal, "lamp_asymmetry")):
        assert explanation.stages[0].tried[0].effect.name == first
        assert FIRST < explanation.stages[0].tried[0].gain < 1000.0
        assert names(explanation) == ()


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_what_is_worth_a_name_is_less_than_what_is_looked_for(effect: Effect) -> None:
    for p in effect.parameters:
        assert all(p.is_worth_a_name(value) for value in p.starts)
        assert p.is_worth_a_name(p.high) or p.high == p.none
        assert p.none is None or not p.is_worth_a_name(p.none)
        if p.least:
            assert p.none is not None
            assert 0.0 < p.least < 0.5 * max(abs(value - p.none) for value in p.starts)


def test_plants_are_looked_for_again_where_the_best_fit_found_them() -> None:
    """Though its cause came to nothing, since it was the plants that it found."""

    class Still:
        @staticmethod
        def fit(start: Found) -> Found:
            return start

    def fit(evidence: float, traits: float, *, is_full: bool = True) -> Found:
        found = Found(Hypothesis(), np.zeros(0), np.full((1, 9), traits), np.zeros((1, 2)), evidence=evidence)
        return replace(found, jacobians=[np.zeros((1, 11))]) if is_full else found

    named = Tried(BY_NAME["draught"], 50.0, fit(-100.0, 1.0))
    plants = Tried(BY_NAME["lamp_ageing"], 0.0, fit(-20.0, 2.0))
    looked_at = Tried(BY_NAME["adaptation"], 0.0, fit(-10.0, 3.0, is_full=False))
    stage = Stage(fit(-150.0, 0.0), (named, plants, looked_at))
    again = Trials._restarted(cast("Joint", Still()), stage)
    assert (again.traits == 2.0).all()
    assert again.hypothesis.names() == ()
