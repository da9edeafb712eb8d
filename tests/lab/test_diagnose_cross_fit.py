"""What the search finds in reference runs that are held out, and how much more a cause needs for it."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from diagnose_runs import REFERENCE, change_of, known, scene_of, scenes_of

from flora_lab.diagnose.cross_fit import FOLDS, LEAST_RUNS, ROUNDS, learn_from
from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.explanation import FIRST
from flora_lab.diagnose.knowledge import Knowledge
from flora_lab.effects.law_forms import AS_WRITTEN
from flora_lab.threads import one_blas_thread


@functools.cache
def not_alike() -> Knowledge:
    """The camera was rolled to one side in a third of the reference, and to the other in a third."""
    rolled = [change_of({"camera_roll": {"angle_deg": 7.0 * side}}) for side in (-1.0, 0.0, 1.0)]
    with one_blas_thread():
        return learn_from([scene_of(seed, change=rolled[seed % FOLDS]) for seed in REFERENCE], laws=AS_WRITTEN)


def claim(one: Knowledge, runs: int = 3) -> float:
    return Explainer(scenes_of(range(30, 30 + runs)), one).claims.first


def test_healthy_runs_show_next_to_nothing_in_each_other() -> None:
    assert known().cross_fit.shape == (FOLDS,)
    assert known().cross_fit.max() < FIRST
    assert claim(known()) < FIRST + 1.0


def test_a_reference_that_is_not_alike_shows_causes_in_itself_and_asks_for_more() -> None:
    found = not_alike().cross_fit
    assert min(found[0], found[2]) > 1.0  # the folds with the rolled cameras
    assert claim(not_alike()) > claim(known()) + 1.0


def test_what_is_asked_grows_with_what_was_found_up_to_a_bound() -> None:
    asked = [claim(replace(known(), cross_fit=np.full(FOLDS, nats))) for nats in (-3.0, 1.5, 2.0, 3.0, 30.0, 300.0)]
    assert asked[0] == asked[1] == FIRST  # as much is chance
    assert asked == sorted(asked)
    assert asked[1] < asked[2] < asked[3] < asked[4] == asked[5]
    one_odd_plant = np.array([0.0, 0.3, 30.0])
    assert claim(replace(known(), cross_fit=one_odd_plant)) == FIRST


def test_errors_of_the_law_add_up_over_runs() -> None:
    doubtful = replace(known(), cross_fit=np.full(FOLDS, 2.5))
    three, six = (claim(doubtful, runs) - FIRST for runs in (3, 6))
    assert six == pytest.approx(2.0 * three)
    assert claim(doubtful, 1) - FIRST == three


def test_too_few_runs_are_not_held_out() -> None:
    assert LEAST_RUNS > 3
    told: list[int] = []
    with one_blas_thread():
        few = learn_from(scenes_of(REFERENCE[:3]), told.append)
    assert few.cross_fit.shape == (0,)
    assert claim(few) >= FIRST
    assert told == [*range(1, ROUNDS + 1)]
