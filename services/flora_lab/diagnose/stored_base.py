"""A base on the disk: a mechanistic simulator that also holds what a diagnosis knows of its plants and its errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_common.counted import counted
from flora_common.errors import BadInput
from flora_common.runs import LampsSection
from flora_lab.diagnose import chance, residuals, usual_errors
from flora_lab.diagnose.courses import KNOWN
from flora_lab.diagnose.inputs import FEWEST_REFERENCES
from flora_lab.diagnose.joint import TRAITS, Base
from flora_lab.diagnose.knowledge import LOOKED_FOR, Knowledge
from flora_lab.diagnose.rhythm import Swings
from flora_lab.diagnose.usual_errors import UsualErrors
from flora_lab.diagnose.usual_pushes import COLUMNS, UsualPushes
from flora_lab.effects import law_forms
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.extended import change_of
from flora_lab.simulator.growing import DataRange
from flora_lab.simulator.individual import Prior
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.store import Extension, Provenance, Stored, write_simulator

_PREFIX: Final = "diagnose."
_SHOWN: Final = "shown."
_MISSING: Final = 1e30
"""Stands for what could not be told of a run: weights on the disk are finite."""
_SHAPES: Final[Mapping[str, tuple[int | None, ...]]] = {
    "spread": (TRAITS, TRAITS),
    "doubt": (TRAITS, TRAITS),
    "sizes": (len(chance.PARTS),),
    "first": (2,),
    "first_sd": (2,),
    "swing_per_hour": (None,),
    "swing_power": (None,),
    "error_sizes": (len(usual_errors.causes()),),
    "error_mean": (sum(usual_errors.columns()),),
    "error_doubt": (sum(usual_errors.columns()), sum(usual_errors.columns())),
    "left": (None, 2),
    "swing_evidence": (None,),
    "push_mean": (len(KNOWN), COLUMNS),
    "push_doubt": (len(KNOWN), COLUMNS, COLUMNS),
    "push_scatter": (len(KNOWN),),
    "cross_fit": (None, len(LOOKED_FOR)),
}
_NAMES: Final[Mapping[str, list[str] | list[int]]] = {
    "causes": list(usual_errors.causes()),
    "kinds": list(usual_errors.columns()),
    "tried": list(LOOKED_FOR),
    "pushes": [f"{drive} {course.where}" for drive, course in KNOWN],
}
"""What rows and columns of these stand for."""


def simulator_of(
    base: Base, lamps: LampsSection, shown: DataRange, usual_c: float | None, law: Sequence[Extension] = ()
) -> RodSimulator:
    """The base, learned under a law, as a simulator whose plants differ, and to which things happen by chance."""
    prior = Prior(base.mean, base.spread + base.doubt)
    return RodSimulator(lamps, prior, noise_of(base.sizes), shown, extensions=law, usual_temperature_c=usual_c)


def noise_of(sizes: Array) -> DriveNoise:
    """What happens by chance, as a simulator's drives know it: parts of one drive become one with a time between."""
    by_drive: dict[str, list[tuple[float, float]]] = {}
    named = chance.as_dict(sizes)
    for part in chance.PARTS:
        if part.period_h == 0.0 and part.memory_h < 1e5:
            drive = "measure" if part.drive in chance.MEASURED else part.drive
            by_drive.setdefault(drive, []).append((named[part.name], part.memory_h))

    def together(drive: str) -> tuple[float, float]:
        sds = np.array([sd for sd, _ in by_drive[drive]])
        times_h = np.array([max(time_h, 0.1) for _, time_h in by_drive[drive]])
        return float(np.sqrt(sds @ sds)), float(np.exp(np.average(np.log(times_h), weights=sds**2)))

    wander, wander_h = together("bias")
    growth, growth_h = together("growth")
    measure, _ = together("measure")
    return DriveNoise(
        measure_cm=measure,
        wander_per_cm_h=wander,
        wander_h=wander_h,
        nutation_per_cm_h=named["nutation_per_cm_h"],
        growth_share=growth,
        growth_h=growth_h,
        rhythm_share=named["growth_rhythm_share"],
    )


