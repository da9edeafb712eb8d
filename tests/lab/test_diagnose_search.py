"""The search for the best of each cause, where fits lose their way."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from diagnose_runs import Effects, base, known, scenes_of

from flora_lab.diagnose import chance, search
from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.joint import Found, Joint, ready
from flora_lab.effects.catalogue import BY_NAME, CATALOGUE
from flora_lab.effects.effect import Change
from flora_lab.threads import one_blas_thread


class EasilyLost(Joint):
    """Fits that set out from anywhere but from no effect end somewhere bad."""

    lost = 0

    def fit(self, start: Found, iterations: int) -> Found:
        found = super().fit(start, iterations)
        parameters = start.hypothesis.parameters
        if parameters and not np.allclose(start.coordinates, [p.centre for p in parameters]):
            self.lost += 1
            found.evidence -= 1000.0
        return found


def joint_of(kind: type[Joint] = Joint, effects: Effects | None = None) -> Joint:
    scenes = scenes_of((80, 81), effects)
    parts = [chance.covariances(scene, scene.answers(base().mean, Change())) for scene in scenes]
    runs = [ready(scene, base(), own, together=2) for scene, own in zip(scenes, parts, strict=True)]
    return kind(runs, base())


@pytest.mark.parametrize("name", ["growth_rate", "adaptation", "camera_roll"])
def test_one_cause_more_does_not_explain_less(name: str) -> None:
    with one_blas_thread():
        joint = joint_of(EasilyLost)
        before = joint.fit(joint.null(), 12)
        ((effect, fit),) = search.best_of_each(joint, before, [BY_NAME[name]])
    assert effect.name == name
    assert isinstance(joint, EasilyLost)
    assert joint.lost >= 1
    assert fit.hypothesis.names() == (name,)
    assert fit.evidence > before.evidence - 6.0  # what one cause more costs, where it explains nothing


@pytest.mark.parametrize("peak_h", [0.4, 7.0, 12.0, 17.0, 23.0])
def test_a_rhythm_is_found_whenever_it_peaks(peak_h: float) -> None:
    """Less in the evening is more in the morning, to whoever takes all for linear."""
    with one_blas_thread():
        joint = joint_of(effects={"diurnal_growth": {"amplitude": 0.5, "peak_h": peak_h}})
        before = joint.fit(joint.null(), 12)
        ((_, fit),) = search.best_of_each(joint, before, [BY_NAME["diurnal_growth"]])
    told = fit.values()[0]
    assert told["amplitude"] > 0.25
    assert abs((told["peak_h"] - peak_h + 12.0) % 24.0 - 12.0) < 3.0
    assert fit.evidence > before.evidence + 5.0


def test_what_is_looked_at_stays_within_reach() -> None:
    """Evidence is that of a place that can be come to: a rhythm that is less than none explains nothing."""
    cause = next(search.forms_of(BY_NAME["diurnal_growth"]))
    with one_blas_thread():
        joint = joint_of(effects={"diurnal_growth": {"amplitude": 0.5, "peak_h": 3.0}})
        before = joint.fit(joint.null(), 12)
        there, opposite = (joint.screened(before, cause, np.array([0.0, peak_h])) for peak_h in (3.0, 15.0))
    assert there.evidence > before.evidence + 5.0
    assert opposite.values()[0]["amplitude"] == 0.0
    assert opposite.evidence < before.evidence + 0.01


def test_each_search_tells_as_many_causes_as_it_said_that_it_would() -> None:
    said, told = [], []

    def begun(causes: int) -> Callable[[], None]:
        said.append(causes)
        told.append(0)

        def one_more() -> None:
            told[-1] += 1

        return one_more

    with one_blas_thread():
        Explainer(scenes_of((80,), {"draught": {"drive_per_cm_h": 0.2}}), known(), begun).explain()
    assert len(said) > 1
    assert said[0] >= len([effect for effect in CATALOGUE if effect.forms]) - 2
    assert told == said
