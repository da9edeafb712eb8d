"""Gusts of a draught: as large as the wind bends stems, and nothing that is left over beside it."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Final

import numpy as np
import pytest
import scipy.integrate
from diagnose_runs import LAMPS, LAW, TYPICAL, change_of, known, red_noise, run_of, scene_of

from flora_common.arrays import Array
from flora_lab.diagnose import gusts
from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.explanation import Accepted, Explanation, Tried
from flora_lab.diagnose.hypothesis import Cause, Hypothesis
from flora_lab.diagnose.joint import Found
from flora_lab.diagnose.rhythm import spectrum
from flora_lab.diagnose.scene import Lanes, Scene
from flora_lab.diagnose.trials import Trials
from flora_lab.diagnose.verdict import left_of, meaning, named, verdict_of
from flora_lab.effects.catalogue import BY_NAME
from flora_lab.effects.draught import LATE_CM
from flora_lab.effects.effect import Change
from flora_lab.simulator.measured import MeasuredRun
from flora_lab.simulator.sag import SOFTNESS_CM
from flora_lab.simulator.terms import SOFTNESS_CM as SOFT
from flora_lab.simulator.terms import WIND, ExtendedLaw
from flora_lab.threads import one_blas_thread

ELASTIC, BOWING = 2, 3
"""The forms of a draught that bends stems elastically."""
DRIVE_PER_CM_H: Final = 0.15
WEAK_PER_CM_H: Final = 0.08
GUSTS: Final = gusts.Gusts((0.1, 0.1, 0.04))


def blown(drive_per_cm_h: float) -> Change:
    return change_of({"draught": {"drive_per_cm_h": drive_per_cm_h}}, {"draught": ELASTIC})


def typical_in_wind(drive_per_cm_h: float) -> Found:
    """The explanation of a typical plant by a draught."""
    cause = Cause(BY_NAME["draught"], ELASTIC)
    coordinates = np.array([cause.parameters[0].coordinate(drive_per_cm_h)])
    return Found(Hypothesis((cause,)), coordinates, TYPICAL[None], np.zeros((1, 2)))


def course(rng: np.random.Generator, rows: int, shares: tuple[float, ...] = GUSTS.shares) -> Array:
    """How much harder than its mean a wind blows, shape (rows,)."""
    each = zip(shares, gusts.MEMORIES_H, strict=True)
    return np.asarray(np.sum([share * red_noise(rng, rows, memory_h) for share, memory_h in each], axis=0))


def gusty(seed: int, drive_per_cm_h: float = DRIVE_PER_CM_H, shares: tuple[float, ...] = GUSTS.shares) -> MeasuredRun:
    """A run in a wind that comes and goes."""
    run = run_of(seed, hours=72.0, change=blown(drive_per_cm_h))
    aside_cm = gusts.held_aside_cm(run.points_cm, float(blown(drive_per_cm_h).terms[WIND]), SOFTNESS_CM)
    harder = course(np.random.default_rng([seed, 3]), len(run.points_cm), shares)
    harder[0] = 0.0  # a run begins from the stem that is measured
    return replace(run, points_cm=run.points_cm + harder[:, None, None] * aside_cm)


@pytest.mark.parametrize("lean_rad", [0.0, 0.6])
def test_wind_holds_a_stem_aside_by_its_moments_where_that_is_soft(lean_rad: float) -> None:
    """Of a straight stem the moment at so far below its tip goes with the square of that, and the lever with it."""
    length_cm, wind = 16.0, 1e-3
    along = np.array([np.sin(lean_rad), np.cos(lean_rad)])
    stem = np.linspace(0.0, length_cm, 40)[:, None] * along
    tip = gusts.held_aside_cm(stem[None], wind, SOFTNESS_CM)[0, -1]
    whole, _ = scipy.integrate.quad(lambda u: 0.5 * wind * np.exp(-u / SOFTNESS_CM) * u**3, 0.0, length_cm)
    assert tip == pytest.approx(whole * np.cos(lean_rad) * np.array([along[1], -along[0]]), rel=0.03, abs=1e-9)
    coarse = gusts.held_aside_cm(stem[None, ::13], wind, SOFTNESS_CM)[0, -1]
    assert coarse == pytest.approx(tip, rel=0.35, abs=1e-9)


def test_hourly_means_and_spectra_scatter_as_much_as_gusts_make_them() -> None:
    """The long way round: many courses of one wind about one plant."""
    scene, found = scene_of(1, traits=TYPICAL, chance={}, change=blown(DRIVE_PER_CM_H)), typical_in_wind(DRIVE_PER_CM_H)
    stems = scene.run.points_cm[1 : scene.steps + 1]
    aside_cm = gusts.held_aside_cm(stems, 0.03 * DRIVE_PER_CM_H, SOFTNESS_CM)
    rng = np.random.default_rng(4)
    courses = np.stack([course(rng, scene.steps) for _ in range(400)], axis=1)
    every = scene.steps // len(scene.points(Lanes(TYPICAL[None], np.zeros((1, 2)), [Change()])))
    moved = courses[:, :, None, None] * aside_cm[:, None]
    means = moved.reshape(-1, every, *moved.shape[1:]).mean(axis=1)
    sampled, wanted = np.cov(scene.of_points(means).T), gusts.covariance(scene, found, 0, GUSTS)
    assert np.trace(sampled) == pytest.approx(np.trace(wanted), rel=0.15)
    assert np.sum(sampled * wanted) > 0.97 * np.sqrt(np.sum(sampled**2) * np.sum(wanted**2))
    spectra = [spectrum(moved[:, k, -1, 0], scene.step_h) for k in range(moved.shape[1])]
    power = np.mean([own.power for own in spectra], axis=0)
    middle = (spectra[0].per_hour > 0.4) & (spectra[0].per_hour < 1.2)
    expected = gusts.power(scene, found, 0, spectra[0], GUSTS)
    assert power[middle].mean() == pytest.approx(expected[middle].mean(), rel=0.25)


def test_where_no_wind_bends_stems_there_are_no_gusts() -> None:
    scene = scene_of(1, traits=TYPICAL, chance={})
    calm = Found(Hypothesis(), np.zeros(0), TYPICAL[None], np.zeros((1, 2)))
    assert not gusts.covariance(scene, calm, 0, GUSTS).any()
    assert not gusts.power(scene, calm, 0, spectrum(scene.run.points_cm[:, -1, 0], scene.step_h), GUSTS).any()


@functools.cache
def gusty_explanation() -> Explanation:
    with one_blas_thread():
        return Explainer([Scene(gusty(84), LAW)], known()).explain()


@pytest.mark.slow
def test_a_gusty_draught_is_named_and_leaves_nothing() -> None:
    explanation = gusty_explanation()
    left = left_of(explanation, known())
    (cause,) = named(explanation, left)
    assert (cause.effect, cause.form, verdict_of([cause], left)) == ("draught", ELASTIC, "explained")
    assert cause.confidence > 0.8
    assert cause.interval["drive_per_cm_h"][0] < DRIVE_PER_CM_H < cause.interval["drive_per_cm_h"][1]


def weighed(runs: list[MeasuredRun]) -> Tried:
    """A draught as a first cause of some runs, in whatever gusts."""
    trials = Trials([Scene(run, LAW) for run in runs], known())
    with one_blas_thread():
        _, joint, null = trials.begun()
        return trials._in_gusts(joint, null, Tried(BY_NAME["draught"], -np.inf, None))


def wavering(run: MeasuredRun, seed: int) -> MeasuredRun:
    """A run whose stem sways by itself as in gusts."""
    aside_cm = gusts.held_aside_cm(run.points_cm, float(blown(3.0 * WEAK_PER_CM_H).terms[WIND]), SOFTNESS_CM)
    harder = course(np.random.default_rng([seed, 3]), len(run.points_cm))
    harder[0] = 0.0
    return replace(run, points_cm=run.points_cm + harder[:, None, None] * aside_cm)


def knocked(run: MeasuredRun, at_h: float = 54.5, comes_back_h: float = 4.0) -> MeasuredRun:
    """A run whose stem is bent once, and comes back."""
    aside_cm = gusts.held_aside_cm(run.points_cm, float(blown(4.0 * DRIVE_PER_CM_H).terms[WIND]), SOFTNESS_CM)
    since_h = np.arange(len(run.points_cm)) * run.step_s / 3600.0 - at_h
    bent = np.where(since_h >= 0.0, np.exp(-np.maximum(since_h, 0.0) / comes_back_h), 0.0)
    return replace(run, points_cm=run.points_cm + bent[:, None, None] * aside_cm)


@pytest.mark.slow
def test_what_bends_stems_once_is_no_wind(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = [knocked(run_of(seed, hours=72.0)) for seed in (82, 84)]
    assert weighed(runs).gusts.evidence < 10.0
    monkeypatch.setattr(gusts, "_MUCH", np.inf)
    assert weighed(runs).gusts.evidence > 50.0


def test_a_wind_that_plants_lean_hides_is_told_by_its_gusts() -> None:
    draught = weighed([gusty(seed, WEAK_PER_CM_H) for seed in (82, 84)])
    assert draught.found is not None
    assert draught.found.hypothesis.causes[-1].form == ELASTIC
    assert draught.found.values()[-1]["drive_per_cm_h"] == pytest.approx(WEAK_PER_CM_H, rel=0.5)
    assert draught.gain > draught.gusts.evidence > 5.0


def test_in_a_steady_wind_there_are_no_gusts() -> None:
    blow = blown(DRIVE_PER_CM_H)
    draught = weighed([run_of(seed, hours=72.0, change=blow) for seed in (82, 84)])
    assert draught.gain > 10.0
    assert draught.gusts.evidence < 3.0


@pytest.mark.slow
def test_one_run_of_several_that_sways_by_itself_is_in_no_wind() -> None:
    first, second = (run_of(seed, hours=72.0) for seed in (82, 84))
    assert weighed([wavering(first, 82), second]).gusts.evidence == 0.0
    assert weighed([first, second]).gusts.evidence == 0.0


@pytest.mark.slow
def test_what_lasts_for_hours_alone_tells_of_no_wind() -> None:
    quick, slow = (
        weighed([gusty(seed, shares=shares) for seed in (82, 84)]).gusts
        for shares in ((0.1, 0.1, 0.0), (0.0, 0.0, 0.1))
    )
    assert quick.evidence > 0.0
    assert slow.shares[-1] > 0.0  # it is taken for what it may be
    assert slow.evidence == 0.0


@pytest.mark.parametrize(
    ("each", "nats"), [((30.0,), 23.0), ((30.0, 4.0), 8.0), ((30.0, 4.0, -1.0), 7.0), ((5.0, 4.0, 3.0), 11.0)]
)
def test_what_one_run_shows_counts_as_much_as_the_next_one_bears_out(each: tuple[float, ...], nats: float) -> None:
    assert gusts._borne_out(np.array(each)) == nats


@pytest.mark.parametrize(("of_push", "is_side_told"), [(-1.0, False), (5.0, True)])
def test_gusts_do_not_tell_from_which_side_a_wind_blows(of_push: float, is_side_told: bool) -> None:
    explanation = gusty_explanation()
    (accepted,) = explanation.accepted
    tried = replace(accepted.tried, gain=20.0 + of_push, gusts=gusts.Gusts(GUSTS.shares, 20.0))
    weak = replace(explanation, accepted=(Accepted(tried, accepted.stage),))
    (cause,) = named(weak, left_of(weak, known()))
    low, high = cause.interval["drive_per_cm_h"]
    assert (low == -high) != is_side_told
    said = meaning(BY_NAME["draught"], cause.parameters, cause.interval)
    assert ("from which side" in cause.evidence) == ("from which side" in said) != is_side_told


def test_a_simulator_that_knows_how_soft_its_sagging_stems_are_keeps_it_in_a_wind() -> None:
    sagging = change_of({"sag": {"amplitude": 0.7}}).terms
    scene = Scene(run_of(82), ExtendedLaw(LAMPS, terms=sagging))
    wind = change_of({"draught": {"drive_per_cm_h": 0.1}}, {"draught": BOWING})
    assert scene.terms_with(wind)[SOFT] == sagging[SOFT]
    assert Scene(run_of(82), LAW).terms_with(wind)[SOFT] == LATE_CM
