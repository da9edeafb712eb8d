"""The mechanistic simulator with and without effects, lights for it, and what its tips do under them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from simulator_contract import LEFT, RIGHT
from simulator_fakes import upright

from flora_common.arrays import Array
from flora_common.runs import LampsSection
from flora_lab.effects.catalogue import CATALOGUE
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.growing import DataRange
from flora_lab.simulator.individual import Prior
from flora_lab.simulator.interface import Chance, run
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.store import Extension, Provenance, write_simulator
from flora_lab.simulator.tropism_traits import prior_mean, prior_spread

DARK = (0.0, 0.0)
USUAL_C = 22.0
OF_PLANTS = [effect.name for effect in CATALOGUE if effect.forms and effect.where in {"plant", "simulator"}]


def base(noise: DriveNoise | None = None) -> RodSimulator:
    prior = Prior(prior_mean(), prior_spread())
    return RodSimulator(
        LampsSection(), prior, noise or DriveNoise(), DataRange(30.0, 10.0), usual_temperature_c=USUAL_C
    )


def with_effect(name: str, form: int = 0, **parameters: float) -> RodSimulator:
    return base().extended([Extension(name, parameters, form)])


ALL_AT_ONCE = [
    Extension("phototropic_latency", {"delay_h": 0.37}),
    Extension("adaptation", {"time_constant_h": 1.3, "floor": 0.6}),
    Extension("lamp_asymmetry", {"right_to_left": 0.7}),
    Extension("lamp_ageing", {"loss": 0.3}),
    Extension("diurnal_growth", {"amplitude": 0.4, "peak_h": 5.0}, form=1),
    Extension("temperature_growth", {"per_degree": 0.05}),
    Extension("growth_rate", {"factor": 1.1}),
    Extension("stiffening", {"factor": 0.9}, form=1),
    Extension("sag", {"amplitude": 0.5}),
    Extension("draught", {"drive_per_cm_h": 0.05}),
]
START_CM = upright(height_cm=7.0)


def lit(*phases: tuple[float, tuple[float, float]], count: int = 1, step_h: float = 1 / 12) -> Array:
    """Levels (steps, count, 2) from hours and lamps."""
    rows = np.concatenate([np.repeat([lamps], round(hours / step_h), axis=0) for hours, lamps in phases])
    return np.repeat(rows[:, None], count, axis=1)


def tips(plant: RodSimulator, light: Array, covariates: Mapping[str, Array] | None = None, **more: Any) -> Array:
    """Of one plant after each step, shape (steps, 2)."""
    return run(plant, plant.start(START_CM, **more), light, 300.0, covariates)[:, 0, -1]


def course(plant: RodSimulator) -> bytes:
    """Of three plants under either lamp, each as warm as no other; equal where all is, to the bit."""
    light = lit((9.0, RIGHT), (9.0, LEFT), count=3)
    warm = {"temperature_c": np.repeat(np.array([[15.0, 22.0, 30.0]]), len(light), axis=0)}
    chance = Chance(np.arange(3))
    return run(plant, plant.start(upright(3, 7.0), chance, np.array([LEFT, RIGHT, DARK])), light, 300.0, warm).tobytes()


def written(path: Path, plant: RodSimulator, **changes: Any) -> Path:
    """The folder of a simulator, but for what is changed."""
    values: dict[str, Any] = {"scales": plant.scales(), "extensions": plant.extensions, **changes}
    provenance = Provenance(recipe=plant.kind, seed=1, software="flora", settings={"rounds": 3})
    write_simulator(
        path, kind=plant.kind, step_s=plant.step_s, provenance=provenance, weights=plant.weights(), **values
    )
    return path
