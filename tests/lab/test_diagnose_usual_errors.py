"""How much of every effect healthy runs seem to show, and that evidence is what goes beyond it."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
import pytest
from diagnose_runs import REFERENCE, TYPICAL, change_of, known, scene_of

from flora_lab.diagnose import chance, learn, usual_errors
from flora_lab.diagnose.hypothesis import Cause
from flora_lab.diagnose.joint import Joint, ready
from flora_lab.diagnose.knowledge import Knowledge, known_of
from flora_lab.diagnose.scene import Lanes
from flora_lab.diagnose.usual_errors import (
    UsualErrors,
    causes,
    columns,
    directions,
    effects,
    expected_means,
    expected_sizes,
    strength_of,
)
from flora_lab.effects.catalogue import BY_NAME
from flora_lab.effects.effect import Change, Effect
from flora_lab.effects.law_forms import FORMS
from flora_lab.simulator.terms import APICAL, BRIGHTNESS_MORE, SIGNAL_H_PER_CM
from flora_lab.threads import one_blas_thread

DRAUGHTS = np.array([0.5, -1.0, 1.0, 2.0, -0.5, -2.0, 1.5, -1.5, 0.0]) * 0.03
"""Of nine reference runs; about nothing on the mean."""


def told_by(changes: Sequence[Change]) -> Knowledge:
    """What reference runs tell to each of which something happened; they are not tried on each other."""
    with one_blas_thread():
        scenes = [scene_of(seed, change=change) for seed, change in zip(REFERENCE, changes, strict=True)]
        return known_of(scenes, learn.learned(scenes), ())


@functools.cache
def draughty() -> Knowledge:
    """Every reference run is pushed to a side a little, each to its own."""
    return told_by([change_of({"draught": {"drive_per_cm_h": float(push)}}) for push in DRAUGHTS])


def at(name: str) -> int:
    return causes().index(name)


def errors_of(sizes: np.ndarray, runs: int = 9) -> UsualErrors:
    doubt = np.diag(np.repeat(sizes, columns()) ** 2) / runs
    return UsualErrors(sizes, np.zeros(len(doubt)), doubt)


def evidence_for(name: str, seeds: tuple[int, ...], knowledge: Knowledge, pushed: dict[str, float]) -> float:
    """Nats for a cause in some runs that have it, beside what healthy runs show, about the plants that they are."""
    scenes = [scene_of(seed, change=change_of({name: pushed})) for seed in seeds]
    base, traits = knowledge.base, np.repeat(knowledge.base.mean[None], len(seeds), axis=0)
    none = np.array([p.centre for p in BY_NAME[name].parameters])
    gain = np.nan
    for _ in range(2):
        runs = []
        for scene, own in zip(scenes, traits, strict=True):
            shift, besides = knowledge.errors.of_run(scene, own, Change())
            parts = chance.covariances(scene, scene.answers(own, Change()))
            runs.append(ready(scene, base, parts, together=len(scenes), besides=besides, shift=shift))
        joint = Joint(runs, base)
        null = joint.fit(joint.null(), 12)
        fit = joint.fit(joint.screened(null, Cause(BY_NAME[name]), none), 10)
        gain, traits = fit.evidence - null.evidence, null.traits
    return gain


def test_what_plants_differ_in_anyway_is_not_counted_twice() -> None:
    assert not {"gravitropism", "growth_rate", "stiffening", "proprioception", "phototropic_gain"} & set(causes())
    assert {"draught", "lamp_asymmetry", "camera_roll", "clock_offset", "adaptation", "sag"} < set(causes())
    assert known().errors.sizes.shape == expected_sizes().shape == (len(causes()),)
    assert (known().errors.sizes > 0.0).all()
    assert known().errors.mean.shape == (sum(columns()),)
    assert (known().errors.whole() >= known().errors.sizes).all()


@pytest.mark.parametrize("effect", effects(), ids=causes())
def test_a_push_is_the_effect_itself_as_long_as_it_is_small(effect: Effect) -> None:
    scene = scene_of(1, warm_c=np.linspace(20.0, 26.0, 288))
    if effect.name == "signal_more":  # where each place senses light for itself no signal is sent
        apical = Change()
        apical.terms[[APICAL, SIGNAL_H_PER_CM]] = 1.0, 0.4
        scene = scene.under(apical)
    own, kinds = strength_of(effect), directions(scene, TYPICAL, Change())[at(effect.name)]
    values = {p.name: p.value(p.centre) for p in effect.parameters}
    p = effect.parameters[own]
    size = 0.05 * p.spread * (-1.0 if p.none == p.high else 1.0)
    # The first kind is the first that a search would set out from.
    values |= {q.name: q.starts[0] for q in effect.parameters if q.none is None and q.starts}
    values[p.name] = p.value(p.centre + size)
    change = Change()
    effect.forms[0](change, values)
    told = scene.simulated(Lanes(np.repeat(TYPICAL[None], 2, axis=0), np.zeros((2, 2)), [change, Change()]))
    expected = size * np.sqrt(kinds.shape[1]) * kinds[:, 0]
    assert np.abs(expected).max() > 1e-4
    assert np.abs(told[0] - told[1] - expected).max() < 0.15 * np.abs(expected).max()


def test_pushes_act_beside_causes_that_are_there() -> None:
    scene, draught = scene_of(1), change_of({"draught": {"drive_per_cm_h": 0.2}})
    alone, beside = (directions(scene, TYPICAL, change)[at("lamp_asymmetry")] for change in (Change(), draught))
    assert np.abs(alone - beside).max() > 1e-3 * np.abs(alone).max()
    assert (draught.terms == change_of({"draught": {"drive_per_cm_h": 0.2}}).terms).all()


def test_what_healthy_runs_scatter_by_is_found() -> None:
    assert draughty().errors.sizes[at("draught")] == pytest.approx(DRAUGHTS.std(ddof=1), rel=0.5)
    assert known().errors.sizes[at("draught")] < 0.35 * DRAUGHTS.std(ddof=1)


def test_what_two_effects_explain_alike_is_counted_once() -> None:
    """A push to a side looks like an uneven lamp; it is not taken for both."""
    share = draughty().errors.sizes / expected_sizes()
    assert share[at("draught")] > 2.0 * share[at("lamp_asymmetry")]
    assert share[at("draught")] > 2.0 * share[at("camera_roll")]


def test_evidence_is_what_goes_beyond_healthy_runs() -> None:
    push = {"drive_per_cm_h": 0.03}
    news, usual = (evidence_for("draught", (30, 31, 32), one, push) for one in (known(), draughty()))
    assert news > 12.0
    assert usual < 3.0
    strong = evidence_for("draught", (30, 31, 32), draughty(), {"drive_per_cm_h": 0.25})
    assert strong > 6.0


def test_what_happened_to_few_runs_by_chance_is_not_known_of_all() -> None:
    """The mean is known less well than runs scatter about it: to each something else happens besides."""
    errors = known().errors
    assert (np.diag(errors.doubt) > np.repeat(errors.sizes, columns()) ** 2 / known().base.runs).all()
    assert np.linalg.eigvalsh(errors.doubt)[0] > 0.0
    scene = scene_of(1)
    one, many = (errors.of_run(scene, TYPICAL, Change(), together)[1] for together in (1, 9))
    along = np.concatenate(directions(scene, TYPICAL, Change()), axis=1)
    assert many - one == pytest.approx(8.0 * along @ errors.doubt @ along.T)


def test_what_all_healthy_runs_show_is_no_news() -> None:
    """Every one of them is pushed to the same side."""
    push = {"draught": {"drive_per_cm_h": 0.04}}
    usual = told_by([change_of(push)] * len(REFERENCE))
    assert evidence_for("draught", (30, 31, 32), usual, push["draught"]) < 3.0
    assert evidence_for("draught", (30, 31, 32), usual, {"drive_per_cm_h": -0.12}) > 6.0


def test_the_form_of_the_law_is_learned_from_healthy_runs() -> None:
    """Their light pulls more steeply than the law says; that is told, once for all plants, and is no effect."""
    steeper = Change()
    steeper.terms[BRIGHTNESS_MORE] = 0.4
    usual = told_by([steeper] * len(REFERENCE))
    form = sum(columns()[: at("brightness_more")])
    assert abs(known().errors.mean[form]) < 0.12
    assert 0.2 < usual.errors.mean[form] < 0.6
    assert usual.errors.sizes[at("brightness_more")] < 0.1


def test_forms_of_the_law_may_be_others_in_all_plants_and_differ_little_between_them() -> None:
    wide = expected_means() / expected_sizes()
    assert {name: round(float(ratio), 6) for name, ratio in zip(causes(), wide, strict=True) if ratio != 1.0} == {
        form.name: 5.0 for form in FORMS
    }


def test_how_much_worse_the_law_is_than_expected() -> None:
    assert errors_of(expected_sizes()).beyond_expected == 0.0
    assert errors_of(2.0 * expected_sizes()).beyond_expected == pytest.approx(np.log(2.0))
    assert known().errors.beyond_expected < draughty().errors.beyond_expected


def test_fewer_healthy_runs_tell_less_of_it() -> None:
    scene, sizes = scene_of(2), known().errors.sizes
    (none, many), (_, few) = (errors_of(sizes, runs).of_run(scene, TYPICAL, Change()) for runs in (9, 1))
    assert np.trace(few) > 1.5 * np.trace(many)
    assert np.linalg.eigvalsh(many)[0] > -1e-9 * np.trace(many)
    assert np.abs(none).max() == 0.0


def test_runs_without_temperature_say_nothing_of_it() -> None:
    scene = scene_of(3)
    assert np.abs(directions(scene, TYPICAL, Change())[at("temperature_growth")]).max() == 0.0
    assert usual_errors.expected_sizes()[at("temperature_growth")] == pytest.approx(
        known().errors.sizes[at("temperature_growth")], rel=1e-4
    )
