"""How long a generation takes: the plain way, the compiled loop, and the compiled loop in which plants are shared.

    .venv/bin/python tests/bench/bench_evolution.py                     some five minutes; trains simulators at first
    .venv/bin/python tests/bench/bench_evolution.py --full --json out/evolution.json        10,000 genomes, more repeats

Populations are evolved on the task `left` from fixed seeds, in each simulator, for evolved networks are larger and end
their episodes later than random ones. It is checked first that both ways give the same episodes. Then they take turns;
times are medians, of the processor where one thread works and of the clock where two do.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from statistics import median
from typing import Any

# One thread, said before anything starts more of them: where those wait for one another, it counts as work.
for library in ("OMP", "OPENBLAS", "NUMBA"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

TESTS = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(TESTS))

import numpy as np  # noqa: E402
import torch  # noqa: E402
from rich.console import Console  # noqa: E402

from bench.evolution.plain import Plain, plain_way  # noqa: E402
from bench.evolution.report import POPULATION, GenerationCost, Scaling, Speed, show  # noqa: E402
from bench.evolution.setting import memory_of, simulators  # noqa: E402
from bench.machine import processor  # noqa: E402
from flora_lab.evolve.evaluate import Evaluated, evaluate  # noqa: E402
from flora_lab.evolve.genome_arrays import GenomeArrays, pack  # noqa: E402
from flora_lab.evolve.neat_engine import NeatEngine  # noqa: E402
from flora_lab.evolve.neat_settings import load_settings  # noqa: E402
from flora_lab.evolve.task import LEFT, Task  # noqa: E402
from flora_lab.simulator.interface import Simulator  # noqa: E402
from lab.evolve_reference import OUTCOMES  # noqa: E402

SEED = 7
INPUTS = 26
ROUNDING = 1e-3
"""How near to 0.5 C is where float32 in another order of summing may decide otherwise."""


def main() -> int:
    options = parsed()
    torch.set_num_threads(1)
    console = Console(width=None if sys.stdout.isatty() else 130)
    load_before = os.getloadavg()[0]
    speeds, costs, scalings = [], [], []
    for name, simulator in simulators(options.keep).items():
        engine, cost = evolved(name, simulator, options.generations)
        speed = measured(name, simulator, engine, options.generations, 20 if options.full else 5)
        speeds.append(speed)
        costs.append(replace(cost, plain_ms=1e-6 * speed.plain_ns * 4 * POPULATION * speed.steps))
        if name == "paper":
            scalings += scaled(simulator, engine, (150, 1000, 10_000) if options.full else (150, 1000))
        print(f"{name}: done", file=sys.stderr)
    memory = {
        name: {population: memory_of(options.keep, name, population) for population in (POPULATION, 10_000)}
        for name in ("paper", "mechanistic")
    }
    machine = {"processor": processor(), "processors": os.cpu_count(), "load": [load_before, os.getloadavg()[0]]}
    show(console, speeds, costs, scalings, memory, machine)
    if options.json:
        figures = {"speeds": speeds, "generations": costs, "scaling": scalings}
        told_of = {name: [asdict(entry) for entry in entries] for name, entries in figures.items()}
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(told_of | {"memory_mib": memory, "machine": machine}, indent=1) + "\n")
    return 0


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help="more episodes the plain way, and 10,000 genomes")
    parser.add_argument("--generations", type=int, default=60, help="for which populations are evolved")
    parser.add_argument("--keep", type=Path, default=Path("out/bench_evolution"), help="folder of the simulators")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    return parser.parse_args()


def evolved(name: str, simulator: Simulator[Any], generations: int) -> tuple[NeatEngine, GenerationCost]:
    """A population after so many generations, and what they cost."""
    engine = NeatEngine(load_settings(population=POPULATION), SEED)
    fitness_of(evaluate(pack(engine.genomes, INPUTS), simulator, LEFT))  # compiles
    rows = []
    clock = time.process_time
    for _ in range(generations):
        times = []

        def fitness(genomes: list[Any], times: list[float] = times) -> Sequence[float]:
            times.append(clock())
            arrays = pack(genomes, INPUTS)
            times.append(clock())
            found = evaluate(arrays, simulator, LEFT)
            times.append(clock())
            values = fitness_of(found)
            times.append(clock())
            return values

        began = clock()
        engine.generation(fitness)
        whole, (a, b, c, d) = clock() - began, times
        rows.append((c - b, b - a, whole - (d - a), d - c, whole))
    cost = [1e3 * median(column) for column in zip(*rows[generations // 2 :], strict=True)]
    return engine, GenerationCost(name, *cost, plain_ms=0.0)


def fitness_of(found: Evaluated) -> list[float]:
    return found.outcomes.fitness[:, :, 0].mean(axis=1).tolist()


def measured(name: str, simulator: Simulator[Any], engine: NeatEngine, generations: int, sample: int) -> Speed:
    """Check that all ways come to the same, then let them take turns."""
    genomes, arrays = engine.genomes, pack(engine.genomes, INPUTS)
    fused = evaluate(arrays, simulator, LEFT, share=False)
    shared = evaluate(arrays, simulator, LEFT)
    for other in (shared, evaluate(arrays, simulator, LEFT, threads=2)):
        if not all(same_bits(other, fused, part) for part in OUTCOMES):
            raise SystemExit(f"bench_evolution: {name}: sharing or threads change what comes out")
    places = np.linspace(0, len(genomes) - 1, sample).astype(int).tolist()
    plain = plain_way(simulator, LEFT, engine.config)
    rounded = sum(differs(plain, genomes[g], g, s, fused, name) for g in places for s in range(len(LEFT.scenarios)))
    times: dict[str, list[float]] = {key: [] for key in ("plain", "fused", "shared", "fused two", "shared two")}
    for _ in range(5):
        began, steps = time.process_time(), 0
        for g in places:
            steps += sum(len(plain(genomes[g], scenario).is_right) for scenario in LEFT.scenarios)
        times["plain"].append((time.process_time() - began) / steps)
        for key, clock, choice in (
            ("fused", time.process_time, {"share": False}),
            ("shared", time.process_time, {}),
            ("fused two", time.perf_counter, {"share": False, "threads": 2}),
            ("shared two", time.perf_counter, {"threads": 2}),
        ):
            took_s = timed(lambda choice=choice: evaluate(arrays, simulator, LEFT, **choice), clock)
            times[key].append(took_s / fused.episode_steps)
    return Speed(
        name,
        generations,
        float(np.diff(arrays.node_start).mean()),
        len(arrays.weight) / len(arrays),
        fused.episode_steps / fused.outcomes.steps.size,
        shared.steps_run / shared.episode_steps,
        len(places) * len(LEFT.scenarios),
        rounded,
        *(1e9 * median(column) for column in times.values()),
    )


def same_bits(one: Evaluated, other: Evaluated, part: str) -> bool:
    return getattr(one.outcomes, part).tobytes() == getattr(other.outcomes, part).tobytes()


def differs(plain: Plain, genome: Any, g: int, s: int, fused: Evaluated, name: str) -> bool:
    """Whether rounding made another episode of it; ends the program where rounding cannot be why."""
    episode, outcomes = plain(genome, LEFT.scenarios[s]), fused.outcomes
    steps = int(outcomes.steps[g, s, 0])
    found = tuple(map(bool, outcomes.is_right[g, s, 0, :steps]))
    if found == episode.is_right and outcomes.reason[g, s, 0] == episode.reason:
        return False
    parted = [k for k, (one, other) in enumerate(zip(found, episode.is_right, strict=False)) if one != other]
    if name.startswith("paper") and (not parted or episode.doubts[parted[0]] < ROUNDING):
        return True
    raise SystemExit(f"bench_evolution: {name}: genome {g}, scenario {s}: not the plain way's episode")


def timed(work: Callable[[], object], clock: Callable[[], float], repeats: int = 3) -> float:
    times = []
    for _ in range(repeats):
        began = clock()
        work()
        times.append(clock() - began)
    return median(times)


def scaled(simulator: Simulator[Any], engine: NeatEngine, populations: Sequence[int]) -> list[Scaling]:
    """More genomes, more scenarios, more threads."""
    rows = []
    for population in populations:
        larger = NeatEngine(load_settings(population=population), SEED)
        for _ in range(10 if population <= 1000 else 3):
            larger.generation(lambda genomes: fitness_of(evaluate(pack(genomes, INPUTS), simulator, LEFT)))
        rows.append(scaling("population", population, simulator, pack(larger.genomes, INPUTS), LEFT))
    arrays = pack(engine.genomes, INPUTS)
    for count in (1, 2, 4, 8):
        rows.append(scaling("scenarios", count, simulator, arrays, with_scenarios(count)))
    for threads in (1, 2):
        rows.append(scaling("threads", threads, simulator, arrays, LEFT, threads))
    return rows


def with_scenarios(count: int) -> Task:
    """Some of the task's, or those and the same ones with obstacles 2 cm higher."""
    higher = [
        replace(s, name=f"{s.name}, higher", obstacle=replace(s.obstacle, y_cm=s.obstacle.y_cm + 2.0))
        for s in LEFT.scenarios
    ]
    return replace(LEFT, scenarios=(*LEFT.scenarios, *higher)[:count])


def scaling(
    what: str, number: int, simulator: Simulator[Any], arrays: GenomeArrays, task: Task, threads: int = 1
) -> Scaling:
    found = evaluate(arrays, simulator, task, threads=threads)
    cpu_s, wall_s = (
        timed(lambda: evaluate(arrays, simulator, task, threads=threads), clock)
        for clock in (time.process_time, time.perf_counter)
    )
    return Scaling(what, number, 1e3 * cpu_s, 1e3 * wall_s, found.episode_steps, found.steps_run)


if __name__ == "__main__":
    sys.exit(main())
