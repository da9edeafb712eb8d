"""What all steps came to, read back from their folders and checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Final

import msgspec

from flora_common.errors import BadInput
from flora_common.experiment_file import NAME as OUTCOME_FILE
from flora_common.experiment_file import ExperimentFile, read_experiment
from flora_common.runs import RunFile, RunFolder
from flora_common.tracks import Track, read_track
from flora_lab.dataset.store import DatasetFile, read_dataset
from flora_lab.evaluate.folder import JSON_FILE as EVALUATION_FILE
from flora_lab.evaluate.folder import RUNS as EVALUATION_RUNS
from flora_lab.evaluate.on_twin import STRIP_FILE
from flora_lab.evaluate.trial import TYPICAL
from flora_lab.evolve.evolution_folder import Evolution, read_evolution
from flora_lab.paper.pipeline import (
    DATA,
    RUNS,
    SIDES,
    SIMULATORS,
    TASKS,
    Side,
    evolution_name,
    reality_name,
)
from flora_lab.paper.scales import Asked
from flora_lab.simulator.store import SUFFIX, SimulatorFile, read_stored

UNFINISHED: Final = ".unfinished"


@dataclass(frozen=True, slots=True)
class DatasetRun:
    """One of the dataset experiments, as the plant was."""

    name: str
    run: RunFile
    track: Track

    @property
    def is_closed_loop(self) -> bool:
        """Its lamps followed the tip to a target."""
        return self.run.target is not None


@dataclass(frozen=True, slots=True)
class VirtualPlant:
    """A virtual plant that a controller steered through the whole rig.

    Attributes:
        outcome: what came of it.
        track: as it was measured, up to the end of the run.
        strip_jpeg: photographs.
    """

    outcome: ExperimentFile
    track: Track
    strip_jpeg: bytes

    @property
    def fitness(self) -> float:
        """When the target was reached, as the paper tells it; where it never was, at the end."""
        said = self.outcome.measured
        return said.fitness_at_end if said.fitness_at_target is None else said.fitness_at_target


class SimulatedTrial(msgspec.Struct, frozen=True):
    """A trial of ``evaluation.json``, as far as it is told here."""

    place: str
    plant: str
    fitness: float
    best_fitness: float
    ended: str
    hours: float


class EvaluationFile(msgspec.Struct, frozen=True):
    """``evaluation.json``, as far as it is told here."""

    trials: list[SimulatedTrial]


@dataclass(frozen=True, slots=True)
class Reality:
    """The best left controller of a simulator, where it was tried.

    Attributes:
        plants: virtual ones.
        simulated: with the typical plant, by simulator.
    """

    plants: tuple[VirtualPlant, ...]
    simulated: Mapping[Side, SimulatedTrial]


@dataclass(frozen=True, slots=True)
class Results:
    """Everything that the report is made of.

    Attributes:
        asked: scale and seed.
        took_s: seconds of each step, by name.
        runs: the dataset experiments.
        data: the training set.
        simulators: by recipe.
        curves: their training curves as PNG, where they have one.
        evolutions: by recipe and name of the task.
        reality: by recipe.
    """

    asked: Asked
    took_s: Mapping[str, float]
    runs: tuple[DatasetRun, ...]
    data: DatasetFile
    simulators: Mapping[Side, SimulatorFile]
    curves: Mapping[Side, bytes]
    evolutions: Mapping[tuple[Side, str], Evolution]
    reality: Mapping[Side, Reality]


def read_results(folder: Path, asked: Asked, took_s: Mapping[str, float]) -> Results:
    """Read what the steps made.

    Raises:
        BadInput: something is missing or damaged; one line that says what.
    """
    return Results(
        asked,
        took_s,
        tuple(_run(path) for path in sorted((folder / RUNS).iterdir())),
        read_dataset(folder / DATA).info,
        {side: read_stored(folder / SIMULATORS[side]).info for side in SIDES},
        {side: curve.read_bytes() for side in SIDES if (curve := folder / SIMULATORS[side] / "training.png").is_file()},
        {
            (side, task.name): read_evolution(folder / evolution_name(side, task))
            for side, task in product(SIDES, TASKS)
        },
        {side: _reality(folder / reality_name(side)) for side in SIDES},
    )


def _run(path: Path) -> DatasetRun:
    folder = RunFolder(path)
    return DatasetRun(path.name, folder.read_run_file(), read_track(folder.track_csv))


def _reality(folder: Path) -> Reality:
    path = folder / EVALUATION_FILE
    try:
        found: Any = msgspec.json.decode(path.read_bytes(), type=EvaluationFile)
    except OSError as problem:
        raise BadInput(f"{path}: cannot be read ({problem.strerror})") from problem
    except (ValueError, RecursionError) as problem:
        raise BadInput(f"{path}: is damaged ({str(problem)[:100]})") from problem
    typical = {trial.place: trial for trial in found.trials if trial.plant == TYPICAL}
    names = {side: SIMULATORS[side].removesuffix(SUFFIX) for side in SIDES}
    for name in names.values():
        if name not in typical:
            raise BadInput(f"{path}: holds no trial in the simulator {name}; remove {folder} to have it done anew")
    places = [
        place
        for place in sorted((folder / EVALUATION_RUNS).iterdir())
        if place.suffix != UNFINISHED and (place / OUTCOME_FILE).is_file()
    ]
    return Reality(tuple(_plant(place) for place in places), {side: typical[name] for side, name in names.items()})


def _plant(folder: Path) -> VirtualPlant:
    outcome = read_experiment(folder)
    track = read_track(folder / outcome.run / "track.csv")
    return VirtualPlant(outcome, track, (folder / STRIP_FILE).read_bytes())
