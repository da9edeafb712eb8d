"""Measured runs for tests of a diagnosis: plants of the extended law itself, whose constants, chance and effects are
known."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from noise_courses import first_order

from flora_common.arrays import Array
from flora_common.runs import LEVELS, LampsSection, Light, track_text
from flora_lab.diagnose.cross_fit import learn_from
from flora_lab.diagnose.joint import Base
from flora_lab.diagnose.knowledge import Knowledge
from flora_lab.diagnose.scene import Lanes, Scene
from flora_lab.effects.catalogue import BY_NAME
from flora_lab.effects.effect import Change
from flora_lab.effects.law_forms import AS_WRITTEN
from flora_lab.simulator.measured import MeasuredRun
from flora_lab.simulator.terms import ExtendedLaw
from flora_lab.simulator.tropism_traits import NAMES, prior_mean, prior_spread
from flora_lab.threads import one_blas_thread
from made_once import made_once

Effects = Mapping[str, Mapping[str, float]]
"""Name of an effect to its parameters."""

STEP_S: Final = 300.0
LAMPS: Final = LampsSection()
LAW: Final = ExtendedLaw(LAMPS)
FIRST_CM: Final = 6.5

TYPICAL: Final = prior_mean() + 0.1 * np.array([1.0, -1.0, 1.0, 0.0, 0.0, 1.0, -1.0, 1.0, 0.0])
"""Of the plants here: not those of the sources."""
SPREAD: Final = 0.5 * prior_spread()

MEMORIES_H: Final = {"wander": ("bias", 5.0), "growth": ("growth", 12.0), "gain": ("gain", 16.0)}
CHANCE: Final = {"wander": 0.012, "growth": 0.04, "gain": 0.03, "measure": 0.02, "wobble": 0.02}
"""Sizes of what happens by chance: 1/(cm h), shares, and cm."""
QUIET: Final = {"measure": 0.01}
WOBBLE_H: Final = 2.0


def levels_of(names: Sequence[Light]) -> Array:
    """Levels of the left and right lamp, shape (steps, 2)."""
    return np.array([LEVELS[name] for name in names], dtype=np.float64)


def turns(hours: float, turns_h: float, first: Light = "left", step_s: float = STEP_S) -> Array:
    """Left and right lamp in turn, shape (steps, 2)."""
    steps = round(hours * 3600.0 / step_s)
    other: Light = "right" if first == "left" else "left"
    odd = (np.arange(steps) * step_s / 3600.0 // turns_h) % 2 == 1
    return levels_of([other if one else first for one in odd])


def red_noise(rng: np.random.Generator, steps: int, memory_h: float, step_s: float = STEP_S) -> Array:
    """A course of variance 1 that forgets within ``memory_h``, shape (steps,)."""
    return np.asarray(first_order(rng, steps, np.exp(-step_s / 3600.0 / memory_h)))


def change_of(effects: Effects, forms: Mapping[str, int] | None = None) -> Change:
    """What some effects change."""
    change = Change()
    for name, values in effects.items():
        effect = BY_NAME[name]
        effect.forms[(forms or {}).get(name, 0)](change, effect.with_usual(values))
    return change


def stem(height_cm: float = FIRST_CM, lean_rad: float = 0.0) -> Array:
    """A straight stem, shape (10, 2)."""
    return np.linspace(0.0, height_cm, 10)[:, None] * np.array([np.sin(lean_rad), np.cos(lean_rad)])


def still(light: Array, *, first_cm: Array | None = None, step_s: float = STEP_S, warm_c: Array | None = None) -> Scene:
    """A run in which a stem was measured that never moved: what it says of light and first stem is what counts."""
    points = np.repeat((stem() if first_cm is None else first_cm)[None], len(light) + 1, axis=0)
    time_s = np.arange(len(light) + 1) * step_s
    covariates = {} if warm_c is None else {"temperature_c": warm_c}
    usual_c = None if warm_c is None else 22.0
    return Scene(MeasuredRun("still", "still", "", points, light, time_s, step_s, covariates, LAMPS), LAW, usual_c)


def warm_course(hours: float) -> Array:
    """Temperatures about 22 degrees that change without a rhythm, shape (steps,)."""
    hour = np.arange(round(hours * 3600.0 / STEP_S)) * STEP_S / 3600.0
    return np.asarray(22.0 + 4.0 * np.sin(0.5 * hour) + 2.0 * np.sin(0.17 * hour + 1.0))


def individual(seed: int) -> Array:
    """A plant's constants, shape (9,)."""
    rng = np.random.default_rng([seed, 1])
    return TYPICAL + np.linalg.cholesky(SPREAD) @ rng.standard_normal(len(NAMES))


