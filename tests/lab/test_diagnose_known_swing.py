"""A diagnosis from a simulator whose plants swing by themselves: that is no news, and hides nothing else."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from diagnose_runs import known, scenes_of

from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.explanation import Explanation
from flora_lab.diagnose.knowledge import Knowledge
from flora_lab.diagnose.known_swing import swing_of, with_swing
from flora_lab.diagnose.residuals import SWING_PERIODS_H, residuals_of
from flora_lab.diagnose.rhythm import amplitude_of
from flora_lab.diagnose.scene import Scene
from flora_lab.diagnose.verdict import left_of, named, verdict_of
from flora_lab.simulator.extended import change_of
from flora_lab.simulator.store import Extension
from flora_lab.threads import one_blas_thread

PERIOD_H, AMPLITUDE_CM, COHERENCE_H = 1.7, 0.8, 30.0


@functools.cache
def swinging() -> Knowledge:
    told = [Extension("circumnutation", {"period_h": PERIOD_H, "amplitude_cm": AMPLITUDE_CM})]
    swing = swing_of(told, COHERENCE_H)
    assert swing is not None
    return with_swing(known(), swing)


def explained(scenes: list[Scene], start: Knowledge) -> Explanation:
    with one_blas_thread():
        return Explainer(scenes, start).explain()


def verdict(scenes: list[Scene], explanation: Explanation, start: Knowledge) -> str:
    left = left_of(explanation, start)
    return verdict_of(named(explanation, left), left, False)


def names(explanation: Explanation) -> list[str]:
    return [one.tried.effect.name for one in explanation.accepted]


@pytest.mark.parametrize("more", [0.75, 1.0, 1.35])
def test_plants_that_swing_as_the_simulators_do_are_right(more: float) -> None:
    """Some of them wider than others."""
    scenes, start = scenes_of((82, 83), swing=(PERIOD_H, more * AMPLITUDE_CM)), swinging()
    explanation = explained(scenes, start)
    assert names(explanation) == []
    assert verdict(scenes, explanation, start) == "nothing_wrong"
    said, _ = residuals_of(scenes, start.base, explanation.null, start.residuals)
    assert "swings" not in said.description
    without, _ = residuals_of(scenes, start.base, explanation.null, known().residuals)
    assert "The tip swings by" in without.description or "the tip swings by" in without.description


def test_what_else_is_wrong_with_swinging_plants_is_named() -> None:
    scenes = scenes_of((80, 81), {"growth_rate": {"factor": 1.5}}, swing=(PERIOD_H, AMPLITUDE_CM))
    explanation = explained(scenes, swinging())
    assert names(explanation) == ["growth_rate"]
    assert verdict(scenes, explanation, swinging()) == "explained"


def test_a_swing_is_a_part_of_what_is_usual() -> None:
    before, after = known(), swinging()
    assert after.swing is not None
    grid = before.swings.per_hour
    added = after.swings.power - before.swings.power
    assert 1.0 / grid[np.argmax(added)] == pytest.approx(PERIOD_H, rel=0.05)
    assert float(amplitude_of(np.trapezoid(added, grid))) == pytest.approx(AMPLITUDE_CM, rel=0.2)
    curve = np.median(after.residuals.shown.swing_mm, axis=0)
    assert SWING_PERIODS_H[np.argmax(curve)] == pytest.approx(PERIOD_H, rel=0.05)


def test_of_swings_one_after_another_the_last_one_counts_as_in_the_simulator() -> None:
    told = [
        Extension("circumnutation", {"period_h": 1.5, "amplitude_cm": 0.3}),
        Extension("growth_rate", {"factor": 1.2}),
        Extension("circumnutation", {"period_h": 1.6, "amplitude_cm": 0.4}),
    ]
    swing, change = swing_of(told, COHERENCE_H), change_of(told, "test")
    assert swing is not None
    assert (swing.period_h, swing.amplitude_cm, swing.coherence_h) == (1.6, 0.4, COHERENCE_H)
    assert (change.rhythm_h, change.rhythm_cm) == (swing.period_h, swing.amplitude_cm)
    assert swing_of(told[1:2], COHERENCE_H) is None
