"""A black box beside the causes: gradient boosting that learns what a simulator gets wrong in one step.

It names nothing and needs no catalogue. Running free, what it adds in each step it meets again in the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor
from threadpoolctl import threadpool_limits

from flora_common.arrays import Array
from flora_common.shapes import STEM_POINTS
from flora_lab.diagnose.replayed import Replayed
from flora_lab.diagnose.scene import Scene
from flora_lab.simulator.law import Stems, standing
from flora_lab.simulator.shape import can_start, rods_through
from flora_lab.simulator.terms import Seen, undriven

LEARNED: Final = ((9, 0), (9, 1), (6, 0), (3, 0))
"""Point and axis of the residuals that are learned; those of the points between lie between."""
_TREES: Final = 60
_LEAVES: Final = 15
_FEWEST: Final = 20
"""Stems in a leaf."""


@dataclass(frozen=True, slots=True)
class BlackBox:
    """What is added to a simulated stem after each step.

    Attributes:
        models: one per place of :data:`LEARNED`.
    """

    models: tuple[Any, ...]

    def residual_cm(self, seen: Array) -> Array:
        """Of stems, shape (n, 10, 2).

        Args:
            seen: what :func:`seen` tells of each, shape (n, 23).
        """
        return _along(np.stack([np.asarray(model.predict(seen)) for model in self.models], axis=1))


def seen(stems_cm: Array, light: Array, since_h: Array, time_h: Array, warmth_c: Array) -> Array:
    """What the black box is shown before a step, shape (n, 23).

    Args:
        stems_cm: shape (n, 10, 2).
        light: levels in the step, shape (n, 2).
        since_h, time_h: hours since the last switch and since the start, at the end of the step, shape (n,).
        warmth_c: how much warmer it is than in the reference runs, shape (n,).
    """
    points = stems_cm[:, 1:].reshape(len(stems_cm), -1)
    return np.concatenate([points, light, since_h[:, None], time_h[:, None], warmth_c[:, None]], axis=1)


def learned(scenes: Sequence[Scene], runs: Sequence[Replayed]) -> BlackBox:
    """Learn from what the simulator got wrong in one step.

    Args:
        scenes: the runs to learn from.
        runs: the same, with what the simulator made of each.
    """
    shown = np.concatenate([_seen_of(scene, run) for scene, run in zip(scenes, runs, strict=True)])
    wrong = np.concatenate([run.step_error_cm for run in runs])
    models = []
    with threadpool_limits(limits=1):
        for point, axis in LEARNED:
            model = HistGradientBoostingRegressor(
                max_iter=_TREES,
                max_leaf_nodes=_LEAVES,
                min_samples_leaf=_FEWEST,
                early_stopping=False,
                random_state=1,
            )
            models.append(model.fit(shown, wrong[:, point, axis]))
    return BlackBox(tuple(models))


def one_step_error_cm(scene: Scene, run: Replayed, box: BlackBox) -> Array:
    """Measured minus predicted stems of a run, one step after a measured one, shape (m, 10, 2)."""
    return np.asarray(run.step_error_cm - box.residual_cm(_seen_of(scene, run)))


def run_freely(scene: Scene, run: Replayed, traits: Array, box: BlackBox) -> Array:
    """Stems after each step of a run, from its first one on, shape (steps, 10, 2).

    Args:
        scene: the run.
        run: what the simulator makes of it.
        traits: of the simulated plant, shape (9,).
        box: corrects each of its steps.
    """
    out = np.empty((scene.steps, STEM_POINTS, 2))
    stems = standing(scene.law, scene.first_cm[None])
    told = stems.points_cm
    shown = Seen(np.zeros((1, 1)), np.ones(1))
    with threadpool_limits(limits=1):  # one stem at a time: threads would only wait
        for k in range(scene.steps):
            now = slice(k, k + 1)
            added = box.residual_cm(
                seen(told, scene.light[now], run.since_h[now], run.time_h[now], scene.warmth_c[now])
            )
            driven = undriven(scene.light[now, None], scene.warmth_c[now])
            scene.law.advance_with(
                stems, traits[None], scene.law.terms[None], driven, shown, scene.step_h, 1, out[now, None]
            )
            told = out[now] + added
            out[k] = told[0]
            if can_start(told)[0]:  # else the box has corrected the stem away, and the simulator's own goes on
                stems = Stems(*rods_through(told), stems.memory)
    return out


def _seen_of(scene: Scene, run: Replayed) -> Array:
    rows = run.step_rows
    before = scene.run.points_cm[rows]
    return seen(before, scene.light[rows], run.since_h[rows], run.time_h[rows], scene.warmth_c[rows])


def _along(told: Array) -> Array:
    """Residuals of whole stems from those of the places that were learned, shape (n, 10, 2)."""
    found = np.zeros((len(told), STEM_POINTS, 2))
    at = np.arange(STEM_POINTS)
    sideways = {point: told[:, k] for k, (point, axis) in enumerate(LEARNED) if axis == 0}
    known = [0, *sorted(sideways)]
    values = np.stack([np.zeros(len(told)), *(sideways[point] for point in known[1:])], axis=1)
    found[:, :, 0] = np.stack([np.interp(at, known, row) for row in values])
    found[:, :, 1] = told[:, LEARNED.index((9, 1)), None] * at / (STEM_POINTS - 1)
    return found
