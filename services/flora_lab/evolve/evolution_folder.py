"""A finished evolution on the disk: what was asked, what each generation came to, the champions, and the best at work.

::

    evolution.toml            what was asked, and what each run came to
    task.toml, neat.cfg       task and all settings
    history.csv               a row per run and generation
    controllers/run-01…       the champion of each run, not signed
    best.controller.json      the best of them, on drawn plants on others than those; the first of equals
    episodes/1-NAME.csv …     its episode with the simulator's typical plant, as a track
    report.html, pictures/    to look at

Equal evolutions are equal byte for byte but for ``[took]``, and what the report says of it.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import msgspec
import numpy as np

from flora_common import outputs
from flora_common.arrays import Array, FloatArray
from flora_common.counted import counted
from flora_common.errors import BadInput
from flora_common.tracks import read_track
from flora_lab import made_folders
from flora_lab.evolve.episode import Reason
from flora_lab.evolve.individuals import Judge
from flora_lab.evolve.task import Scenario, Task
from flora_lab.evolve.task_file import read_task

FORMAT: Final = "flora-evolution-1"
INFO_FILE: Final = "evolution.toml"
TASK_FILE: Final = "task.toml"
SETTINGS_FILE: Final = "neat.cfg"
HISTORY_FILE: Final = "history.csv"
BEST_FILE: Final = "best.controller.json"
REPORT_FILE: Final = "report.html"
CONTROLLERS, EPISODES, PICTURES = "controllers", "episodes", "pictures"
NAMES: Final = frozenset({INFO_FILE, TASK_FILE, SETTINGS_FILE, HISTORY_FILE, BEST_FILE, CONTROLLERS, EPISODES})
ALSO: Final = frozenset({REPORT_FILE, PICTURES})
COLUMNS: Final = (
    "run", "generation", "best_fitness", "median_fitness", "best_so_far", "species", "is_extinct", "nodes", "links",
    "plant_steps", "episode_steps",
)  # fmt: skip
_BY_SCENARIO: Final = "fitness_"

Count = Annotated[int, msgspec.Meta(ge=0)]
Positive = Annotated[int, msgspec.Meta(ge=1)]
Seconds = Annotated[float, msgspec.Meta(ge=0.0)]


class SimulatorEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[simulator]``: that controllers were tried in."""

    name: str
    kind: str
    weights_sha256: str
    dataset_sha256: str = ""


class IndividualsEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[individuals]``; see :class:`flora_lab.evolve.individuals.Individuals`.

    Attributes:
        members: see :attr:`flora_lab.evolve.plan.Plan.members`.
        held_out: plants that nothing was evolved on, by which the best run is chosen.
    """

    count: Count
    seed: Count
    judge: Judge
    members: Count = 0
    held_out: Count = 0


class RunEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """``[[run]]``: a run and its champion.

    Attributes:
        number: from 1.
        seed: of its NEAT.
        best_fitness: over all scenarios.
        best_fitness_possible: without those that no plant can do.
        generation_of_best: when it came up first.
        nodes, links: hidden nodes and enabled links of the champion.
        by_scenario: its fitness in each.
        controller: file in the folder.
        sha256: of it.
        held_out_fitness: of the champion on plants that nothing was evolved on; None where none are drawn.
    """

    number: Positive
    seed: Count
    best_fitness: float
    best_fitness_possible: float
    generation_of_best: Count
    nodes: Count
    links: Count
    by_scenario: list[float]
    controller: str
    sha256: str
    held_out_fitness: float | None = None


def standing(run: RunEntry) -> float:
    """What runs are ranked by: fitness, on plants that nothing was evolved on where there are such."""
    return run.best_fitness if run.held_out_fitness is None else run.held_out_fitness


class EpisodeEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[[episode]]``: the best controller in one scenario, with the typical plant."""

    scenario: str
    file: str
    reason: Reason
    fitness: float
    hours: float
    clearance_cm: float


class TookEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[took]``: seconds. All but ``wall_s`` are added up over runs.

    Attributes:
        wall_s, commands: see :class:`flora_lab.evolve.kept_runs.Worked`.
        evaluation_s, neat_s, other_s: see :class:`flora_lab.evolve.one_run.Took`.
    """

    wall_s: Seconds
    evaluation_s: Seconds
    neat_s: Seconds
    other_s: Seconds
    commands: Positive = 1


class EvolutionFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``evolution.toml``."""

    format: str
    software: str
    task: str
    runs: Positive
    generations: Positive
    population: Positive
    seed: Count
    best_run: Positive
    simulator: SimulatorEntry
    individuals: IndividualsEntry
    run: list[RunEntry]
    episode: list[EpisodeEntry]
    took: TookEntry


@dataclass(frozen=True, slots=True)
class History:
    """What generations came to.

    Attributes:
        best_fitness, median_fitness, best_so_far: shape (runs, generations).
        species, nodes, links, plant_steps, episode_steps: shape (runs, generations), int64; nodes are hidden ones,
            and these and links are those of the generation's best genome.
        is_extinct: shape (runs, generations), bool.
        by_scenario: fitness of the generation's best genome, shape (runs, generations, scenarios).
    """

    best_fitness: FloatArray
    median_fitness: FloatArray
    best_so_far: FloatArray
    species: Array
    is_extinct: Array
    nodes: Array
    links: Array
    plant_steps: Array
    episode_steps: Array
    by_scenario: FloatArray


