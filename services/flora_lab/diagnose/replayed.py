"""Measured runs beside what the simulator makes of them, every five minutes: whole stems, free and one step ahead."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose.joint import Base
from flora_lab.diagnose.scene import Lanes, Scene
from flora_lab.diagnose.virtual_plants import tips_between
from flora_lab.effects.effect import Change
from flora_lab.simulator.law import Stems, standing
from flora_lab.simulator.shape import can_start, rods_through
from flora_lab.simulator.terms import Seen, undriven

Plant = Literal["typical", "own"]
"""The typical plant, or one with constants fitted to the very run that it is to follow."""
PLANTS: Final[tuple[Plant, ...]] = ("typical", "own")

MM: Final = 10.0
ONE_STEP_EVERY: Final = 3
"""Stems from which one step is simulated: each third one, since those between tell nearly the same."""
_LIT: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Replayed:
    """One run; a row per step, at its end.

    Attributes:
        name: of the run.
        step_h: from row to row.
        time_h: since the first stem, shape (n,).
        light: levels of the left and right lamp in the step before each row, shape (n, 2).
        since_h: since the lamps changed last, or since the start, shape (n,).
        measured_cm: shape (n, 10, 2); NaN where no stem was measured.
        typical_cm: what the typical plant does from the first stem on, never told of another one.
        own_cm: the same for a plant with constants fitted to this very run.
        step_rows: rows before which a stem was measured that a step was simulated from, shape (m,).
        step_error_cm: measured minus simulated after that one step, shape (m, 10, 2).
        chance_cm: between which 9 of 10 tips of virtual plants lie, shape (2, n, 2).
    """

    name: str
    step_h: float
    time_h: Array
    light: Array
    since_h: Array
    measured_cm: Array
    typical_cm: Array
    own_cm: Array
    step_rows: Array
    step_error_cm: Array
    chance_cm: Array

    def simulated_cm(self, plant: Plant) -> Array:
        """Stems of one of the simulated plants, shape (n, 10, 2)."""
        return self.typical_cm if plant == "typical" else self.own_cm

    def error_mm(self, plant: Plant) -> Array:
        """Measured minus simulated, shape (n, 10, 2)."""
        return np.asarray(MM * (self.measured_cm - self.simulated_cm(plant)))

    @property
    def is_left(self) -> Array:
        """Where the left lamp alone shone, shape (n,)."""
        return np.asarray((self.light[:, 0] > _LIT) & (self.light[:, 1] <= _LIT))

    @property
    def is_right(self) -> Array:
        """Where the right lamp alone shone, shape (n,)."""
        return np.asarray((self.light[:, 1] > _LIT) & (self.light[:, 0] <= _LIT))


def replayed(scene: Scene, base: Base, mean: Array, traits: Array, start: Array, change: Change) -> Replayed:
    """A run and what the simulator makes of it.

    Args:
        scene: the run.
        base: what is known of plants.
        mean: traits of the typical plant, shape (9,).
        traits, start: of the plant with constants of its own, shapes (9,) and (2,).
        change: what has been added to the simulator.
    """
    lanes = Lanes(np.stack([mean, traits]) + change.traits, np.stack([np.zeros(2), start]), [change, change])
    stems = scene.points(lanes, every=1)
    time_h = (np.arange(scene.steps) + 1) * scene.step_h
    rows, errors = _one_step(scene, mean, change)
    return Replayed(
        name=scene.run.name,
        step_h=scene.step_h,
        time_h=time_h,
        light=scene.light,
        since_h=_since(scene.light, scene.step_h),
        measured_cm=scene.run.points_cm[1 : scene.steps + 1],
        typical_cm=stems[:, 0],
        own_cm=stems[:, 1],
        step_rows=rows,
        step_error_cm=errors,
        chance_cm=tips_between(scene, base, mean, change, length_cm(stems[:, 0])),
    )


def length_cm(stems_cm: Array) -> Array:
    """Of stems (..., 10, 2), shape (...)."""
    return np.asarray(np.linalg.norm(np.diff(stems_cm, axis=-2), axis=-1).sum(axis=-1))


def _since(light: Array, step_h: float) -> Array:
    changed = np.concatenate([[True], (np.abs(np.diff(light, axis=0)) > _LIT).any(axis=1)])
    at = np.arange(len(light))
    last = np.maximum.accumulate(np.where(changed, at, 0))
    return np.asarray((at - last + 1) * step_h)


def _one_step(scene: Scene, traits: Array, change: Change) -> tuple[Array, Array]:
    """Rows, and the errors after one step from the measured stem before them.

    What a plant remembers follows from the lamps alone, so it is taken from a plant that saw the same ones.
    """
    light = scene.shone(change)
    points = scene.run.points_cm[: scene.steps + 1]
    seen = np.isfinite(points[:, -1, 0])
    # A stem that lies on the soil is not one to start from.
    rows = np.nonzero(can_start(points)[:-1] & seen[1:])[0][::ONE_STEP_EVERY]
    own, terms = (traits + change.traits)[None], scene.terms_with(change)
    walker = standing(scene.law, scene.first_cm[None])
    memories = np.empty((len(rows), *walker.memory.shape[1:]))
    place = {int(row): k for k, row in enumerate(rows)}
    nothing = np.empty((0, 1, *points.shape[1:]))
    for row in range(scene.steps):
        if row in place:
            memories[place[row]] = walker.memory[0]
        driven = undriven(light[row : row + 1, None], scene.warmth_c[row : row + 1, None])
        seen_by = Seen(np.zeros((0, 1)), np.ones(1))
        scene.law.advance_with(walker, own, terms[None], driven, seen_by, scene.step_h, 2, nothing)
    turn = change.turned_rad(rows * scene.step_h)
    length, angle, count = rods_through(points[rows])
    stems = Stems(length / change.scale, angle - turn[:, None], count, memories)
    lanes = len(rows)
    out = np.empty((1, lanes, *points.shape[1:]))
    scene.law.advance_with(
        stems,
        np.repeat(own, lanes, axis=0),
        np.repeat(terms[None], lanes, axis=0),
        undriven(light[rows][None], scene.warmth_c[rows][None]),
        Seen(turn[None], np.full(lanes, change.scale)),
        scene.step_h,
        1,
        out,
    )
    return rows, points[rows + 1] - out[0]
