"""Evolutions so small that they take seconds, with a real simulator."""

from __future__ import annotations

from pathlib import Path

from flora_common.runs import LampsSection
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.neat_settings import load_settings
from flora_lab.evolve.plan import Plan, parcel_of
from flora_lab.evolve.task import LEFT, Task
from flora_lab.evolve.task_file import task_text
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.growing import DataRange
from flora_lab.simulator.individual import Prior
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.store import Provenance, write_simulator
from flora_lab.simulator.tropism_traits import prior_mean, prior_spread

GENERATIONS = 6
POPULATION = 20
RUNS = 3
TASK = Task("short", LEFT.scenarios, LEFT.start_cm, LEFT.stop_height_cm, hours=6.0)


def write_rod(path: Path) -> Path:
    """The mechanistic simulator that nobody trained."""
    plant = RodSimulator(LampsSection(), Prior(prior_mean(), prior_spread()), DriveNoise(), DataRange(30.0, 10.0))
    write_simulator(
        path,
        kind=plant.kind,
        step_s=plant.step_s,
        weights=plant.weights(),
        scales=plant.scales(),
        provenance=Provenance("mechanistic", 1, "flora test", dataset_sha256="d" * 64),
    )
    return path


def write_task(path: Path) -> Path:
    path.write_text(task_text(TASK), encoding="utf-8")
    return path


def plan_of(
    simulator: Path, *, runs: int = RUNS, generations: int = GENERATIONS, seed: int = 1, individuals: int = 0
) -> Plan:
    """A plan of a few short runs."""
    return Plan(
        parcel_of(simulator),
        TASK,
        load_settings(population=POPULATION),
        Individuals(individuals),
        runs,
        generations,
        seed,
    )


def contents(folder: Path) -> dict[str, bytes]:
    """Everything in an evolution that must not depend on how it was computed; the time that it took is left out."""
    found = {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix not in {".html", ".png", ".gif"}
    }
    info = found["evolution.toml"].decode()
    found["evolution.toml"] = info[: info.index("[took]")].encode() if "[took]" in info else b""
    assert found["evolution.toml"], "evolution.toml tells the time last"
    return found
