"""A few hidden effects, drawn by seeds fixed beforehand, have to be found; healthy runs must be left alone.

`make discovery` judges hundreds. Here a handful is enough to see that the finder still finds: one of each kind in
`make test`, some two minutes of two cores, and four more in `make test-slow`.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from flora_lab.diagnose.diagnosis import NamedCause, Verdict
from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.inputs import read_reference, read_runs
from flora_lab.diagnose.knowledge import learn_from
from flora_lab.diagnose.verdict import left_of, named, verdict_of
from flora_lab.threads import one_blas_thread

from .scoring import named_as_a_pair
from .worlds.case import Case, draw_case
from .worlds.writing import write_case

LOUD = (
    "circumnutation",
    "phototropic_latency",
    "clock_offset",
    "clock_skew",
    "draught",
    "sag",
    "camera_drift",
    "diurnal_growth",
    "temperature_growth",
    "adaptation",
)
"""Effects that three runs tell nearly always at typical strength. What is as large as plants differ is counted by
`make discovery`, over many cases."""
LASTING = ("gain_rhythm", "light_history", "growth_stop", "tip_broken", "shadow")
HIDDEN = ((0, 7_001), (0, 7_002), (0, 7_003), (1, 7_004))
"""Form of the physics, and seed; how strong the effect is follows from the seed."""
WHICH = 7_000
"""Seed that decides on the effects."""
NOTHING = ((0, 7_101), (1, 7_102))
OUTSIDE = (0, 7_201)
QUICK = (7_003, 7_102, 7_201)
CORES = 2


@dataclass(frozen=True)
class Answer:
    """What was hidden, and what was found."""

    hidden: frozenset[str]
    verdict: Verdict
    causes: list[NamedCause]

    @property
    def is_right(self) -> bool:
        if not self.causes:
            return False
        first = self.causes[0]
        if first.effect in self.hidden:
            return True
        return named_as_a_pair(first.effect, first.confusable_with, self.hidden) is not None


def _answer(case: Case, folder: Path) -> Answer:
    write_case(case, folder)
    runs = read_runs(sorted((folder / "measured").iterdir()))
    reference = read_reference(folder / "reference", runs)
    usual_c = reference.usual_temperature_c()
    with one_blas_thread():
        numba.set_num_threads(1)
        known = learn_from(reference.scenes(usual_c))
        explanation = Explainer(runs.scenes(usual_c), known).explain()
    left = left_of(explanation, known)
    causes = named(explanation, left)
    return Answer(frozenset(hidden.name for hidden in case.hidden), verdict_of(causes, left), causes)


def _hidden() -> list[Case]:
    effects = np.random.default_rng(WHICH).choice(LOUD, len(HIDDEN), replace=False).tolist()
    return [
        draw_case(seed, form=form, kind="single", effect=effect)
        for (form, seed), effect in zip(HIDDEN, effects, strict=True)
    ]


def _outside() -> Case:
    form, seed = OUTSIDE
    return draw_case(seed, form=form, kind="outside", effect=str(np.random.default_rng(seed).choice(LASTING)))


def _some(seeds: Sequence[int]) -> list[Any]:
    """Of these, those that are not quick take their time."""
    return [seed if seed in QUICK else pytest.param(seed, marks=pytest.mark.slow) for seed in seeds]


@pytest.fixture(scope="module")
def answers(
    tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest
) -> Iterator[dict[int, Future[Answer]]]:
    """By seed, of the tests that are to run. A case is half a minute of one core."""
    wanted = {item.callspec.params["seed"] for item in request.session.items if item.module is request.module}
    cases = [*_hidden(), *(draw_case(seed, form=form, kind="none") for form, seed in NOTHING), _outside()]
    folder = tmp_path_factory.mktemp("cases")
    with ProcessPoolExecutor(CORES, multiprocessing.get_context("spawn")) as pool:
        yield {case.seed: pool.submit(_answer, case, folder / str(case.seed)) for case in cases if case.seed in wanted}
        pool.shutdown(cancel_futures=True)


@pytest.mark.parametrize("seed", _some([seed for _, seed in HIDDEN]))
def test_a_hidden_effect_is_named_first(seed: int, answers: dict[int, Future[Answer]]) -> None:
    answer = answers[seed].result()
    assert answer.is_right, f"{sorted(answer.hidden)}: {answer.verdict} {[c.effect for c in answer.causes]}"


@pytest.mark.parametrize("seed", _some([seed for _, seed in NOTHING]))
def test_healthy_runs_are_left_alone(seed: int, answers: dict[int, Future[Answer]]) -> None:
    answer = answers[seed].result()
    assert answer.verdict == "nothing_wrong", [c.evidence for c in answer.causes]


@pytest.mark.parametrize("seed", _some([OUTSIDE[1]]))
def test_what_is_outside_the_catalogue_gets_no_name(seed: int, answers: dict[int, Future[Answer]]) -> None:
    """Of what follows the clock or the light, which hits the whole run: a wall may never be touched."""
    answer = answers[seed].result()
    assert answer.verdict == "unexplained", _outside().hidden
    assert all(cause.confidence < 0.5 for cause in answer.causes), [c.evidence for c in answer.causes]
