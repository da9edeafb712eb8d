"""A simulated plant so simple that its errors can be worked out on paper, and runs of the plant that it simulates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from flora_common.arrays import Array, FloatArray
from flora_common.errors import BadInput
from flora_common.runs import LEVELS, TRACK_HEADER, Light, track_line
from flora_lab.simulator.interface import Chance, Covariates, History, Simulator
from flora_lab.simulator.measured import MeasuredRun
from flora_lab.simulator.store import Provenance, Stored, write_simulator

STEP_S = 300.0
ALONG = np.arange(10) / 9.0
GROWTH_CM_H = 0.12
LEAN_CM_H = 0.3


def upright(count: int = 1, height_cm: float = 8.0) -> FloatArray:
    """So many straight stems above their anchor, shape (count, 10, 2), cm."""
    return np.repeat(np.linspace(0.0, 1.0, 10)[None, :, None] * np.array([0.0, height_cm]), count, axis=0)


@dataclass(frozen=True, slots=True)
class Straight:
    """Tips, shape (batch, 2), and how fast each plant grows, shape (batch,)."""

    tip_cm: FloatArray
    growth_cm_h: FloatArray


class StraightPlant(Simulator[Straight]):
    """A straight stem whose tip rises steadily and goes to the lit lamp at a steady pace, ``speed`` times too fast.

    Its stems are shifted to the right by ``shift_cm`` (the anchor is not). After watching it grows as the plant did.
    """

    kind: ClassVar[str] = "straight"

    def __init__(self, *, speed: float = 1.0, shift_cm: float = 0.0, beyond_cm: float = 1e9) -> None:
        self.speed, self.shift_cm, self.beyond_cm = speed, shift_cm, beyond_cm
        self.step_s = STEP_S

    @classmethod
    def from_stored(cls, stored: Stored) -> StraightPlant:
        return cls(speed=stored.scale("speed"), shift_cm=stored.scale("shift_cm"), beyond_cm=stored.scale("beyond_cm"))

    def start(self, points_cm: FloatArray, chance: Chance | None = None, before: FloatArray | None = None) -> Straight:
        return Straight(points_cm[:, -1].copy(), np.full(len(points_cm), GROWTH_CM_H))

    def watch(self, history: History) -> Straight:
        hours = (len(history.points_cm) - 1) * history.step_s / 3600.0
        rise = history.points_cm[-1, :, -1, 1] - history.points_cm[0, :, -1, 1]
        growth = rise / hours if hours else np.full(len(rise), GROWTH_CM_H)
        return Straight(history.points_cm[-1, :, -1].copy(), growth)

    def step(
        self, state: Straight, light: FloatArray, dt_s: float, covariates: Covariates | None = None
    ) -> tuple[Straight, FloatArray]:
        if not 0.0 < dt_s < 1e6:
            raise BadInput(f"a step of {dt_s:g} s")
        if (light.sum(axis=1) != 1.0).any():
            raise BadInput("light is not one lamp; this plant knows left and right only")
        hours = self.speed * dt_s / 3600.0
        move = np.stack([LEAN_CM_H * (light[:, 1] - light[:, 0]), state.growth_cm_h], axis=-1)
        after = Straight(state.tip_cm + hours * move, state.growth_cm_h)
        return after, self.stems_cm(after)

    def stems_cm(self, state: Straight) -> FloatArray:
        stems = ALONG[:, None] * state.tip_cm[:, None, :]
        stems[:, 1:, 0] += self.shift_cm
        return stems

    def is_beyond_data(self, state: Straight) -> Array:
        return state.tip_cm[:, 1] > self.beyond_cm


def straight_run(
    name: str = "run",
    plant: str = "",
    *,
    hours: float = 72.0,
    growth_cm_h: float = GROWTH_CM_H,
    tip_cm: tuple[float, float] = (0.0, 9.0),
    lamps_h: float = 6.0,
    missing: Sequence[int] = (),
) -> MeasuredRun:
    """What the plant of :class:`StraightPlant` really does, at speed 1, under lamps that alternate."""
    count = round(hours * 3600.0 / STEP_S)
    per_lamp = round(lamps_h * 3600.0 / STEP_S)
    light = np.array([LEVELS["left" if k // per_lamp % 2 == 0 else "right"] for k in range(count)])
    move = np.stack([LEAN_CM_H * (light[:, 1] - light[:, 0]), np.full(count, growth_cm_h)], axis=-1)
    tips = np.array(tip_cm) + np.concatenate([np.zeros((1, 2)), np.cumsum(move * STEP_S / 3600.0, axis=0)])
    points = ALONG[:, None] * tips[:, None, :]
    points[list(missing)] = np.nan
    time_s = np.arange(count + 1, dtype=np.float64) * STEP_S
    return MeasuredRun(name, plant or name, "0" * 64, points, light, time_s, STEP_S, {})


def half_as_often(run: MeasuredRun) -> MeasuredRun:
    """The same plant, of which every second photograph was taken; its lamps change with these."""
    assert not run.covariates
    return replace(
        run, points_cm=run.points_cm[::2], light=run.light[::2], time_s=run.time_s[::2], step_s=2.0 * run.step_s
    )


def write_track(path: Path, run: MeasuredRun) -> Path:
    """A run as a track; rows without a stem are left out."""
    names: dict[tuple[float, ...], Light] = {levels: light for light, levels in LEVELS.items()}
    lines = [TRACK_HEADER]
    for k in np.flatnonzero(run.is_measured):
        shone = names[tuple(run.light[k - 1].tolist())] if k else "dark"
        lines.append(track_line(float(run.time_s[k]), shone, run.points_cm[k]))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")
    return path


def write_straight(path: Path, *, speed: float = 1.0, shift_cm: float = 0.0, beyond_cm: float = 1e9) -> Path:
    """A simulator folder of kind ``straight``."""
    write_simulator(
        path,
        kind=StraightPlant.kind,
        step_s=STEP_S,
        weights={"none": np.zeros(1)},
        scales={"speed": speed, "shift_cm": shift_cm, "beyond_cm": beyond_cm},
        provenance=Provenance(recipe="straight", seed=0, software="test"),
    )
    return path


class Forgetful(Simulator[FloatArray]):
    """Of the past nothing counts but the last stem. What its ``step`` does is told by those that derive from it."""

    kind: ClassVar[str] = "forgetful"
    step_s = STEP_S

    @classmethod
    def from_stored(cls, stored: Stored) -> Self:
        return cls()

    def start(
        self, points_cm: FloatArray, chance: Chance | None = None, before: FloatArray | None = None
    ) -> FloatArray:
        return points_cm.copy()

    def watch(self, history: History) -> FloatArray:
        return np.asarray(history.points_cm[-1]).copy()

    def stems_cm(self, state: FloatArray) -> FloatArray:
        return state

    def is_beyond_data(self, state: FloatArray) -> Any:
        return np.zeros(len(state), dtype=np.bool_)