def write_known(
    path: Path,
    simulator: RodSimulator,
    known: Knowledge,
    provenance: Provenance,
) -> None:
    """Write the folder, whole or not at all.

    Raises:
        BadInput: something is there already.
    """
    base = known.base
    told = {"runs": base.runs, "swing_follows": known.swings.follows, **_NAMES}
    arrays = {
        "spread": base.spread,
        "doubt": base.doubt,
        "sizes": base.sizes,
        "first": base.first,
        "first_sd": base.first_sd,
        "swing_per_hour": known.swings.per_hour,
        "swing_power": known.swings.power,
        "error_sizes": known.errors.sizes,
        "error_mean": known.errors.mean,
        "error_doubt": known.errors.doubt,
        "left": known.left,
        "swing_evidence": known.swing_evidence,
        "push_mean": known.pushes.mean,
        "push_doubt": known.pushes.doubt,
        "push_scatter": known.pushes.scatter,
        "cross_fit": known.cross_fit,
    } | {
        _SHOWN + name: np.where(np.isnan(array), _MISSING, array)
        for name, array in residuals.as_arrays(known.residuals).items()
    }
    write_simulator(
        path,
        kind=simulator.kind,
        step_s=simulator.step_s,
        weights=simulator.weights() | {_PREFIX + name: np.asarray(a, dtype=np.float64) for name, a in arrays.items()},
        scales=simulator.scales() | {"diagnose": told},
        provenance=provenance,
        extensions=simulator.extensions,
    )


def is_known(stored: Stored) -> bool:
    """Whether a stored simulator holds what a diagnosis needs."""
    return "diagnose" in stored.info.scales


def read_known(stored: Stored) -> Knowledge:
    """What :func:`write_known` wrote; its plants have the effects that the simulator was extended with.

    Raises:
        BadInput: a part is missing or cannot be.
    """
    where = str(stored.path)
    told = stored.info.scales["diagnose"]
    if not isinstance(told, dict) or any(told.get(name) != known for name, known in _NAMES.items()):
        raise BadInput(f"{where}: was made by a version that knows other effects; learn it anew with --reference")
    values = {name: stored.weight(_PREFIX + name, shape).astype(np.float64) for name, shape in _SHAPES.items()}
    runs, follows = told.get("runs"), told.get("swing_follows")
    if not isinstance(runs, int) or not isinstance(follows, int | float) or runs < 1 or not 0.0 <= follows <= 1.0:
        raise BadInput(f"{where}: scales.diagnose must name `runs` and `swing_follows`")
    extended = change_of(stored.info.extension, where)
    mean = stored.weight("trait_mean", (TRAITS,)).astype(np.float64) + extended.traits
    base = Base(
        mean,
        values["spread"],
        values["doubt"],
        values["sizes"],
        values["first"],
        values["first_sd"],
        runs,
    )
    return Knowledge(
        base,
        Swings(values["swing_per_hour"], values["swing_power"], float(follows)),
        UsualErrors(values["error_sizes"], values["error_mean"], values["error_doubt"]),
        values["left"],
        values["swing_evidence"],
        _shown(stored),
        tuple(extension for extension in stored.info.extension if extension.effect in law_forms.BY_NAME),
        UsualPushes(values["push_mean"], values["push_doubt"], values["push_scatter"]),
        values["cross_fit"],
    )


def _shown(stored: Stored) -> residuals.ReferenceResiduals:
    start = _PREFIX + _SHOWN
    told = {name[len(start) :]: array for name, array in stored.weights.items() if name.startswith(start)}
    arrays = {name: np.where(array == _MISSING, np.nan, array) for name, array in told.items()}
    try:
        shown = residuals.from_arrays(arrays)
    except KeyError as problem:
        raise BadInput(
            f"{stored.path}: holds no `{start}{problem.args[0]}`; learn it anew with --reference"
        ) from problem
    if len(shown.misfit) < FEWEST_REFERENCES:
        raise BadInput(
            f"{stored.path}: `{start}misfit` is of {counted(len(shown.misfit), 'run')}, at least {FEWEST_REFERENCES} "
            "are needed; learn it anew with --reference"
        )
    return shown
