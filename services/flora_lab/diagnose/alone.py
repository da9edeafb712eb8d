"""Each run explained by itself, without a cause: where a search for causes that act in all of them begins."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from flora_lab.diagnose import chance
from flora_lab.diagnose.hypothesis import Hypothesis
from flora_lab.diagnose.joint import Base, Found, Joint, ready
from flora_lab.diagnose.scene import Scene
from flora_lab.effects.effect import Change

_BADLY: Final = 1.5
"""So many times the misfit of the best run one is begun again with."""


def side_by_side(scenes: Sequence[Scene], base: Base) -> Found:
    """All runs, each as it is by itself; one that ended badly once more from where the others did.

    Args:
        scenes: the runs.
        base: what is known of plants.
    """
    base = base.of_single_runs()
    joints = []
    for scene in scenes:
        parts = chance.covariances(scene, scene.answers(base.mean, Change()))
        joints.append(Joint([ready(scene, base, parts, together=0)], base))
    fits = [joint.fit(joint.null()) for joint in joints]
    usual = min(fit.misfit / scene.size for fit, scene in zip(fits, scenes, strict=True))
    best = []
    for joint, scene, fit in zip(joints, scenes, fits, strict=True):
        tried = [fit]
        if fit.misfit / scene.size > _BADLY * usual:
            starts = [other for other in fits if other is not fit]
            tried += [joint.fit(Found(Hypothesis(), np.zeros(0), o.traits.copy(), o.start * 0.0)) for o in starts]
        best.append(min(tried, key=lambda one: one.misfit))
    traits, start = (np.concatenate([getattr(fit, name) for fit in best]) for name in ("traits", "start"))
    return Found(Hypothesis(), np.zeros(0), traits, start)
