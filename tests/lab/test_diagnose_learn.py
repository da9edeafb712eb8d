"""What reference runs tell: typical plants, how they differ, what happens by chance, and what is usually left."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import TypeAlias

import numpy as np
import pytest
from diagnose_runs import REFERENCE, SPREAD, TYPICAL, base, known, scene_of, scenes_of

from flora_lab.diagnose import chance, learn
from flora_lab.diagnose.cross_fit import learn_from
from flora_lab.diagnose.hypothesis import Hypothesis
from flora_lab.diagnose.joint import Base, Found
from flora_lab.diagnose.knowledge import LAW_ROUNDS, blocks, law_of, spectra_of
from flora_lab.diagnose.scene import Scene
from flora_lab.effects.effect import Change
from flora_lab.effects.law_forms import AS_WRITTEN, LAWS, Law
from flora_lab.simulator.terms import APICAL, BY_AGE, BY_HOURS, EVEN_LIGHT, SIDE_ALONE, SIGNAL_H_PER_CM, SPURT_MORE
from flora_lab.simulator.tropism_traits import NAMES, prior_mean, prior_spread
from flora_lab.threads import one_blas_thread

Rounds: TypeAlias = Callable[[], None]


@functools.cache
def wild() -> tuple[Base, list[Found]]:
    """The same plants and one that is like no other."""
    odd = TYPICAL.copy()
    odd[[NAMES.index("photoception_per_cm_h"), NAMES.index("proprioception_per_h")]] += np.log([0.15, 4.0])
    with one_blas_thread():
        scenes = [*scenes_of(REFERENCE[:-1]), scene_of(8, traits=odd)]
        found = learn.learned(scenes)
    return found.base, found.fits


def test_typical_plants_are_found_within_the_doubt() -> None:
    doubt = np.sqrt(np.diag(base().doubt + SPREAD / len(REFERENCE)))
    away = (base().mean - TYPICAL) / doubt
    assert np.abs(away).max() < 4.0
    assert np.mean(away**2) < 3.0
    # what the sources say is not what these plants are: the runs have told more than they did
    told, before = np.abs(base().mean - TYPICAL), np.abs(prior_mean() - TYPICAL)
    told_well = [
        NAMES.index(name) for name in ("growth_early_cm_per_day", "photoception_per_cm_h", "proprioception_per_h")
    ]
    assert (told[told_well] < before[told_well]).all()
    assert (np.diag(base().doubt) < 0.3 * np.array([0.4, 0.3, 0.3, 0.15, 0.3, 0.7, 0.7, 0.7, 0.5])).all()


@pytest.mark.parametrize(("away", "goes"), [(1.5, 1.5), (15.0, 3.0)])
def test_what_is_typical_is_sought_about_the_plants_and_not_where_a_line_through_them_leads(
    monkeypatch: pytest.MonkeyPatch, away: float, goes: float
) -> None:
    """Of plants that stiffened within 8 cm, nine of a stranger's runs, linear about each, told 0.5 cm as typical."""
    middle, usual, start = prior_mean(), np.sqrt(np.diag(prior_spread())), base()
    direction = np.zeros(len(NAMES))
    direction[[NAMES.index("stiffening_cm"), NAMES.index("mature_cm")]] = -1.0, 0.5
    told = middle + away * usual * direction, start.doubt
    monkeypatch.setattr(learn.marginal, "typical", lambda *_: told)
    monkeypatch.setattr(learn.marginal, "sizes_and_spread", lambda *_: (start.sizes, start.spread))
    found = learn._population([], start, middle, usual)
    assert found.mean == pytest.approx(middle + goes * usual * direction)
    assert (found.doubt == start.doubt).all()


def test_how_plants_differ_is_found() -> None:
    assert base().runs == len(REFERENCE)
    for matrix in (base().spread, base().doubt):
        assert np.abs(matrix - matrix.T).max() < 1e-12
        assert np.linalg.eigvalsh(matrix)[0] > 0.0
    ratio = np.diag(base().spread) / np.diag(SPREAD)
    assert (ratio > 0.3).all()
    assert (ratio < 4.0).all()
    single = base().of_single_runs()
    assert np.abs(single.spread - base().spread - base().doubt).max() < 1e-12


def test_first_stems_are_told() -> None:
    firsts = np.stack([scene.first for scene in scenes_of(REFERENCE)])
    assert np.abs(base().first - firsts.mean(axis=0)).max() < 1e-9
    assert (base().first_sd > 0.5 * firsts.std(axis=0)).all()
    assert (base().first_sd < 0.2).all()


def test_chance_is_as_large_as_it_was_made() -> None:
    """By its mean push on the features; how it is shared out among parts of different times is not known so well, nor
    what of it is taken for errors of the law itself, which is never taken to be quite right."""
    scene = scene_of(0)
    parts = chance.covariances(scene, scene.answers(TYPICAL, Change()))
    own = np.array([np.trace(part) for part in parts])
    expected = {"bias": (0.012**2, "wander_per_cm_h"), "growth": (0.04**2, "growth_slow_share")}
    for drive, (variance, name) in expected.items():
        rows = [i for i, part in enumerate(chance.PARTS) if part.drive == drive]
        told = float(base().sizes[rows] ** 2 @ own[rows])
        wanted = variance * own[[part.name for part in chance.PARTS].index(name)]
        assert 0.15 < told / wanted < 3.0, drive


