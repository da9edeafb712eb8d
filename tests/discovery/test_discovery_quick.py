"""A few hidden effects, drawn by seeds fixed beforehand, have to be found; healthy runs must be left alone.

`make discovery` judges hundreds. Here a handful is enough to see that the finder still finds: three in `make test`,
against the same healthy plants, which are learned once, and seven more in `make test-slow`. What has no name is tried
in small in tests/lab/test_diagnose_unnamed.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flora_lab.diagnose.cross_fit import learn_from
from flora_lab.diagnose.diagnosis import NamedCause, Verdict
from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.inputs import Runs, read_reference, read_runs
from flora_lab.diagnose.knowledge import Knowledge, known_of
from flora_lab.diagnose.learn import learned
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
WHICH = 7_000
"""Seed that decides on the effects."""
HIDDEN = ((0, 7_001), (0, 7_002), (0, 7_003), (1, 7_004))
"""Form of the physics, and seed; how strong the effect is follows from the seed."""
NOTHING = ((0, 7_003), (0, 7_101), (1, 7_102))
OUTSIDE = ((0, 7_003), (0, 7_201))
QUICK = (0, 7_003)


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
    write_case(case, folder / "case")
    runs = read_runs(sorted((folder / "case" / "measured").iterdir()))
    reference = read_reference(folder / "case" / "reference", runs)
    known = _learned((case.form, case.seed), reference)
    with one_blas_thread():
        explanation = Explainer(runs.scenes(reference.usual_temperature_c()), known).explain()
    left = left_of(explanation, known)
    causes = named(explanation, left)
    return Answer(frozenset(hidden.name for hidden in case.hidden), verdict_of(causes, left), causes)


_LEARNED: dict[tuple[int, int], Knowledge] = {}


def _learned(world: tuple[int, int], reference: Runs) -> Knowledge:
    """Healthy runs follow from form and seed alone. Which law they are under, and what they show in each other, takes
    its time, and is asked where there is some."""
    if world not in _LEARNED:
        scenes = reference.scenes(reference.usual_temperature_c())
        with one_blas_thread():
            _LEARNED[world] = known_of(scenes, learned(scenes), ()) if world == QUICK else learn_from(scenes)
    return _LEARNED[world]


def _some(worlds: tuple[tuple[int, int], ...]) -> list[Any]:
    """Of these, those that are not quick take their time."""
    slow = pytest.mark.slow
    return [pytest.param(*world, marks=[] if world == QUICK else slow, id=f"{world[1]}") for world in worlds]


@pytest.mark.parametrize(("form", "seed"), _some(HIDDEN))
def test_a_hidden_effect_is_named_first(form: int, seed: int, tmp_path: Path) -> None:
    effects = np.random.default_rng(WHICH).choice(LOUD, len(HIDDEN), replace=False).tolist()
    effect = effects[HIDDEN.index((form, seed))]
    answer = _answer(draw_case(seed, form=form, kind="single", effect=effect), tmp_path)
    assert answer.is_right, f"{sorted(answer.hidden)}: {answer.verdict} {[c.effect for c in answer.causes]}"


def test_two_hidden_effects_are_both_named(tmp_path: Path) -> None:
    form, seed = QUICK
    answer = _answer(draw_case(seed, form=form, kind="pair"), tmp_path)
    assert {cause.effect for cause in answer.causes} == answer.hidden, [c.evidence for c in answer.causes]


@pytest.mark.parametrize(("form", "seed"), _some(NOTHING))
def test_healthy_runs_are_left_alone(form: int, seed: int, tmp_path: Path) -> None:
    answer = _answer(draw_case(seed, form=form, kind="none"), tmp_path)
    assert answer.verdict == "nothing_wrong", [c.evidence for c in answer.causes]


@pytest.mark.slow
@pytest.mark.parametrize(("form", "seed"), OUTSIDE)
def test_what_is_outside_the_catalogue_gets_no_name(form: int, seed: int, tmp_path: Path) -> None:
    """Of what follows the clock or the light, which hits the whole run: a wall may never be touched."""
    effect = str(np.random.default_rng(seed).choice(LASTING))
    answer = _answer(draw_case(seed, form=form, kind="outside", effect=effect), tmp_path)
    assert answer.verdict == "unexplained", answer.hidden
    assert all(cause.confidence < 0.5 for cause in answer.causes), [c.evidence for c in answer.causes]
