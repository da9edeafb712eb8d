"""Several runs under one hypothesis: hidden effects come back with their size, and none is seen where there is none."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from diagnose_runs import CHANCE, TYPICAL, base, change_of, individual, scene_of, scenes_of, warm_course

from flora_lab.diagnose import chance, search
from flora_lab.diagnose.chance import MEASURED, PARTS
from flora_lab.diagnose.explanation import FIRST, THIRD
from flora_lab.diagnose.hypothesis import Cause, Hypothesis
from flora_lab.diagnose.joint import Base, Found, Joint, Ready, ready
from flora_lab.diagnose.scene import START_SD, Scene
from flora_lab.diagnose.usual_errors import strength_of
from flora_lab.effects.catalogue import BY_NAME, CATALOGUE
from flora_lab.effects.effect import Change
from flora_lab.simulator.tropism_traits import NAMES

Hidden = tuple[str, dict[str, float]]

CALM = {name: 0.25 * size for name, size in CHANCE.items()}
HIDDEN: list[Hidden] = [
    ("lamp_asymmetry", {"right_to_left": 0.6}),
    ("draught", {"drive_per_cm_h": -0.06}),
    ("phototropic_latency", {"delay_h": 0.5}),
    ("clock_offset", {"offset_h": -0.6}),
    ("clock_skew", {"per_hour": 0.03}),
    ("camera_drift", {"angle_deg": 8.0}),
    ("camera_scale", {"factor": 1.2}),
    ("growth_rate", {"factor": 0.45}),
    ("gravitropism", {"factor": 2.6}),
    ("phototropic_gain", {"factor": 0.45}),
    ("sag", {"amplitude": 2.0}),
    ("adaptation", {"time_constant_h": 1.5, "floor": 0.3}),
    ("time_scale", {"factor": 3.0}),
    ("temperature_growth", {"per_degree": 0.12}),
]


def of_scenes(scenes: list[Scene], known: Base) -> Joint:
    runs = []
    for scene in scenes:
        parts = chance.covariances(scene, scene.answers(known.mean, Change()))
        runs.append(ready(scene, known, parts, together=len(scenes)))
    return Joint(runs, known)


@functools.cache
def nominal(first: int, count: int = 2) -> tuple[Joint, Found]:
    joint = of_scenes(scenes_of(range(first, first + count)), base())
    return joint, joint.fit(joint.null(), 12)


def alone(joint: Joint, null: Found, name: str, form: int = 0) -> Found:
    """The best fit with one effect."""
    return joint.fit(search.best_start(joint, null, Cause(BY_NAME[name], form)), 12)


@pytest.mark.parametrize(("name", "values"), HIDDEN, ids=[name for name, _ in HIDDEN])
def test_what_was_hidden_comes_back(name: str, values: dict[str, float]) -> None:
    warm_c = warm_course(24.0) if name == "temperature_growth" else None
    joint = of_scenes(scenes_of((41, 42), {name: values}, warm_c=warm_c, chance=CALM), base())
    null = joint.fit(joint.null(), 12)
    found = alone(joint, null, name)
    assert found.evidence - null.evidence > 3.0
    effect = BY_NAME[name]
    strong = strength_of(effect)
    p = effect.parameters[strong]
    sd = float(np.sqrt(found.covariance[strong, strong]))
    truth = p.coordinate(values[p.name])
    assert abs(found.coordinates[strong] - truth) < 3.0 * sd + 0.1 * abs(truth - p.centre)
    assert sd < 0.5 * p.spread
    (told,) = found.values()
    assert told == {one.name: one.value(u) for one, u in zip(effect.parameters, found.coordinates, strict=True)}


def test_two_effects_come_back_together() -> None:
    hidden = {"lamp_asymmetry": {"right_to_left": 0.6}, "clock_offset": {"offset_h": 0.6}}
    joint = of_scenes(scenes_of((43, 44), hidden), base())
    null = joint.fit(joint.null(), 12)
    one = alone(joint, null, "clock_offset")
    both = joint.fit(search.best_start(joint, one, Cause(BY_NAME["lamp_asymmetry"])), 12)
    assert both.hypothesis.names() == ("clock_offset", "lamp_asymmetry")
    assert both.evidence > one.evidence + THIRD > null.evidence + 2.0 * THIRD
    late, pull = both.values()
    assert late["offset_h"] == pytest.approx(0.6, abs=0.15)
    assert pull["right_to_left"] == pytest.approx(0.6, rel=0.2)


def test_where_nothing_is_hidden_hardly_any_cause_has_evidence() -> None:
    gains = []
    for first in (50, 52, 54, 56):
        joint, null = nominal(first)
        for effect in CATALOGUE:
            if effect.forms and effect.name not in {"circumnutation", "temperature_growth"}:
                looks = [search.best_start(joint, null, cause) for cause in search.forms_of(effect)]
                gains.append(max(found.evidence for found in looks) - null.evidence)
    gains_of = np.array(gains)
    assert np.isfinite(gains_of).all()
    assert np.mean(gains_of > FIRST) < 0.05
    assert np.median(gains_of) < 0.0


def test_a_look_where_all_is_taken_for_linear_comes_close_to_a_fit() -> None:
    weak: list[Hidden] = [
        ("lamp_asymmetry", {"right_to_left": 0.95}),
        ("draught", {"drive_per_cm_h": 0.01}),
        ("clock_offset", {"offset_h": 0.05}),
        ("gravitropism", {"factor": 1.05}),
    ]
    for name, values in weak:
        joint = of_scenes(scenes_of((45, 46), {name: values}), base())
        null = joint.fit(joint.null(), 20)
        effect = BY_NAME[name]
        none = np.array([p.centre for p in effect.parameters])
        look = joint.screened(null, Cause(effect), none)
        assert not look.jacobians  # so that nobody takes it for a fit
        assert not look.residuals
        fit = joint.fit(look, 20)
        assert look.evidence == pytest.approx(fit.evidence, abs=1.0)
        assert abs(look.coordinates[0] - fit.coordinates[0]) < 0.7 * np.sqrt(fit.covariance[0, 0])
        assert look.covariance[0, 0] == pytest.approx(fit.covariance[0, 0], rel=0.3)
        assert not look.jacobians  # a fit leaves what it sets out from as it was


@pytest.mark.parametrize(
    ("name", "form"), [("growth_rate", 0), ("growth_rate", 1), ("stiffening", 0), ("time_scale", 0)]
)
def test_a_cause_in_the_plants_constants_moves_runs_as_these_do(name: str, form: int) -> None:
    """To the last digit: else rounding would tell what nothing can."""
    joint, null = nominal(60, 3)
    cause = Cause(BY_NAME[name], form)
    factor = np.array([0.1])
    found = joint.fit(Found(Hypothesis((cause,)), factor, null.traits, null.start), 0)
    shift = change_of({name: {"factor": float(np.exp(factor[0]))}}, {name: form}).traits / factor[0]
    for jacobian in found.jacobians:
        assert jacobian[:, -1] == pytest.approx(jacobian[:, : len(NAMES)] @ shift, abs=1e-8 * np.abs(jacobian).max())


def test_what_plants_differ_in_is_told_no_better_than_they_differ() -> None:
    joint, null = nominal(60, 3)
    for name in ("growth_rate", "gravitropism", "stiffening"):
        fit = alone(joint, null, name)
        shift = change_of({name: {"factor": float(np.e)}}).traits
        together = joint.base.spread / len(joint.runs) + joint.base.doubt
        # As if the plants were known exactly: then it is a question of how far they are from the typical one.
        best = 1.0 / (shift @ np.linalg.inv(together) @ shift + fit.hypothesis.parameters[0].spread ** -2.0)
        assert fit.covariance[0, 0] > 0.99 * best, name


def test_what_is_typical_follows_further_plants_as_far_as_so_few_tell() -> None:
    spread = np.diag(np.linspace(0.01, 0.09, len(NAMES)))
    of_nine = replace(base(), spread=spread, doubt=spread / 9.0)
    away = np.random.default_rng(5).normal(0.0, 0.2, (3, len(NAMES)))
    told = of_nine.mean_with(of_nine.mean + away)
    assert told == pytest.approx(of_nine.mean + away.mean(axis=0) * 3.0 / 12.0)  # the mean of all twelve
    certain = replace(of_nine, doubt=1e-12 * spread)
    assert certain.mean_with(certain.mean + away) == pytest.approx(certain.mean, abs=1e-9)


def test_the_order_of_runs_does_not_matter() -> None:
    joint, _ = nominal(60, 3)
    order = [2, 0, 1]
    other = Joint([joint.runs[i] for i in order], joint.base)
    cause = Cause(BY_NAME["lamp_asymmetry"])
    fits = []
    for one in (joint, other):
        null = one.fit(one.null(), 20)
        fits.append((null, one.fit(one.screened(null, cause, np.array([np.log(0.75)])), 20)))
    for there, back in zip(*fits, strict=True):
        assert back.evidence == pytest.approx(there.evidence, abs=0.02)
        assert back.traits == pytest.approx(there.traits[order], abs=0.01)
        assert back.coordinates == pytest.approx(there.coordinates, abs=0.01)


def test_a_fit_ends_where_nothing_near_is_better() -> None:
    joint, _ = nominal(60, 3)
    null = joint.fit(joint.null(), 20)
    found = joint.fit(joint.screened(null, Cause(BY_NAME["draught"]), np.array([0.0])), 20)
    rng = np.random.default_rng(2)
    trait_sd = np.sqrt(np.diag(joint.base.spread))
    for _ in range(30):
        near = Found(
            found.hypothesis,
            found.coordinates + 0.3 * np.sqrt(found.covariance[0, 0]) * rng.standard_normal(1),
            found.traits + 0.1 * trait_sd * rng.standard_normal(found.traits.shape),
            found.start + 0.1 * START_SD * rng.standard_normal(found.start.shape),
        )
        assert joint._misfit_only(near) > found.misfit - 0.05


def test_evidence_is_the_probability_of_the_runs_over_all_plants() -> None:
    """For a run that is linear in its plant, by the covariance that plants give its features; no constant is left out
    but that of chance itself."""
    joint, null = nominal(50)
    one = Joint(joint.runs[:1], joint.base)
    fit = one.fit(one.null(), 20)
    prior = np.zeros((11, 11))
    prior[:9, :9] = joint.base.spread + joint.base.doubt
    prior[9:, 9:] = np.diag(START_SD**2)
    slopes, away = fit.jacobians[0], np.concatenate([fit.traits[0] - joint.base.mean, fit.start[0]])
    residual = fit.residuals[0] + slopes @ away
    whole = np.eye(len(residual)) + slopes @ prior @ slopes.T
    wanted = -0.5 * residual @ np.linalg.solve(whole, residual) - 0.5 * np.linalg.slogdet(whole)[1]
    assert fit.evidence == pytest.approx(wanted, abs=0.3)
    assert len(null.residuals) == 2


def test_plants_are_found_whatever_they_are() -> None:
    scene = scene_of(70, chance={"measure": 0.02})
    sizes = base().sizes.copy()
    sizes[[part.drive not in MEASURED for part in PARTS]] *= 0.1  # nothing but measuring happened by chance
    calm = Base(**{name: getattr(base(), name) for name in Base.__slots__} | {"sizes": sizes})
    joint = of_scenes([scene], calm)
    fit = joint.fit(joint.null(), 20)
    growth = [NAMES.index(name) for name in ("growth_early_cm_per_day", "growth_late_cm_per_day")]
    away = fit.traits[0] - individual(70)
    usual = individual(70) - TYPICAL
    assert np.abs(away[growth]).max() < 0.08
    assert np.abs(fit.residuals[0]).mean() < 1.5
    assert away @ np.linalg.solve(base().spread, away) < 9.0 + 4.0 * usual @ np.linalg.solve(base().spread, usual)


def test_nothing_goes_farther_than_it_may() -> None:
    joint, _ = nominal(50)
    cause = Cause(BY_NAME["phototropic_latency"])
    start = Found(Hypothesis((cause,)), np.array([0.4]), *(getattr(joint.null(), name) for name in ("traits", "start")))
    moved = joint._moved(start, np.full(9 * 2 + 2 * 2 + 1, -1e3))
    assert moved.coordinates[0] == 0.0  # an answer does not come before the light
    assert np.isfinite(moved.traits).all()
    assert (moved.start >= -10.0 * START_SD - 1e-12).all()
    assert np.isfinite(joint.fit(moved, 2).evidence)


def test_hypotheses_add_up() -> None:
    cause, other = Cause(BY_NAME["camera_roll"]), Cause(BY_NAME["growth_rate"], 1)
    both = Hypothesis((cause, other))
    change = both.change(np.array([3.0, np.log(0.7)]))
    wanted = change_of({"camera_roll": {"angle_deg": 3.0}, "growth_rate": {"factor": 0.7}}, {"growth_rate": 1})
    assert (change.turn_deg, change.terms.tolist()) == (wanted.turn_deg, pytest.approx(wanted.terms.tolist()))
    assert both.names() == ("camera_roll", "growth_rate")
    assert [p.name for p in both.parameters] == ["angle_deg", "factor"]
    assert Hypothesis().change(np.zeros(0)).terms.tolist() == Change().terms.tolist()


def test_a_first_stem_that_leans_speaks_for_a_rolled_camera() -> None:
    joint, _ = nominal(50)
    run = joint.runs[0]
    leaning = Ready(run.scene, run.measured + np.eye(len(run.measured))[-1] * np.radians(8.0), run.inverse_root)
    cause, none = Cause(BY_NAME["camera_roll"]), np.array([0.0])
    angles = []
    for one in (Joint([run], joint.base), Joint([leaning], joint.base)):
        null = one.fit(one.null(), 20)
        angles.append(float(one.screened(null, cause, none).coordinates[0]))
    assert angles[1] < angles[0]  # pictures turned clockwise make stems lean to the right
