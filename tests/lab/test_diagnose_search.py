"""The search for the best of each cause, where fits lose their way."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose_runs import base, scenes_of

from flora_lab.diagnose import chance, search
from flora_lab.diagnose.joint import Found, Joint, ready
from flora_lab.effects.catalogue import BY_NAME
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


def easily_lost() -> EasilyLost:
    scenes = scenes_of((80, 81))
    parts = [chance.covariances(scene, scene.answers(base().mean, Change())) for scene in scenes]
    runs = [ready(scene, base(), own, together=2) for scene, own in zip(scenes, parts, strict=True)]
    return EasilyLost(runs, base())


@pytest.mark.parametrize("name", ["growth_rate", "adaptation", "camera_roll"])
def test_one_cause_more_does_not_explain_less(name: str) -> None:
    with one_blas_thread():
        joint = easily_lost()
        before = joint.fit(joint.null(), 12)
        ((effect, fit),) = search.best_of_each(joint, before, [BY_NAME[name]])
    assert effect.name == name
    assert joint.lost >= 1
    assert fit.hypothesis.names() == (name,)
    assert fit.evidence > before.evidence - 6.0  # what one cause more costs, where it explains nothing
