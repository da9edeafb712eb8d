"""What healthy plants show as well is not what is wrong with others."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from diagnose_runs import base, known, scene_of

from flora_common.arrays import Array
from flora_lab.diagnose import chance
from flora_lab.diagnose.courses import KNOWN, SIZE, TRIED
from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.explanation import Explanation
from flora_lab.diagnose.information_form import InformationForm
from flora_lab.diagnose.joint import Joint, ready
from flora_lab.diagnose.scene import Scene
from flora_lab.diagnose.usual_pushes import UsualPushes, no_pushes, usual_pushes
from flora_lab.effects.effect import Change
from flora_lab.threads import one_blas_thread

HOURS = 48.0
DAY = next(k for k, (drive, course) in enumerate(TRIED) if drive == "gain" and course.where == "in a rhythm of 24 h")
Drives = Mapping[str, Callable[[Array], Array]]


def by_day(amplitude: float) -> Drives:
    return {"gain": lambda hour: amplitude * np.cos(2.0 * np.pi * (hour - 7.0) / 24.0)}


def plants(seeds: Sequence[int], besides: Drives | None) -> list[Scene]:
    return [scene_of(seed, hours=HOURS, besides=besides) for seed in seeds]


@functools.cache
def shown(amplitude: float) -> UsualPushes:
    """By six plants."""
    alone = base().of_single_runs()
    runs, fits, answers = [], [], []
    for scene in plants(range(30, 36), by_day(amplitude) if amplitude else None):
        run = ready(scene, alone, chance.covariances(scene, scene.answers(alone.mean, Change())), together=0)
        joint = Joint([run], alone)
        fit = joint.fit(joint.null())
        runs.append(run)
        fits.append(fit)
        answers.append(scene.answers(fit.traits[0], Change()))
    return usual_pushes(runs, fits, answers, alone)


def explained(usual: UsualPushes, amplitude: float) -> Explanation:
    with one_blas_thread():
        return Explainer(plants((84, 85), by_day(amplitude)), replace(known(), pushes=usual)).explain()


def test_a_push_that_plants_show_is_found_in_its_size() -> None:
    usual = shown(0.5)
    assert np.hypot(*usual.mean[DAY]) == pytest.approx(0.5, rel=0.35)
    assert np.arctan2(usual.mean[DAY, 1], usual.mean[DAY, 0]) * 24.0 / (2.0 * np.pi) == pytest.approx(7.0, abs=1.5)
    assert 0.0 < np.sqrt(usual.doubt[DAY, 0, 0]) < 0.2


def test_plants_that_the_law_describes_show_next_to_nothing() -> None:
    usual = shown(0.0)
    sizes = np.array([SIZE[drive] for drive, _ in KNOWN])
    assert np.count_nonzero(usual.mean.any(axis=1)) <= 2
    assert (usual.scatter / sizes).max() < 0.3
    assert not usual.mean[DAY].any()


@pytest.mark.slow
def test_what_healthy_plants_show_as_well_is_no_news() -> None:
    alike, news = explained(shown(0.5), 0.5), explained(no_pushes(), 0.5)
    assert news.unnamed is not None
    assert (news.unnamed.drive, news.unnamed.course) == TRIED[DAY]
    assert news.unnamed.usual == 0.0
    assert alike.unnamed is None


@pytest.mark.slow
def test_what_goes_far_beyond_it_is() -> None:
    beyond = explained(shown(0.3), 0.9).unnamed
    assert beyond is not None
    assert beyond.usual > 5.0


def test_nothing_is_taken_off_what_is_the_other_way_round() -> None:
    told = InformationForm(400.0 * np.eye(2), np.array([100.0, 0.0]))  # a quarter, and not known to a twentieth
    usual = no_pushes()
    assert usual.nats(DAY, told, 3) == 0.0
    usual.mean[DAY] = (-0.25, 0.0)
    assert usual.nats(DAY, told, 3) == 0.0
    usual.mean[DAY] = (0.25, 0.0)
    assert usual.nats(DAY, told, 3) == pytest.approx(12.5)


def test_where_plants_scatter_many_are_better_known_than_few() -> None:
    told = InformationForm(400.0 * np.eye(2), np.array([100.0, 0.0]))
    usual = no_pushes()
    usual.scatter[DAY] = 0.3
    assert usual.nats(DAY, told, 1) > usual.nats(DAY, told, 100) > 0.0


def test_of_a_rhythm_with_own_times_each_run_has_taken_off_what_plants_show() -> None:
    """Where plants scatter by as much as each of two runs shows, at another time, all of it; where their mean is known
    to be another one, nothing."""
    told = InformationForm(400.0 * np.eye(4), np.array([90.0, 0.0, 0.0, -90.0]))
    whole = told.nats(0.4**2 * np.eye(4))
    usual = no_pushes()
    assert usual.nats_apart(DAY, told, 2) == 0.0
    usual.scatter[DAY] = 0.25
    assert usual.nats_apart(DAY, told, 2) >= whole
    usual.scatter[DAY] = 0.02
    assert usual.nats_apart(DAY, told, 2) < 0.5 * whole
    usual.scatter[DAY], usual.mean[DAY] = 0.0, (-0.2, 0.0)
    assert usual.nats_apart(DAY, told, 2) == 0.0
    usual.mean[DAY] = (0.2, 0.0)  # of one run in step with that, and of another that is not
    assert usual.nats_apart(DAY, told, 2) == pytest.approx(max(0.0, 90.0 * 0.2 - 2 * 0.5 * 400.0 * 0.2**2))