@dataclass(frozen=True, slots=True)
class EpisodeTrack:
    """The best controller in one scenario.

    Attributes:
        scenario: target and obstacle.
        reason: why it ended.
        fitness: at the end.
        clearance_cm: least distance of stem and obstacle.
        time_s: shape (n,).
        is_right: which lamp shone from each stem to the next, shape (n - 1,), bool.
        stems_cm: shape (n, 10, 2).
    """

    scenario: Scenario
    reason: Reason
    fitness: float
    clearance_cm: float
    time_s: FloatArray
    is_right: Array
    stems_cm: FloatArray


@dataclass(frozen=True, slots=True)
class Evolution:
    """A folder that was read and checked."""

    path: Path
    info: EvolutionFile
    task: Task
    history: History
    controllers: tuple[Path, ...]
    best: Path
    episodes: tuple[EpisodeTrack, ...]


def check_output(path: Path, *, force: bool) -> None:
    """Whether an evolution may be written there.

    Raises:
        BadInput: something is there, and it is not to be, or must not be, replaced.
    """
    outputs.check_folder(path, force=force, needed=NAMES, allowed=ALSO, what="an evolution")


def episode_file(place: int, scenario: Scenario) -> str:
    """Where in the folder the episode of the scenario at ``place``, from 0, lies; it may be called anything."""
    return f"{EPISODES}/{place + 1}-{re.sub(r'[^A-Za-z0-9._-]', '_', scenario.name)}.csv"


def read_evolution(path: Path) -> Evolution:
    """An evolution, from its folder.

    Raises:
        BadInput: it is none, or a part of it is missing or damaged; one line that says which.
    """
    if not (path / INFO_FILE).is_file():
        raise BadInput(f"{path}: not an evolution, it has no {INFO_FILE}; make one with `flora-lab evolve`")
    info = made_folders.read_info(path / INFO_FILE, EvolutionFile, FORMAT)
    task = read_task(path / TASK_FILE)
    scenarios = {scenario.name: scenario for scenario in task.scenarios}
    if [entry.scenario for entry in info.episode] != list(scenarios) or len(info.run) != info.runs:
        raise BadInput(f"{path / INFO_FILE}: its runs or episodes are not those of {TASK_FILE} and `runs`")
    return Evolution(
        path,
        info,
        task,
        _read_history(path / HISTORY_FILE, info, task),
        tuple(path / entry.controller for entry in info.run),
        path / BEST_FILE,
        tuple(_read_episode(path, entry, scenarios[entry.scenario]) for entry in info.episode),
    )


def history_text(history: History, task: Task) -> str:
    """``history.csv``: numbers so that they read back the same."""
    header = [*COLUMNS, *(f"{_BY_SCENARIO}{scenario.name}" for scenario in task.scenarios)]
    lines = [",".join(_quoted(name) for name in header)]
    runs, generations = history.best_fitness.shape
    for r in range(runs):
        for g in range(generations):
            at = (r, g)
            values = [
                repr(float(history.best_fitness[at])),
                repr(float(history.median_fitness[at])),
                repr(float(history.best_so_far[at])),
                *(str(int(array[at])) for array in _whole(history)),
                *(repr(float(value)) for value in history.by_scenario[at]),
            ]
            lines.append(f"{r + 1},{g}," + ",".join(values))
    return "\n".join(lines) + "\n"


def _whole(history: History) -> tuple[Array, ...]:
    return (
        history.species,
        history.is_extinct,
        history.nodes,
        history.links,
        history.plant_steps,
        history.episode_steps,
    )


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if re.search(r'[",]', name) else name


def _read_history(path: Path, info: EvolutionFile, task: Task) -> History:
    header = [*COLUMNS, *(f"{_BY_SCENARIO}{scenario.name}" for scenario in task.scenarios)]
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
        if not rows or rows[0] != header:
            raise BadInput(f"{path}: its columns are not {', '.join(header)}")
        values = np.array(rows[1:], dtype=np.float64)
    except OSError as problem:
        raise BadInput(f"{path}: cannot be read ({problem.strerror})") from problem
    except ValueError as problem:
        raise BadInput(f"{path}: is damaged ({str(problem)[:80]})") from problem
    shape = (info.runs, info.generations)
    if values.shape != (shape[0] * shape[1], len(header)) or not np.isfinite(values).all():
        table = f"{counted(shape[0], 'run')} of {counted(shape[1], 'generation')}"
        raise BadInput(f"{path}: is not a table of {table} with finite numbers")
    place = np.arange(len(values))
    if (values[:, 0] != place // shape[1] + 1).any() or (values[:, 1] != place % shape[1]).any():
        raise BadInput(f"{path}: runs and generations are not in order")
    columns = {name: values[:, k].reshape(shape) for k, name in enumerate(COLUMNS)}
    whole = {name: column.astype(np.int64) for name, column in columns.items()}
    return History(
        best_fitness=columns["best_fitness"],
        median_fitness=columns["median_fitness"],
        best_so_far=columns["best_so_far"],
        species=whole["species"],
        is_extinct=columns["is_extinct"] != 0.0,
        nodes=whole["nodes"],
        links=whole["links"],
        plant_steps=whole["plant_steps"],
        episode_steps=whole["episode_steps"],
        by_scenario=values[:, len(COLUMNS) :].reshape(*shape, len(task.scenarios)),
    )


def _read_episode(path: Path, entry: EpisodeEntry, scenario: Scenario) -> EpisodeTrack:
    track = read_track(path / entry.file)
    is_right = np.array([light == "right" for light in track.light[1:]], dtype=np.bool_)
    return EpisodeTrack(
        scenario, entry.reason, entry.fitness, entry.clearance_cm, track.time_s, is_right, track.points_cm
    )
