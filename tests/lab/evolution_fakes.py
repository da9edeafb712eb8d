"""Evolution folders with drawn numbers: nothing was evolved, but every file is there and fits the others."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from evolve_genomes import INPUTS, followers
from evolve_reference import controller_of
from neat.activations import ActivationFunctionSet
from neat.aggregations import AggregationFunctionSet
from neat.nn import FeedForwardNetwork
from simulator_fakes import StraightPlant

from flora_common.arrays import FloatArray
from flora_common.controller_file import LoadedController
from flora_common.files import sha256_of_bytes
from flora_common.toml_strict import to_toml
from flora_lab.evolve import evolution_folder as folder
from flora_lab.evolve.controllers import FromFile
from flora_lab.evolve.episode import run_episode
from flora_lab.evolve.evolution_folder import (
    Evolution,
    EvolutionFile,
    History,
    IndividualsEntry,
    RunEntry,
    SimulatorEntry,
    TookEntry,
)
from flora_lab.evolve.evolution_writing import episode_entry, episode_track
from flora_lab.evolve.task import LEFT, Task, averages
from flora_lab.evolve.task_file import task_text

FAST = StraightPlant(speed=20.0)
"""A plant that takes a twentieth of the time, so that an episode has few steps."""


@dataclass(frozen=True)
class Fake:
    """What an evolution is to have come to.

    Attributes:
        task, runs, generations, individuals: as asked.
        alike: all runs have the same numbers.
        networks: of the champions, neat-python's; simple ones where empty.
        simulator: its name.
        seed: of the drawn numbers.
    """

    task: Task = LEFT
    runs: int = 20
    generations: int = 30
    individuals: int = 0
    alike: bool = False
    networks: Sequence[Any] = ()
    simulator: str = "some.simulator"
    seed: int = 1


def history(fake: Fake) -> History:
    """Fitness that rises in steps, as it does where the best genome is kept, and populations that begin anew."""
    rng = np.random.default_rng(fake.seed)
    shape = (1 if fake.alike else fake.runs, fake.generations)
    scenarios = len(fake.task.scenarios)
    steps = rng.random((*shape, scenarios)) * (rng.random((*shape, scenarios)) < 0.2) / np.sqrt(fake.generations)
    by_scenario = np.minimum(0.4 + 0.2 * rng.random((shape[0], 1, scenarios)) + np.cumsum(steps, axis=1), 0.95)
    best = averages(fake.task, by_scenario).of_all
    species = rng.integers(1, 12, shape)
    nodes = np.cumsum(rng.random(shape) < 0.1, axis=1)
    counts = {
        "species": species,
        "is_extinct": rng.random(shape) < 0.05,
        "nodes": nodes,
        "links": 26 + 2 * nodes,
        "plant_steps": rng.integers(1000, 2000, shape),
        "episode_steps": rng.integers(5000, 9000, shape),
    }
    floats = {"best_fitness": best, "median_fitness": best - 0.1, "best_so_far": np.maximum.accumulate(best, axis=1)}
    arrays = floats | counts | {"by_scenario": by_scenario}
    return History(**{name: np.repeat(a, fake.runs, axis=0) if fake.alike else a for name, a in arrays.items()})


def write_fake(path: Path, fake: Fake) -> Path:
    """A whole folder but for its report."""
    told = history(fake)
    networks = fake.networks or followers(fake.runs, fake.seed)
    champions = [controller_of(networks[k % len(networks)], fake.task, name=f"c{k + 1}") for k in range(fake.runs)]
    runs = [_run(fake, told, k, champion) for k, champion in enumerate(champions)]
    best = max(runs, key=lambda run: run.best_fitness)
    steered = FromFile(champions[best.number - 1])
    courses = [run_episode(steered, FAST, fake.task, scenario) for scenario in fake.task.scenarios]
    info = EvolutionFile(
        format=folder.FORMAT,
        software="flora test",
        task=fake.task.name,
        runs=fake.runs,
        generations=fake.generations,
        population=150,
        seed=fake.seed,
        best_run=best.number,
        simulator=SimulatorEntry(fake.simulator, "straight", "a" * 64, "b" * 64),
        individuals=IndividualsEntry(fake.individuals, 1, "mean"),
        run=runs,
        episode=[episode_entry(place, course) for place, course in enumerate(courses)],
        took=TookEntry(12.5, 20.25, 3.5, 0.25),
    )
    for part in (folder.CONTROLLERS, folder.EPISODES):
        (path / part).mkdir(parents=True)
    for run, champion in zip(runs, champions, strict=True):
        (path / run.controller).write_bytes(champion.data)
    (path / folder.BEST_FILE).write_bytes(champions[best.number - 1].data)
    (path / folder.TASK_FILE).write_text(task_text(fake.task))
    (path / folder.SETTINGS_FILE).write_text("[NEAT]\n")
    (path / folder.HISTORY_FILE).write_text(folder.history_text(told, fake.task))
    for entry, course in zip(info.episode, courses, strict=True):
        (path / entry.file).write_text(episode_track(course))
    (path / folder.INFO_FILE).write_text(to_toml(info))
    return path


def read_fake(path: Path, fake: Fake) -> Evolution:
    """The same, written and read back."""
    return folder.read_evolution(write_fake(path, fake))


def renamed(task: Task, name: str, scenarios: Sequence[str]) -> Task:
    """A task whose names are others."""
    named = [replace(scenario, name=new) for scenario, new in zip(task.scenarios, scenarios, strict=True)]
    return replace(task, name=name, scenarios=tuple(named))


def stepwise(runs: int, places: int, seed: int) -> FloatArray:
    """Curves that rise in steps, shape (runs, places), many of them equal to another at many places."""
    rng = np.random.default_rng(seed)
    return np.round(np.cumsum(rng.random((runs, places)) < 0.1, axis=1) / 4.0)


def _run(fake: Fake, told: History, place: int, champion: LoadedController) -> RunEntry:
    when = int(np.argmax(told.best_fitness[place]))
    by_scenario = told.by_scenario[place, when]
    return RunEntry(
        number=place + 1,
        seed=1000 + place,
        best_fitness=float(told.best_fitness[place, when]),
        best_fitness_possible=float(averages(fake.task, by_scenario).of_possible),
        generation_of_best=when,
        nodes=int(told.nodes[place, when]),
        links=int(told.links[place, when]),
        by_scenario=by_scenario.tolist(),
        controller=f"{folder.CONTROLLERS}/run-{place + 1:02d}.controller.json",
        sha256=sha256_of_bytes(champion.data),
    )


def layered(hidden: int, seed: int, *, columns: int = 3) -> Any:
    """neat-python's network of 26 inputs and so many hidden nodes in columns; each reads some of those before it."""
    rng = random.Random(seed)
    sigmoid, added = ActivationFunctionSet().get("sigmoid"), AggregationFunctionSet().get("sum")
    inputs = list(range(-1, -1 - INPUTS, -1))
    keys = list(range(1, hidden + 1))
    before, evals, unread = inputs, [], set(keys)
    for column in range(columns):
        inside = keys[column::columns]
        for key in inside:
            into = rng.sample(before, min(3, len(before)))
            unread.difference_update(into)
            evals.append((key, sigmoid, added, 0.0, 1.0, [(source, rng.gauss(0.0, 2.0)) for source in into]))
        before = before + inside
    links = [(source, rng.gauss(0.0, 2.0)) for source in sorted(unread) + inputs[::4]]
    return FeedForwardNetwork(inputs, [0], [*evals, (0, sigmoid, added, 0.5, 1.0, links)])