def test_runs_leave_no_more_than_chance() -> None:
    assert known().left.shape == (len(REFERENCE), 2)
    assert 0.1 < known().left[:, 0].mean() < 1.5
    assert (known().left[:, 1] >= known().left[:, 0] - 1e-12).all()
    assert known().swing_evidence.shape == (len(REFERENCE),)
    assert (known().swing_evidence < 6.0).all()
    assert known().base.runs == len(REFERENCE)


def test_one_plant_like_no_other_does_not_tell_what_is_typical() -> None:
    odd, fits = wild()
    away = (odd.mean - base().mean) / np.sqrt(np.diag(base().spread))
    assert np.abs(away).max() < 1.5
    assert np.linalg.eigvalsh(odd.spread)[0] > 0.0
    photo = NAMES.index("photoception_per_cm_h")
    assert fits[-1].traits[0, photo] < odd.mean[photo] - 0.5  # it is seen for what it is
    wider = np.sqrt(np.diag(odd.spread) / np.diag(base().spread))
    same = [i for i, name in enumerate(NAMES) if name not in {"photoception_per_cm_h", "proprioception_per_h"}]
    assert (wider[same] < 1.3).all()  # and in what it is like others it does not say that plants differ
    assert wider.max() < 3.0


def test_the_same_runs_tell_the_same_to_the_bit() -> None:
    told: list[int] = []
    with one_blas_thread():
        twice = [learn_from(scenes_of(REFERENCE[:4]), told.append, AS_WRITTEN) for _ in range(2)]
    assert told == [*range(1, len(told) // 2 + 1)] * 2
    for one in fields(Base):
        there, back = (np.asarray(getattr(know.base, one.name)).tobytes() for know in twice)
        assert there == back, one.name
    for name in ("left", "swing_evidence"):
        assert getattr(twice[0], name).tobytes() == getattr(twice[1], name).tobytes()
    assert twice[0].errors.sizes.tobytes() == twice[1].errors.sizes.tobytes()
    assert twice[0].swings.power.tobytes() == twice[1].swings.power.tobytes()


def chosen(forms: Mapping[str, tuple[int, float]], hours: float, laws: Sequence[Law], on_round: Rounds) -> set[str]:
    """The law that is told of plants under one of these forms."""
    change = Change()
    for term, amount in forms.values():
        change.terms[term] = amount
    with one_blas_thread():
        scenes = [scene_of(seed, change=change, hours=hours) for seed in REFERENCE[:4]]
        law, best = law_of(scenes, on_round, laws)
    assert len(best.fits) == 4
    return {one.effect for one in law}


@pytest.mark.parametrize(
    ("forms", "hours"),
    [
        ({}, 24.0),
        # stems that do not come half way tell nothing of their course
        pytest.param(
            {"spurt": (SPURT_MORE, 1.0), "apical": (APICAL, 1.0), "by_age": (BY_AGE, 1.0)}, 48.0, marks=pytest.mark.slow
        ),
        pytest.param(
            {"by_hours": (BY_HOURS, 1.0), "spurt": (SPURT_MORE, 1.0), "even_light": (EVEN_LIGHT, 1.0)},
            60.0,
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_law_that_the_plants_are_under_is_chosen(forms: Mapping[str, tuple[int, float]], hours: float) -> None:
    told: list[None] = []
    assert chosen(forms, hours, LAWS, lambda: told.append(None)) == set(forms)
    assert len(told) == LAW_ROUNDS  # whichever law it is


@pytest.mark.parametrize(
    ("forms", "hours"),
    [
        pytest.param({"side_alone": (SIDE_ALONE, 1.0), "even_light": (EVEN_LIGHT, 1.0)}, 36.0, marks=pytest.mark.slow),
        ({"apical": (APICAL, 1.0), "signal": (SIGNAL_H_PER_CM, 0.4)}, 24.0),
    ],
)
def test_how_light_is_sensed_is_told_where_nothing_else_is_asked(
    forms: Mapping[str, tuple[int, float]], hours: float
) -> None:
    assert chosen(forms, hours, (AS_WRITTEN[0], LAWS[1], AS_WRITTEN[2]), lambda: None) == set(forms)


def test_what_is_typical_does_not_depend_on_the_order_of_runs() -> None:
    with one_blas_thread():
        told = [scenes_of(seeds) for seeds in ((0, 1, 2, 3), (3, 1, 0, 2))]
        there, back = (learn.learned(scenes).base for scenes in told)
    assert np.abs(there.mean - back.mean).max() < 0.01
    assert np.abs(there.spread - back.spread).max() < 0.1 * np.abs(prior_spread()).max()


def test_a_part_of_a_run_that_is_badly_wrong_stands_out_of_the_mean() -> None:
    rng = np.random.default_rng(1)
    residual = rng.standard_normal(300)
    calm = blocks(residual)
    residual[180:200] += 6.0
    wrong = blocks(residual)
    assert wrong[1] - calm[1] > 4.0 * (wrong[0] - calm[0]) > 0.0
    assert calm[0] == np.mean(np.random.default_rng(1).standard_normal(300) ** 2)
    assert blocks(np.ones(3)).tolist() == [1.0, 1.0]


def test_spectra_are_of_what_is_left_and_of_what_lamps_do() -> None:
    scene: Scene = scene_of(0)
    fit = Found(Hypothesis(), np.zeros(0), base().mean[None], np.zeros((1, 2)))
    rest, moved = spectra_of(scene, fit, 0)
    assert rest.per_hour.tolist() == moved.per_hour.tolist()
    assert rest.power.min() >= 0.0
    assert moved.power.shape == rest.power.shape
