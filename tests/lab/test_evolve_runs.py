"""Runs of an evolution come to the same bytes however they are cut up, and whoever does the pieces."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest
from evolution_examples import GENERATIONS, RUNS, contents, plan_of, write_rod

from flora_common.errors import BadInput
from flora_lab.evolve import one_run
from flora_lab.evolve.crew import LocalCrew, Slice, SliceDone, SliceWork
from flora_lab.evolve.evolution import evolve
from flora_lab.evolve.evolution_writing import history_of, write_evolution
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.kept_runs import KeptRuns
from flora_lab.evolve.one_run import RunState, advance, decode, encode, first_state
from flora_lab.evolve.plan import Plan
from flora_lab.worker_process import WorkerLost


class Silent:
    """Watches and says nothing."""

    def __init__(self) -> None:
        self.heard: list[SliceDone] = []

    def run(self, now: SliceDone) -> None:
        self.heard.append(now)


class Killed(BaseException):
    """The process is gone: nothing that would tidy up runs after it."""


class StrikesAfter(Silent):
    """Kills the whole process, so to speak, after some slices."""

    def __init__(self, slices: int) -> None:
        super().__init__()
        self.slices = slices

    def run(self, now: SliceDone) -> None:
        super().run(now)
        if len(self.heard) > self.slices:
            raise Killed


def one_generation(plan: Plan) -> SliceWork:
    return SliceWork(plan, seconds=0.0)


def straight(plan: Plan, number: int) -> RunState:
    """A run from its first to its last generation in one go."""
    return advance(plan, first_state(plan, number), seconds=1e9, clock=lambda: 0.0)


def in_folder(path: Path, plan: Plan, states: list[RunState]) -> dict[str, bytes]:
    write_evolution(path, plan, states, wall_s=1.0, force=False)
    return contents(path)


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    return plan_of(write_rod(tmp_path_factory.mktemp("simulator") / "rod.simulator"))


@pytest.fixture(scope="module")
def expected(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    states = [straight(plan, number) for number in range(1, RUNS + 1)]
    return in_folder(tmp_path_factory.mktemp("straight") / "evolution", plan, states)


def kept_in(path: Path, plan: Plan) -> KeptRuns:
    kept = KeptRuns(path, plan.work)
    kept.begin(resume=path.exists(), force=False)
    return kept


@pytest.mark.parametrize("jobs", [1, 2, 4])
def test_workers_come_to_what_one_process_comes_to(
    plan: Plan, expected: dict[str, bytes], jobs: int, tmp_path: Path
) -> None:
    with kept_in(tmp_path / "kept", plan) as kept, LocalCrew(jobs, one_generation(plan)) as crew:
        states = evolve(plan, kept, crew, Silent())
    assert in_folder(tmp_path / "evolution", plan, states) == expected


@pytest.mark.parametrize("slices", [0, 1, 4, 9, RUNS * GENERATIONS - 2])
def test_killed_anywhere_and_resumed_is_straight(
    plan: Plan, expected: dict[str, bytes], slices: int, tmp_path: Path
) -> None:
    with pytest.raises(Killed), kept_in(tmp_path / "kept", plan) as kept, LocalCrew(1, one_generation(plan)) as crew:
        evolve(plan, kept, crew, StrikesAfter(slices))
    watcher = Silent()
    with kept_in(tmp_path / "kept", plan) as kept, LocalCrew(1, SliceWork(plan)) as crew:
        states = evolve(plan, kept, crew, watcher)
    assert sum(heard.generations for heard in watcher.heard[:RUNS]) > 0
    assert in_folder(tmp_path / "evolution", plan, states) == expected


def workers() -> set[int]:
    """The processes that are at work for this one, by their numbers."""
    return {child.pid for child in multiprocessing.active_children() if child.pid is not None}


def test_the_work_of_a_lost_worker_is_done_anew(plan: Plan, expected: dict[str, bytes], tmp_path: Path) -> None:
    with kept_in(tmp_path / "kept", plan) as kept, LocalCrew(2, one_generation(plan)) as crew:
        first = workers()

        class Kills(Silent):
            def run(self, now: SliceDone) -> None:
                super().run(now)
                if len(self.heard) == 5:
                    os.kill(min(first), signal.SIGKILL)

        states = evolve(plan, kept, crew, Kills())
        assert len(workers() - first) == 1
    assert in_folder(tmp_path / "evolution", plan, states) == expected


def test_work_that_no_worker_survives_ends_the_evolution(plan: Plan, tmp_path: Path) -> None:
    with (
        kept_in(tmp_path / "kept", plan) as kept,
        LocalCrew(2, SliceWork(plan, clock=die)) as crew,
        pytest.raises(WorkerLost, match="fewer --jobs"),
    ):
        evolve(plan, kept, crew, Silent())


def die() -> float:
    os.kill(os.getpid(), signal.SIGKILL)
    return 0.0


def test_saving_a_run_changes_nothing(plan: Plan) -> None:
    state = first_state(plan, 2)
    while not one_run.is_over(plan, state):
        state = decode(encode(advance(plan, state, seconds=0.0, clock=lambda: 0.0)))
    assert encode(state) == encode(straight(plan, 2))


def test_more_runs_are_the_same_ones_and_some_more(plan: Plan) -> None:
    seeds = [plan.run_seed(number) for number in range(1, 41)]
    assert len(set(seeds)) == 40
    assert straight(plan, 1).history != straight(plan, 2).history


def test_drawn_plants_make_another_evolution(plan: Plan) -> None:
    drawn = replace(plan, individuals=Individuals(2, judge="worst"))
    assert straight(drawn, 1).history != straight(plan, 1).history
    assert drawn.work != plan.work


def test_times_are_told_apart_and_add_up(plan: Plan) -> None:
    ticks = itertools.count()
    state = advance(plan, first_state(plan, 1), seconds=0.0, clock=lambda: float(next(ticks)))
    # clock readings: begin, generation, before and after packing, after evaluation, after NEAT, is it over, the end
    assert state.took.evaluation_s > 0.0
    assert state.took.neat_s > 0.0
    total = state.took.evaluation_s + state.took.neat_s + state.took.other_s
    assert total == next(ticks) - 1


def test_the_history_is_that_of_the_best_genomes(plan: Plan) -> None:
    history = history_of([straight(plan, number) for number in range(1, RUNS + 1)])
    assert history.best_fitness.shape == (RUNS, GENERATIONS)
    assert (history.best_fitness >= history.median_fitness).all()
    assert (history.best_so_far[:, -1] == history.best_fitness.max(axis=1)).all()
    assert abs(history.by_scenario.mean(axis=2) - history.best_fitness).max() < 1e-12
    assert (history.plant_steps < history.episode_steps).all()


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda data: data[: len(data) // 2], "is damaged or no run"),
        (lambda data: data.replace(b'"number":1', b'"number":2', 1), "does not fit its SHA-256"),
        (lambda data: b"{}", "is damaged or no run"),
        (lambda data: data.replace(b"flora-evolution-run-1", b"flora-evolution-run-9"), "this program reads"),
    ],
)
def test_a_damaged_run_is_told_and_left(plan: Plan, tmp_path: Path, damage: object, message: str) -> None:
    data = encode(first_state(plan, 1))
    assert callable(damage)
    with kept_in(tmp_path / "kept", plan) as kept:
        kept.save(1, damage(data))
        with pytest.raises(BadInput, match=message) as problem:
            kept.load(1)
    assert "run-01.json" in str(problem.value)
    assert (tmp_path / "kept" / "run-01.json").read_bytes() == damage(data)


def test_a_run_under_another_ones_name_is_told(plan: Plan, tmp_path: Path) -> None:
    with kept_in(tmp_path / "kept", plan) as kept:
        kept.save(2, encode(first_state(plan, 1)))
        with pytest.raises(BadInput, match="holds run 1"):
            kept.load(2)


def test_a_slice_can_be_done_twice(plan: Plan) -> None:
    work = SliceWork(plan, seconds=0.0, clock=lambda: 0.0)
    part = Slice(1, encode(first_state(plan, 1)))
    assert work(part) == work(part)
