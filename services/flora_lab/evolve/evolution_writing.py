"""Finished runs as the folder that people get: champions as controller files, history, and the best one at work."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import add
from pathlib import Path
from typing import Any

import numpy as np
from neat.nn import FeedForwardNetwork

from flora_common import files
from flora_common.controller_file import parse_controller
from flora_common.runs import track_text
from flora_common.stem_range import StemRange
from flora_common.toml_strict import to_toml
from flora_lab.evolve import evolution_folder as folder
from flora_lab.evolve.controllers import INPUTS, FromFile, controller_bytes, export_of
from flora_lab.evolve.episode import Course, run_episode
from flora_lab.evolve.evaluate import evaluate
from flora_lab.evolve.evolution_folder import (
    EpisodeEntry,
    EvolutionFile,
    History,
    IndividualsEntry,
    RunEntry,
    SimulatorEntry,
    TookEntry,
    standing,
)
from flora_lab.evolve.genome_arrays import pack
from flora_lab.evolve.individuals import HELD_OUT
from flora_lab.evolve.neat_checkpoint import engine_from
from flora_lab.evolve.one_run import RunState, Took
from flora_lab.evolve.plan import Plan
from flora_lab.evolve.reach import reach
from flora_lab.evolve.task import averages
from flora_lab.evolve.task_file import task_text
from flora_lab.simulator.measured import STEP_S
from flora_lab.simulator.store import software


@dataclass(frozen=True, slots=True)
class Champion:
    """The best genome of a run.

    Attributes:
        data: of its controller file.
        entry: what ``evolution.toml`` says of it.
    """

    data: bytes
    entry: RunEntry


def history_of(states: Sequence[RunState]) -> History:
    """The runs' rows as arrays."""
    rows = [state.history for state in states]

    def table(name: str, kind: Any) -> Any:
        return np.array([[getattr(row, name) for row in run] for run in rows], dtype=kind)

    best = table("best_fitness", np.float64)
    return History(
        best_fitness=best,
        median_fitness=table("median_fitness", np.float64),
        best_so_far=np.maximum.accumulate(best, axis=1),
        species=table("species", np.int64),
        is_extinct=table("is_extinct", np.bool_),
        nodes=table("nodes", np.int64),
        links=table("links", np.int64),
        plant_steps=table("plant_steps", np.int64),
        episode_steps=table("episode_steps", np.int64),
        by_scenario=table("by_scenario", np.float64),
    )


def held_out_fitness(plan: Plan, states: Sequence[RunState]) -> list[float | None]:
    """How each run's best genome does on drawn plants that it was not evolved on; None where no plants are drawn.

    Evolution takes what is peculiar to a few plants: of two champions the one with more fitness on these may have much
    less on others.
    """
    if not plan.individuals.count:
        return [None] * len(states)
    genomes = [engine_from(state.engine, plan.settings).best for state in states]
    others = plan.individuals.held_out()
    tried = evaluate(pack(genomes, len(INPUTS)), plan.parcel.simulator, plan.task, others)
    return [float(value) for value in others.judged(tried.outcomes.fitness).mean(axis=1)]


def champion(plan: Plan, state: RunState, stem_range: StemRange, held_out: float | None) -> Champion:
    """A run's best genome as a controller file, with where it is from, and the stems that the evolution has met."""
    engine = engine_from(state.engine, plan.settings)
    network = export_of(FeedForwardNetwork.create(engine.best, engine.config))
    when = int(np.argmax([row.best_fitness for row in state.history]))
    row = state.history[when]
    means = averages(plan.task, np.array(row.by_scenario))
    provenance: dict[str, str | int | float | bool] = {
        "software": software(),
        "simulator": plan.parcel.name,
        "simulator_kind": plan.parcel.info.kind,
        "simulator_sha256": plan.parcel.info.weights_sha256,
        "dataset_sha256": plan.parcel.dataset_sha256,
        "task_sha256": files.sha256_of_bytes(task_text(plan.task).encode()),
        "settings_sha256": files.sha256_of_bytes(plan.settings.text.encode()),
        "seed": plan.seed,
        "run": state.number,
        "run_seed": plan.run_seed(state.number),
        "generation": when,
        "generations": plan.generations,
        "population": plan.settings.population,
        "individuals": plan.individuals.count,
        "individuals_seed": plan.individuals.seed,
        "judge": plan.individuals.judge,
        "fitness": row.best_fitness,
        "fitness_possible": float(means.of_possible),
    }
    if plan.members:
        provenance["individuals_members"] = plan.members
    if held_out is not None:
        provenance["fitness_held_out"] = held_out
    for scenario, fitness in zip(plan.task.scenarios, row.by_scenario, strict=True):
        provenance[f"fitness {scenario.name}"] = fitness
    name = f"{plan.task.name}-{plan.seed}-{state.number:02d}"
    data = controller_bytes(name, network, plan.task, provenance, stem_range=stem_range)
    file = f"{folder.CONTROLLERS}/run-{state.number:02d}.controller.json"
    entry = RunEntry(
        number=state.number,
        seed=plan.run_seed(state.number),
        best_fitness=row.best_fitness,
        best_fitness_possible=float(means.of_possible),
        generation_of_best=when,
        nodes=row.nodes,
        links=row.links,
        by_scenario=row.by_scenario,
        controller=file,
        sha256=files.sha256_of_bytes(data),
        held_out_fitness=held_out,
    )
    return Champion(data, entry)


