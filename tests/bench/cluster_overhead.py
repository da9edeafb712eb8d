"""What a cluster costs an evolution: bytes and seconds per slice, and plant steps when populations are divided.

    make test-cluster                                                   once, for Ray
    .venv-cluster/bin/python tests/bench/cluster_overhead.py SIM        a minute or two; SIM is any simulator folder

A run is taken generation by generation, once in this process and once over a Ray cluster of this machine alone; both
come to the same, which is checked. The way there and back is timed with the bytes of the last one and no work. Then the
last population is evaluated in one piece and in parts.
"""

from __future__ import annotations

import argparse
import pickle
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

from rich.console import Console
from rich.table import Table

from flora_lab.evolve import one_run, ray_node
from flora_lab.evolve.controllers import INPUTS
from flora_lab.evolve.crew import Crew, LocalCrew, Slice, SliceWork
from flora_lab.evolve.evaluate import evaluate
from flora_lab.evolve.genome_arrays import pack
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.neat_checkpoint import engine_from
from flora_lab.evolve.neat_settings import load_settings
from flora_lab.evolve.plan import Plan, parcel_of
from flora_lab.evolve.ray_cluster import RayCluster
from flora_lab.evolve.ray_crew import RayCrew
from flora_lab.evolve.shards import divided, to_bytes
from flora_lab.evolve.task import LEFT

POPULATION = 150
REPEATS = 50
PARTS = (1, 2, 4, 8)
DIVIDED = (150, 1000, 4000)


def timed(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def by_generations(crew: Crew, plan: Plan) -> tuple[list[float], list[bytes]]:
    """Seconds of each generation, and the run after it."""
    states = [one_run.encode(one_run.first_state(plan, 1))]
    seconds: list[float] = []
    with crew:
        for _ in range(plan.generations):
            began = time.perf_counter()
            crew.send(Slice(1, states[-1]))
            states.append(crew.receive()[0].state)
            seconds.append(time.perf_counter() - began)
    return seconds, states


def there_and_back_s(data: bytes) -> float:
    """Median seconds in which bytes go to a node and back."""
    with RayCluster("local") as cluster:
        calls = cluster.calls
        return median(timed(lambda: calls.result(calls.submit("builtins:bytes", data))) for _ in range(REPEATS))


def plan_of(simulator: Path, population: int, generations: int) -> Plan:
    return Plan(parcel_of(simulator), LEFT, load_settings(population=population), Individuals(), 1, generations, 1)


def ways(plan: Plan, console: Console) -> None:
    work = SliceWork(plan, seconds=0.0)
    here, wanted = by_generations(LocalCrew(1, work), plan)
    there, found = by_generations(RayCrew("local", work), plan)
    for one, other in zip(wanted, found, strict=True):
        if one_run.decode(one).engine != one_run.decode(other).engine:
            raise SystemExit("the cluster came to something else")
    half = plan.generations // 2
    way_s = there_and_back_s(found[-1])
    table = Table("what", "figure", title=f"a slice, population {POPULATION}, {plan.generations} generations")
    table.add_row("the plan, once per evolution", f"{len(pickle.dumps(work)) / 1000:.0f} kB")
    table.add_row("a run, there", f"{len(found[-2]) / 1000:.0f} kB")
    table.add_row("and back", f"{len(found[-1]) / 1000:.0f} kB")
    table.add_row("a generation in this process, median", f"{1000 * median(here[half:]):.1f} ms")
    table.add_row("a generation over the cluster, median", f"{1000 * median(there[half:]):.1f} ms")
    table.add_row("the way there and back alone, median", f"{1000 * way_s:.1f} ms")
    table.add_row("looking at versions, once per process", f"{1000 * timed(ray_node.versions):.1f} ms")
    console.print(table)


def parts(simulator: Path, generations: int, console: Console) -> None:
    table = Table("population", "parts", "plant steps", "of the whole", "ms, all parts", "kB back", title="parts")
    for population in DIVIDED:
        plan = plan_of(simulator, population, generations)
        state = one_run.advance(plan, one_run.first_state(plan, 1), seconds=1e9, clock=lambda: 0.0)
        genomes = pack(engine_from(state.engine, plan.settings).genomes, len(INPUTS))
        whole = evaluate(genomes, plan.parcel.simulator, LEFT).steps_run
        for count in PARTS:
            began = time.perf_counter()
            done = [evaluate(part, plan.parcel.simulator, LEFT) for part in divided(genomes, count)]
            took_ms = 1000 * (time.perf_counter() - began)
            steps = sum(part.steps_run for part in done)
            back_kb = sum(len(to_bytes(part)) for part in done) / 1000
            table.add_row(
                str(population), str(count), str(steps), f"{steps / whole:.2f}", f"{took_ms:.0f}", f"{back_kb:.0f}"
            )
    console.print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("simulator", type=Path, metavar="SIM")
    parser.add_argument("--generations", type=int, default=40)
    asked = parser.parse_args()
    console = Console()
    ways(plan_of(asked.simulator, POPULATION, asked.generations), console)
    parts(asked.simulator, asked.generations, console)


if __name__ == "__main__":
    main()
