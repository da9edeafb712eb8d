"""Virtual plants: individuals to which things happen by chance, as the reference runs tell, and how they differ."""

from __future__ import annotations

from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose import chance
from flora_lab.diagnose.joint import Base
from flora_lab.diagnose.scene import KNOT_H, USUAL, Lanes, Scene
from flora_lab.effects.effect import Change
from flora_lab.simulator.drives import REFERENCE_CM

PLANTS: Final = 40
BETWEEN: Final = (5.0, 95.0)
"""Percentiles: 9 of 10 lie between."""
_SEED: Final = 20181
_JITTER: Final = 1e-9
_LEAST_SHARE: Final = 0.05
"""Of growth and of the lamps' pull, that is left whatever happens."""


def tips_between(scene: Scene, base: Base, mean: Array, change: Change, length_cm: Array) -> Array:
    """Between which 9 of 10 tips lie on the schedule of a run, shape (2, steps, 2).

    Args:
        scene: the run.
        base: how plants differ, and what happens to them by chance.
        mean: traits of the typical plant, shape (9,).
        change: what has been added to the simulator.
        length_cm: of the typical stem after each step, shape (steps,).
    """
    rng = np.random.default_rng(_SEED)
    spread = base.spread + base.doubt
    traits = mean + change.traits + rng.standard_normal((PLANTS, len(mean))) @ np.linalg.cholesky(spread).T
    drives = {name: np.full((scene.steps, PLANTS), usual) for name, usual in USUAL.items()}
    for part, size in zip(chance.PARTS, base.sizes, strict=True):
        if part.drive in drives:
            drives[part.drive] += size * _course(rng, part, scene, length_cm)
    for name in ("growth", "gain"):
        drives[name] = np.maximum(drives[name], _LEAST_SHARE)
    tips = scene.points(Lanes(traits, np.zeros((PLANTS, 2)), [change] * PLANTS), drives, every=1)[:, :, -1]
    return np.asarray(np.percentile(tips, BETWEEN, axis=1))


def _course(rng: np.random.Generator, part: chance.Part, scene: Scene, length_cm: Array) -> Array:
    """What one part does over a run if its size is 1, shape (steps, PLANTS)."""
    per_knot = max(1, round(KNOT_H[part.drive] / scene.step_h))
    knots = -(-scene.steps // per_knot)
    at_h = (np.arange(knots) + 0.5) * per_knot * scene.step_h
    values, directions = np.linalg.eigh(chance.over_time(part, at_h))
    root = directions * np.sqrt(np.maximum(values, _JITTER))
    course = np.repeat(root @ rng.standard_normal((knots, PLANTS)), per_knot, axis=0)[: scene.steps]
    if part.name.startswith("nutation"):
        course = course * ((length_cm / REFERENCE_CM) ** 2)[:, None]
    return np.asarray(course)
