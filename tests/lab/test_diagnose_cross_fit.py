"""What the search finds in reference runs that are held out, and how much more a cause needs for it."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from diagnose_runs import REFERENCE, change_of, known, scene_of, scenes_of

from flora_lab.diagnose.claims import claims_of
from flora_lab.diagnose.cross_fit import FOLDS, LEAST_RUNS, ROUNDS, learn_from
from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.explanation import FIRST
from flora_lab.diagnose.knowledge import LOOKED_FOR, Knowledge
from flora_lab.effects.law_forms import AS_WRITTEN
from flora_lab.threads import one_blas_thread

SAG = "sag"


@functools.cache
def not_alike() -> Knowledge:
    """The camera was rolled to one side in a third of the reference, and to the other in a third."""
    rolled = [change_of({"camera_roll": {"angle_deg": 7.0 * side}}) for side in (-1.0, 0.0, 1.0)]
    with one_blas_thread():
        return learn_from([scene_of(seed, change=rolled[seed % FOLDS]) for seed in REFERENCE], laws=AS_WRITTEN)


def in_folds(nats: Sequence[float]) -> Knowledge:
    """As much for a sag in each fold."""
    folds = np.full((FOLDS, len(LOOKED_FOR)), -1.0)
    folds[:, LOOKED_FOR.index(SAG)] = nats
    return replace(known(), cross_fit=folds)


def claim(one: Knowledge, runs: int = 3) -> float:
    return Explainer(scenes_of(range(30, 30 + runs)), one).claims.first


def test_healthy_runs_show_next_to_nothing_in_each_other() -> None:
    assert known().cross_fit.shape == (FOLDS, len(LOOKED_FOR))
    assert known().cross_fit.max() < FIRST
    assert claim(known()) < FIRST + 1.0


@pytest.mark.slow
def test_a_reference_that_is_not_alike_shows_causes_in_itself_and_asks_for_more() -> None:
    found = not_alike().cross_fit
    assert min(found[0].max(), found[2].max()) > 1.0  # the folds with the rolled cameras
    assert claim(not_alike()) > claim(known()) + 1.0
    claims = claims_of(not_alike(), 3)
    assert claims.of("camera_roll", 0) > 1.0 + claims.of("diurnal_growth", 0)


def test_what_is_asked_grows_with_what_was_found_up_to_a_bound() -> None:
    asked = [claim(in_folds([nats] * FOLDS)) for nats in (-3.0, 1.5, 2.0, 3.0, 30.0, 300.0)]
    assert asked[0] == asked[1] == FIRST  # as much is chance
    assert asked == sorted(asked)
    assert asked[1] < asked[2] < asked[3] < asked[4] == asked[5]
    one_odd_plant = in_folds([0.0, 0.3, 30.0])
    assert claim(one_odd_plant) == FIRST


def test_more_is_asked_of_the_cause_that_was_found_in_any_fold() -> None:
    def beyond(nats: float, runs: int = 3) -> float:
        claims = claims_of(in_folds([0.0, nats, 0.3]), runs)
        return claims.of(SAG, 1) - claims.causes[1]

    asked = [beyond(nats) for nats in (-3.0, 1.5, 2.0, 5.0, 30.0, 300.0)]
    assert asked[0] == asked[1] == 0.0
    assert asked == sorted(asked)
    assert asked[2] < asked[3] < asked[4] == asked[5]
    assert claims_of(in_folds([0.0, 9.0, 0.3]), 3).of("draught", 0) == FIRST
    assert beyond(5.0, 6) == pytest.approx(2.0 * beyond(5.0))
    # what all causes need for it already is not asked for twice
    one, all_folds = (claims_of(in_folds(nats), 3) for nats in ([0.0, 4.0, 0.0], [4.0] * FOLDS))
    assert all_folds.first > one.first == FIRST
    assert all_folds.of(SAG, 0) == one.of(SAG, 0)


def test_a_cause_has_no_name_where_healthy_runs_show_as_much_of_it() -> None:
    scenes = scenes_of((84, 85), {"camera_roll": {"angle_deg": 5.0}})
    folds = np.zeros((FOLDS, len(LOOKED_FOR)))
    folds[1, LOOKED_FOR.index("camera_roll")] = 300.0
    with one_blas_thread():
        as_usual, doubted = (Explainer(scenes, one) for one in (known(), replace(known(), cross_fit=folds)))
        stage = as_usual.trials.first_stage()
        assert stage.tried[0].effect.name == "camera_roll"
        asked = [one.explain().claim for one in (as_usual, doubted)]
    assert asked[1] > asked[0] + 10.0


def test_errors_of_the_law_add_up_over_runs() -> None:
    doubtful = in_folds([2.5] * FOLDS)
    three, six = (claim(doubtful, runs) - FIRST for runs in (3, 6))
    assert six == pytest.approx(2.0 * three)
    assert claim(doubtful, 1) - FIRST == three


@pytest.mark.slow
def test_too_few_runs_are_not_held_out() -> None:
    assert LEAST_RUNS > 3
    told: list[int] = []
    with one_blas_thread():
        few = learn_from(scenes_of(REFERENCE[:3]), told.append)
    assert few.cross_fit.shape == (0, len(LOOKED_FOR))
    assert claim(few) >= FIRST
    assert told == [*range(1, ROUNDS + 1)]
