"""CPU milliseconds per generation that NEAT itself costs: neat-python as it is beside flora's classes for it.

    .venv/bin/python tests/bench/bench_neat.py                          some 40 seconds
    .venv/bin/python tests/bench/bench_neat.py --json out/neat.json

Two engines with one seed, one of neat-python's own classes and one of flora's, take turns, generation by generation;
the run ends if they do not come to the same. The time is that of reproduction and speciation without fitness, medians
over the second half of the generations, in which networks have grown. Then what a generation needs besides: its
networks, built by neat-python or packed into arrays, and its state, encoded as a checkpoint.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import neat
import numba
import numpy as np
from machine import processor
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from flora_lab.evolve.genome_arrays import pack
from flora_lab.evolve.neat_checkpoint import encode
from flora_lab.evolve.neat_engine import Generation, NeatEngine
from flora_lab.evolve.neat_fast import FAST
from flora_lab.evolve.neat_settings import STOCK, NeatSettings, load_settings

GOAL_MS = 10.0
GOAL_POPULATION = 150
SEED = 1
REPEATS = 9


@dataclass(frozen=True, slots=True)
class Case:
    """A population to evolve; a lower threshold gives more species, a higher growth larger networks."""

    population: int
    threshold: float
    growth: float
    generations: int


CASES = (
    Case(150, 2.0, 0.03, 60),
    Case(150, 2.0, 0.2, 60),
    Case(150, 1.45, 0.2, 60),
    Case(1000, 2.0, 0.2, 24),
)


@dataclass(frozen=True, slots=True)
class Figures:
    """What was measured of a case, times in CPU milliseconds per generation."""

    population: int
    generations: int
    species: float
    nodes: float
    links: float
    stock_ms: float
    fast_ms: float
    networks_ms: float
    packing_ms: float
    checkpoint_ms: float


def main() -> int:
    options = parsed()
    console = Console(width=None if sys.stdout.isatty() else 120)
    load_before = os.getloadavg()[0]
    warm_up()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), disable=not sys.stderr.isatty()) as progress:
        task = progress.add_task("generations", total=sum(case.generations for case in CASES))
        figures = [measured(case, lambda: progress.advance(task)) for case in CASES]
    versions = {"numba": numba.__version__, "numpy": np.__version__, "python": platform.python_version()}
    machine = {"processor": processor(), "processors": os.cpu_count(), "load": [load_before, os.getloadavg()[0]]}
    show(figures, versions, machine, console)
    if options.json:
        told = {"versions": versions, "machine": machine, "cases": [asdict(f) for f in figures]}
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(told, indent=1) + "\n")
    return 0


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    return parser.parse_args()


def warm_up() -> None:
    """Compile what is to be compiled."""
    engine = NeatEngine(load_settings(population=10), SEED)
    engine.generation(fitness)
    pack(engine.genomes, 26)


def fitness(genomes: Sequence[Any]) -> list[float]:
    """More for weights near a pattern and for larger networks, so that structures grow and species come and go."""
    return [
        0.2 * len(genome.nodes)
        - sum((gene.weight - (key[0] * 7 % 5 - 2)) ** 2 for key, gene in sorted(genome.connections.items())) / 30
        for genome in genomes
    ]


def measured(case: Case, advance: Callable[[], None]) -> Figures:
    settings = settings_of(case)
    stock, fast = NeatEngine(settings, SEED, STOCK), NeatEngine(settings, SEED, FAST)
    times: list[tuple[float, float]] = []
    species: list[int] = []
    for _ in range(case.generations):
        (stock_ms, told), (fast_ms, same) = generation_ms(stock), generation_ms(fast)
        if told != same:
            raise SystemExit(f"bench_neat: the fast classes came to {same}, neat-python's own to {told}")
        times.append((stock_ms, fast_ms))
        species.append(told.species)
        advance()
    if encode(stock) != encode(fast):
        raise SystemExit("bench_neat: the fast classes came to other genomes than neat-python's own")
    grown, genomes = case.generations // 2, fast.genomes
    return Figures(
        population=case.population,
        generations=case.generations,
        species=median(species[grown:]),
        nodes=sum(len(genome.nodes) for genome in genomes) / len(genomes),
        links=sum(len(genome.connections) for genome in genomes) / len(genomes),
        stock_ms=median(ms for ms, _ in times[grown:]),
        fast_ms=median(ms for _, ms in times[grown:]),
        networks_ms=cpu_ms(lambda: [neat.nn.FeedForwardNetwork.create(g, fast.config) for g in genomes]),
        packing_ms=cpu_ms(lambda: pack(genomes, 26)),
        checkpoint_ms=cpu_ms(lambda: encode(fast)),
    )


def settings_of(case: Case) -> NeatSettings:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.cfg"
        path.write_text(
            f"[DefaultSpeciesSet]\ncompatibility_threshold = {case.threshold}\n"
            f"[DefaultGenome]\nnode_add_prob = {case.growth}\nconn_add_prob = {case.growth}\n"
        )
        return load_settings(path, population=case.population)


def generation_ms(engine: NeatEngine) -> tuple[float, Generation]:
    """One generation without its fitness."""
    inside = 0.0

    def evaluate(genomes: list[Any]) -> list[float]:
        nonlocal inside
        began = time.process_time()
        values = fitness(genomes)
        inside = time.process_time() - began
        return values

    began = time.process_time()
    told = engine.generation(evaluate)
    return 1e3 * (time.process_time() - began - inside), told


def cpu_ms(work: Callable[[], object]) -> float:
    times = []
    for _ in range(REPEATS):
        began = time.process_time()
        work()
        times.append(1e3 * (time.process_time() - began))
    return median(times)


def show(figures: list[Figures], versions: dict[str, str], machine: dict[str, Any], console: Console) -> None:
    table = Table(title="NEAT's own work, CPU ms per generation, one core")
    for name in (
        "population",
        "species",
        "nodes, links",
        "neat-python",
        "flora",
        "times",
        "networks",
        "packed",
        "saved",
    ):
        table.add_column(name, justify="right")
    for f in figures:
        table.add_row(
            str(f.population),
            f"{f.species:.0f}",
            f"{f.nodes:.1f}, {f.links:.0f}",
            f"{f.stock_ms:.1f}",
            f"{f.fast_ms:.1f}",
            f"{f.stock_ms / f.fast_ms:.1f}",
            f"{f.networks_ms:.1f}",
            f"{f.packing_ms:.1f}",
            f"{f.checkpoint_ms:.1f}",
        )
    console.print(table)
    console.print("networks: neat-python's, built; packed: the same as arrays; saved: a checkpoint's content.")
    for f in figures:
        if f.population == GOAL_POPULATION:
            met = "met" if f.fast_ms <= GOAL_MS else "missed"
            console.print(f"goal {GOAL_MS:.0f} ms with {f.population} genomes, {f.species:.0f} species: {met}")
    console.print(f"the same genomes both ways, to the bit; {versions}; {machine}")


if __name__ == "__main__":
    sys.exit(main())