def write_evolution(
    path: Path,
    plan: Plan,
    states: Sequence[RunState],
    *,
    wall_s: float,
    commands: int = 1,
    force: bool,
    illustrate: Callable[[Path], None] | None = None,
) -> EvolutionFile:
    """Write the folder, whole or not at all.

    Args:
        path: of the folder.
        plan, states: what was asked, and all runs at their end.
        wall_s, commands: how long it took, and how many commands; see :class:`flora_lab.evolve.kept_runs.Worked`.
        force: replace an evolution that is there.
        illustrate: puts report and pictures into a folder that holds everything else.

    Raises:
        BadInput: something else is there.
        DiskFull: no room.
    """
    folder.check_output(path, force=force)
    stem_range = reach(plan.parcel.simulator, plan.task, plan.individuals)
    held_out = held_out_fitness(plan, states)
    champions = [champion(plan, state, stem_range, seen) for state, seen in zip(states, held_out, strict=True)]
    best = max(champions, key=lambda one: standing(one.entry))
    steered = FromFile(parse_controller(best.data, where=best.entry.controller))
    courses = [run_episode(steered, plan.parcel.simulator, plan.task, scenario) for scenario in plan.task.scenarios]
    info = EvolutionFile(
        format=folder.FORMAT,
        software=software(),
        task=plan.task.name,
        runs=plan.runs,
        generations=plan.generations,
        population=plan.settings.population,
        seed=plan.seed,
        best_run=best.entry.number,
        simulator=SimulatorEntry(
            plan.parcel.name,
            plan.parcel.info.kind,
            plan.parcel.info.weights_sha256,
            plan.parcel.dataset_sha256,
        ),
        individuals=IndividualsEntry(
            plan.individuals.count,
            plan.individuals.seed,
            plan.individuals.judge,
            plan.members,
            HELD_OUT if plan.individuals.count else 0,
        ),
        run=[one.entry for one in champions],
        episode=[episode_entry(place, course) for place, course in enumerate(courses)],
        took=_took(states, wall_s, commands),
    )
    with files.whole_folder(path, replace=force) as new:
        for part in (folder.CONTROLLERS, folder.EPISODES):
            (new / part).mkdir()
        for one in champions:
            (new / one.entry.controller).write_bytes(one.data)
        (new / folder.BEST_FILE).write_bytes(best.data)
        (new / folder.TASK_FILE).write_text(task_text(plan.task), encoding="utf-8")
        (new / folder.SETTINGS_FILE).write_text(plan.settings.text, encoding="utf-8")
        (new / folder.HISTORY_FILE).write_text(folder.history_text(history_of(states), plan.task), encoding="utf-8")
        for place, course in enumerate(courses):
            (new / folder.episode_file(place, course.scenario)).write_text(episode_track(course), encoding="utf-8")
        (new / folder.INFO_FILE).write_text(to_toml(info), encoding="utf-8")
        if illustrate is not None:
            illustrate(new)
    return info


def _took(states: Sequence[RunState], wall_s: float, commands: int) -> TookEntry:
    took = functools.reduce(add, (state.took for state in states), Took())
    wall_s, evaluation_s, neat_s, other_s = (
        round(value, 3) for value in (wall_s, took.evaluation_s, took.neat_s, took.other_s)
    )
    return TookEntry(wall_s, evaluation_s, neat_s, other_s, commands)


def episode_entry(place: int, course: Course) -> EpisodeEntry:
    """What ``evolution.toml`` says of the episode in the scenario at ``place``, from 0."""
    file = folder.episode_file(place, course.scenario)
    return EpisodeEntry(
        course.scenario.name, file, course.reason, course.fitness, round(course.hours, 6), course.clearance_cm
    )


def episode_track(course: Course) -> str:
    """A track; each row's light shone before it."""
    lamps = course.lamps
    return track_text((k * STEP_S for k in range(len(lamps))), lamps, course.stems_cm)