def run_of(
    seed: int,
    *,
    hours: float = 24.0,
    light: Array | None = None,
    change: Change | None = None,
    chance: Mapping[str, float] = CHANCE,
    traits: Array | None = None,
    step_s: float = STEP_S,
    warm_c: Array | None = None,
    swing: tuple[float, float] | None = None,
    besides: Mapping[str, Callable[[Array], Array]] | None = None,
) -> MeasuredRun:
    """A run of one plant.

    Args:
        seed: decides on the plant, its first stem and what happens to it by chance.
        hours: its length.
        light: levels, shape (steps, 2); lamps in turn where None, every four hours and every six.
        change: by effects.
        chance: sizes of what happens by chance, see :data:`CHANCE`; none of what is not named.
        traits: of the plant; an individual where None.
        step_s: from row to row.
        warm_c: temperature, shape (steps,).
        swing: period in hours and amplitude of the tip in cm.
        besides: what is added to the drives of these names, by hours since the start.
    """
    rng = np.random.default_rng([seed, 2])
    shone = (
        turns(hours, 4.0 if seed % 2 else 6.0, "right" if seed % 4 < 2 else "left", step_s) if light is None else light
    )
    steps = len(shone)
    first_cm = stem(FIRST_CM * float(np.exp(0.06 * rng.standard_normal())), 0.03 * float(rng.standard_normal()))
    hour = round(3600.0 / step_s)
    longer = np.concatenate([shone, np.repeat(shone[-1:], hour + 2, axis=0)])  # whole hours are simulated
    warmer = None if warm_c is None else np.concatenate([warm_c, np.repeat(warm_c[-1:], hour + 2)])
    scene = still(longer, first_cm=first_cm, step_s=step_s, warm_c=warmer)
    drives = {}
    for name, (drive, memory_h) in MEMORIES_H.items():
        course = chance.get(name, 0.0) * red_noise(rng, scene.steps, memory_h, step_s)[:, None]
        if besides and drive in besides:
            course += besides[drive](np.arange(scene.steps) * step_s / 3600.0)[:, None]
        drives[drive] = course if drive == "bias" else np.maximum(1.0 + course, 0.05)
    own = individual(seed) if traits is None else traits
    acting = change or Change()
    lanes = Lanes((own + acting.traits)[None], np.zeros((1, 2)), [acting])
    points = np.concatenate([first_cm[None], scene.points(lanes, drives, every=1)[:steps, 0]])
    along = np.linspace(0.0, 1.0, 10)
    if swing is not None:
        period_h, amplitude_cm = swing
        time_h = np.arange(steps + 1)[:, None] * step_s / 3600.0
        phase = 2.0 * np.pi * (time_h / period_h + rng.random())
        grown = 1.0 - np.exp(-time_h / 3.0)  # none at first: the stem that a run starts from is where it is
        points[:, :, 0] += amplitude_cm * along**2 * grown * np.sin(phase)
    wobble = np.stack([red_noise(rng, steps + 1, WOBBLE_H, step_s) for _ in range(2)], axis=1)
    points[:, 1:] += chance.get("wobble", 0.0) * along[1:, None] * wobble[:, None]
    points[:, 1:] += chance.get("measure", 0.0) * rng.standard_normal((steps + 1, 9, 2))
    covariates = {} if warm_c is None else {"temperature_c": warm_c}
    name = f"plant{seed}"
    return MeasuredRun(
        name, name, f"{seed:064d}", points, shone, np.arange(steps + 1) * step_s, step_s, covariates, LAMPS
    )


def scene_of(seed: int, **how: Any) -> Scene:
    """See :func:`run_of`."""
    run = run_of(seed, **how)
    return Scene(run, LAW, 22.0 if run.covariates else None)


def scenes_of(seeds: Sequence[int], effects: Effects | None = None, **how: Any) -> list[Scene]:
    """Several runs under the same effects."""
    return [scene_of(seed, change=change_of(effects or {}), **how) for seed in seeds]


def shorter(run: MeasuredRun, hours: float) -> Scene:
    """The beginning of a run alone."""
    steps = round(hours * 3600.0 / run.step_s)
    covariates = {name: values[:steps] for name, values in run.covariates.items()}
    kept = replace(
        run,
        points_cm=run.points_cm[: steps + 1],
        light=run.light[:steps],
        time_s=run.time_s[: steps + 1],
        covariates=covariates,
    )
    return Scene(kept, LAW, 22.0 if covariates else None)


REFERENCE: Final = tuple(range(9))
"""Seeds of the reference runs."""


@functools.cache
def known() -> Knowledge:
    """What nine healthy runs of a day tell; learned once for all tests."""

    def learned() -> Knowledge:
        with one_blas_thread():
            return learn_from(scenes_of(REFERENCE), laws=AS_WRITTEN)

    return made_once("known", learned)


def base() -> Base:
    """Of :func:`known`."""
    return known().base


def write_run(folder: Path, run: MeasuredRun) -> Path:
    """A run as a track; a row's light shone before it. Rows without a stem are left out."""
    names: dict[tuple[float, ...], Light] = {value: name for name, value in LEVELS.items()}
    rows = np.flatnonzero(run.is_measured)
    lights = [names[tuple(run.light[max(row - 1, 0)].tolist())] for row in rows.tolist()]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{run.name}.csv"
    path.write_text(track_text(run.time_s[rows], lights, run.points_cm[rows]), encoding="utf-8")
    return path
