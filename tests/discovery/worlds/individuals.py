"""Plants of one kind differ, drift slowly while they grow, and are measured with errors.

Individuals: every constant is drawn log-normally, 10-15 % about the typical plant's. Drift: random processes with
correlation times of 3-8 h add to the bending, its gradient along the zone, growth and the response to light. Form 1
draws its kicks from a distribution with heavy tails and gives every plant a faint quiver besides. Tracking errors are
in :mod:`record`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np

from flora_common.arrays import FloatArray

from . import kernel
from .scene import STEP_H, Plant, Scene

DRIFTS = (kernel.DRIVE_X, kernel.GRADIENT, kernel.GROWTH, kernel.GAIN, kernel.DRIVE_Z)


@dataclass(frozen=True)
class Spread:
    """How much the plants of a case differ and drift, and how well they are tracked.

    Attributes:
        individual: standard deviation of the logarithm of each constant.
        drift: standard deviations, in the order of :data:`DRIFTS`: per cm and hour, the same, relative, relative, per
            cm and hour.
        memory_h: correlation times of the same.
        heavy: kicks and tracking errors have heavy tails and other spectra (form 1).
        quiver_per_cm_h: bending drive of a faint, irregular oscillation that every plant has.
        white_cm: standard deviation of the tracking error of a coordinate from row to row.
        wobble_cm: of its slow part.
        wobble_h: correlation time of the slow part.
        room_c: amplitude of the room's day, degrees Celsius.
    """

    individual: float
    drift: FloatArray
    memory_h: FloatArray
    heavy: bool
    quiver_per_cm_h: float
    white_cm: float
    wobble_cm: float
    wobble_h: float
    room_c: float


def draw_spread(rng: np.random.Generator, form: int) -> Spread:
    """The noise of a case."""
    typical = np.array([0.013, 0.020, 0.07, 0.07, 0.013])
    return Spread(
        individual=float(rng.uniform(0.10, 0.15)),
        drift=typical * np.exp(rng.normal(0.0, 0.25, 5)) * np.array([1.0, 1.0, 1.0, 1.0, float(form == 1)]),
        memory_h=rng.uniform(3.0, 8.0, 5),
        heavy=form == 1,
        quiver_per_cm_h=float(rng.uniform(0.0, 0.02)) if form == 1 else 0.0,
        white_cm=float(rng.uniform(0.03, 0.06)),
        wobble_cm=float(rng.uniform(0.02, 0.04)),
        wobble_h=float(rng.uniform(1.0, 3.0)),
        room_c=float(rng.uniform(1.5, 4.0)),
    )


def draw_plant(rng: np.random.Generator, typical: Plant, spread: Spread) -> Plant:
    """An individual."""
    z = rng.standard_normal(len(fields(Plant)))
    values = {
        part.name: getattr(typical, part.name) * math.exp(spread.individual * float(z[i]))
        for i, part in enumerate(fields(Plant))
    }
    values["initial_length_cm"] = typical.initial_length_cm * math.exp(0.07 * float(z[0]))
    values["lean_rad"] = 0.03 * float(z[1])
    values["curve_u_per_cm"] = 0.008 * float(z[10])
    values["curve_v_per_cm"] = 0.008 * float(z[11]) if spread.heavy else 0.0
    return replace(typical, **values)


def drift(rng: np.random.Generator, steps: int, memory_h: float, heavy: bool = False) -> FloatArray:
    """A stationary random process of unit variance that forgets with the given time, one value each step."""
    keep = math.exp(-STEP_H / memory_h)
    kicks = rng.standard_t(4.0, steps) / math.sqrt(2.0) if heavy else rng.standard_normal(steps)
    kicks *= math.sqrt(1.0 - keep * keep)
    kicks[0] = rng.standard_normal()
    return np.asarray(kernel.first_order(kicks, keep), dtype=np.float64)


def add_drifts(rng: np.random.Generator, scene: Scene, spread: Spread) -> None:
    """The plant's own slow changes, and the room's."""
    steps = len(scene.series)
    for column, size, memory_h in zip(DRIFTS, spread.drift, spread.memory_h, strict=True):
        path = size * drift(rng, steps, memory_h, spread.heavy)
        if column in {kernel.GROWTH, kernel.GAIN}:
            scene.scale_series(column, np.maximum(0.0, 1.0 + path))
        else:
            scene.series[:, column] += path
    phase = 2.0 * math.pi * (np.cumsum(STEP_H / (2.2 * np.exp(0.3 * drift(rng, steps, 4.0)))) + rng.random())
    size = spread.quiver_per_cm_h * np.abs(drift(rng, steps, 5.0))
    scene.series[:, kernel.DRIVE_X] += size * np.cos(phase)
    scene.series[:, kernel.DRIVE_Z] += size * np.sin(phase)
    hour_h = np.arange(steps + 1) * STEP_H
    room = spread.room_c * np.cos(2.0 * math.pi * (hour_h - 15.0) / 24.0)
    scene.temperature_c = 22.0 + room + 0.8 * drift(rng, steps + 1, 6.0)
