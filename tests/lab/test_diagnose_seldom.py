"""Photographs more seldom than every five minutes: what lies between them is nothing that a plant does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose_runs import LAW, TYPICAL, known, run_of, turns

from flora_lab.diagnose import chance
from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.scene import Lanes, Scene
from flora_lab.effects.effect import Change
from flora_lab.simulator.measured import MeasuredRun
from flora_lab.simulator.tropism_traits import NAMES
from flora_lab.threads import one_blas_thread

LATENCY = NAMES.index("photo_latency_min")


def seldom(run: MeasuredRun, parts: int) -> MeasuredRun:
    """Only every so many photographs of a run; lamps changed with one of these."""
    points, light = run.points_cm[::parts], run.light[parts - 1 :: parts]
    assert (run.light.reshape(-1, parts, 2) == light[:, None]).all()
    return replace(run, points_cm=points, light=light, time_s=run.time_s[::parts], step_s=parts * run.step_s)


def one_of(seed: int, parts: int) -> Scene:
    return Scene(seldom(run_of(seed, light=turns(24.0, 6.0)), parts), LAW)


@pytest.mark.parametrize("parts", [pytest.param(2, marks=pytest.mark.slow), 4, pytest.param(6, marks=pytest.mark.slow)])
def test_a_healthy_run_is_one_however_seldom_it_was_photographed(parts: int) -> None:
    late = []
    for seed in (80, 81, 90, 91):
        with one_blas_thread():
            often, scene = (Explainer([one_of(seed, every)], known()).explain() for every in (1, parts))
        assert scene.accepted == ()
        assert scene.unnamed is None
        late.append(scene.found.traits[0, LATENCY] - often.found.traits[0, LATENCY])
    assert np.mean(late) == pytest.approx(0.0, abs=0.1)  # of its logarithm: 10 % of some twenty minutes


def test_the_same_plant_moves_alike_in_long_steps_and_in_short_ones() -> None:
    still = run_of(3, light=turns(24.0, 6.0), chance={}, traits=TYPICAL)
    often, half_hourly = Scene(still, LAW), Scene(seldom(still, 6), LAW)
    lanes = Lanes(TYPICAL[None], np.zeros((1, 2)), [Change()])
    every = often.points(lanes, every=1)[5::6, 0]
    # One begins from the mean of the first three photographs, ten minutes, the other from the first.
    assert half_hourly.points(lanes, every=1)[: len(every), 0] == pytest.approx(every, abs=0.1)


def test_a_mean_of_fewer_photographs_has_more_of_their_errors() -> None:
    sizes = []
    for parts in (1, 3, 6):
        scene = one_of(3, parts)
        of_parts = chance.covariances(scene, scene.answers(TYPICAL, Change()))
        sizes.append([of_parts[[p.name for p in chance.PARTS].index(name)][0, 0] for name in ("measure_cm", "lean_cm")])
    each, shared = np.array(sizes).T
    assert each / each[0] == pytest.approx([1.0, 3.0, 6.0])
    assert shared / shared[0] == pytest.approx([1.0, 1.0, 1.0])
