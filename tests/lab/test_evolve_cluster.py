"""``flora-lab evolve --cluster`` on real Ray nodes of this machine; one of them is killed."""

from __future__ import annotations

import json
import os
import platform
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from evolution_examples import GENERATIONS, POPULATION, RUNS, contents, plan_of, write_rod, write_task
from evolve_cluster_gate import ARRIVED, GATE, GatedEvaluate, close_gate, refuses

from flora_common.errors import BadInput
from flora_lab.evolve import ray_cluster
from flora_lab.evolve.crew import LocalCrew, SliceDone, SliceWork
from flora_lab.evolve.evolution import evolve
from flora_lab.evolve.evolution_writing import write_evolution
from flora_lab.evolve.kept_runs import KeptRuns, kept_path
from flora_lab.evolve.plan import Plan
from flora_lab.evolve.ray_crew import RayCrew

pytest.importorskip("ray", reason="Ray is not installed; `make test-cluster` has it")

HERE = "127.0.0.2"
"""Only this machine reaches it, and Ray does not put the machine's own address in its place."""

STRIKES = """
import os, signal, sys
from flora_lab.evolve import evolution
from flora_lab.main import main

save = evolution.KeptRuns.save

def save_and_strike(self, number, state):
    save(self, number, state)
    os.kill(os.getpid(), signal.{signal})

evolution.KeptRuns.save = save_and_strike
sys.exit(main(sys.argv[1:]))
"""
"""The command, stopped when the first run comes in and others are under way."""


class Watcher:
    """Says nothing; calls something after some slices."""

    def __init__(self, after: int = -1, call: Any = None) -> None:
        self.heard: list[SliceDone] = []
        self._after, self._call = after, call

    def run(self, now: SliceDone) -> None:
        self.heard.append(now)
        if len(self.heard) == self._after:
            self._call()


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two nodes of one CPU each, that only this machine can reach."""
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("RAY_AUTH_MODE", "disabled")
        paths = [str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
        patch.setenv("PYTHONPATH", os.pathsep.join(paths))
        head = {"num_cpus": 1, "include_dashboard": False, "node_ip_address": HERE}
        nodes = Cluster(initialize_head=True, head_node_args=head)
        try:
            nodes.add_node(num_cpus=1, node_ip_address=HERE)
            yield nodes
        finally:
            nodes.shutdown()


@pytest.fixture(scope="module")
def simulator(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_rod(tmp_path_factory.mktemp("simulator") / "rod.simulator")


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_task(tmp_path_factory.mktemp("task") / "short.toml")


@pytest.fixture(scope="module")
def plan(simulator: Path) -> Plan:
    return plan_of(simulator)


@pytest.fixture(scope="module")
def expected(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What this process alone comes to."""
    return evolved(plan, LocalCrew(1, SliceWork(plan)), Watcher(), tmp_path_factory.mktemp("local"))


def evolved(plan: Plan, crew: Any, watcher: Watcher, folder: Path) -> dict[str, bytes]:
    with KeptRuns(folder / "kept", plan.work) as kept, crew:
        kept.begin(resume=False, force=False)
        states = evolve(plan, kept, crew, watcher)
    write_evolution(folder / "evolution", plan, states, wall_s=1.0, force=False)
    return contents(folder / "evolution")


def words(simulator: Path, task: Path, output: Path, cluster: Any, *more: str) -> list[str]:
    few = ["--runs", str(RUNS), "--generations", str(GENERATIONS), "--population", str(POPULATION)]
    told = ["evolve", str(simulator), "--task", str(task), "-o", str(output), *few, "--no-report"]
    return [*told, "--cluster", cluster.address, *more]


def command(
    arguments: list[str], program: Sequence[str] = ("-m", "flora_lab.main")
) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *program, *arguments], capture_output=True, text=True, timeout=120)


def test_a_cluster_comes_to_what_one_process_comes_to(
    cluster: Any, plan: Plan, expected: dict[str, bytes], tmp_path: Path
) -> None:
    watcher = Watcher()
    crew = RayCrew(cluster.address, SliceWork(plan, seconds=0.0))
    assert evolved(plan, crew, watcher, tmp_path) == expected
    assert len(watcher.heard) == RUNS * GENERATIONS


def test_populations_in_parts_come_to_the_same(
    cluster: Any, plan: Plan, expected: dict[str, bytes], tmp_path: Path
) -> None:
    crew = RayCrew(cluster.address, SliceWork(plan), least_genomes=POPULATION // 2)
    assert evolved(plan, crew, Watcher(), tmp_path) == expected


def test_what_the_work_raises_on_a_node_is_raised_here(cluster: Any, plan: Plan, tmp_path: Path) -> None:
    crew = RayCrew(cluster.address, SliceWork(plan, evaluate=refuses))
    with pytest.raises(BadInput, match=r"^this simulator is refused$"):
        evolved(plan, crew, Watcher(), tmp_path)


def test_the_command_says_what_it_says_without_a_cluster(
    cluster: Any, simulator: Path, task: Path, expected: dict[str, bytes], tmp_path: Path
) -> None:
    done = command(words(simulator, task, tmp_path / "e", cluster, "--json"))
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["runs"] == RUNS
    assert contents(tmp_path / "e") == expected


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_stopped_and_resumed_is_straight(
    cluster: Any, simulator: Path, task: Path, expected: dict[str, bytes], name: str, tmp_path: Path
) -> None:
    told = words(simulator, task, tmp_path / "e", cluster)
    struck = command(told, program=["-c", STRIKES.format(signal=name)])
    assert struck.returncode == {"SIGINT": 130, "SIGTERM": 128 + signal.SIGTERM}[name]
    said = f"the runs are kept in {kept_path(tmp_path / 'e')}; the same command with --resume goes on\n"
    assert struck.stderr == said + ("flora-lab: interrupted\n" if name == "SIGINT" else "")
    resumed = command([*told, "--resume"])
    assert (resumed.returncode, resumed.stderr) == (0, "")
    assert contents(tmp_path / "e") == expected


def test_a_node_with_another_flora_is_named(cluster: Any, plan: Plan, tmp_path: Path) -> None:
    other = tmp_path / "flora-9.9.9.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: flora\nVersion: 9.9.9\n")
    paths = {"PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ["PYTHONPATH"]])}
    node = cluster.add_node(num_cpus=1, node_ip_address=HERE, env_vars=paths)
    try:
        with pytest.raises(BadInput, match=rf"node {platform.node()}: flora is 9\.9\.9 there and .* here"):
            RayCrew(cluster.address, SliceWork(plan)).__enter__()
    finally:
        cluster.remove_node(node)


def test_an_address_where_nobody_answers_is_told(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_cluster, "_ANSWER_S", 0.2)
    with socket.create_server((HERE, 0)) as silent:
        address = f"{HERE}:{silent.getsockname()[1]}"
        with pytest.raises(BadInput, match=f"--cluster {address}: no Ray cluster answers there"):
            RayCrew(address, SliceWork(plan)).__enter__()


def test_a_node_that_joins_and_is_killed_at_work_changes_nothing(
    cluster: Any, plan: Plan, expected: dict[str, bytes], tmp_path: Path
) -> None:
    crew = RayCrew(cluster.address, SliceWork(plan, seconds=0.0, evaluate=GatedEvaluate(tmp_path)))
    pipes: list[Any] = []

    def kill_at_work(node: Any) -> None:
        pipes.append((tmp_path / ARRIVED).open("wb"))  # waits until the victim is at work
        (raylet,) = node.all_processes["raylet"]
        raylet.process.kill()
        raylet.process.wait()  # its workers end when they see that it is gone
        pipes.append((tmp_path / GATE).open("wb"))

    killer: list[threading.Thread] = []

    def join_and_be_killed() -> None:
        room = crew.room
        victim = cluster.add_node(num_cpus=1, node_ip_address=HERE)
        assert crew.room == room + 1
        close_gate(tmp_path, victim.node_id)
        killer.append(threading.Thread(target=kill_at_work, args=(victim,), daemon=True))
        killer[0].start()

    watcher = Watcher(5, join_and_be_killed)
    assert evolved(plan, crew, watcher, tmp_path) == expected
    killer[0].join()
    assert len(watcher.heard) == RUNS * GENERATIONS
    for pipe in pipes:
        pipe.close()
