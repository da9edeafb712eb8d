"""How a crew on a cluster deals with lost work, nodes that come and go, and addresses: without Ray."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from evolution_examples import GENERATIONS, RUNS, plan_of, write_rod
from evolve_cluster_gate import refuses

from flora_common.errors import BadInput
from flora_lab.evolve import one_run, ray_node, ray_work
from flora_lab.evolve.crew import TRIES, LocalCrew, Slice, SliceWork
from flora_lab.evolve.evolution import evolve
from flora_lab.evolve.kept_runs import KeptRuns
from flora_lab.evolve.plan import Plan
from flora_lab.evolve.ray_calls import ray_module
from flora_lab.evolve.ray_cluster import Node, check_address
from flora_lab.evolve.ray_crew import RayCrew
from flora_lab.worker_process import WorkerLost


class Nobody:
    """Watches and says nothing."""

    def run(self, now: object) -> None:
        pass


class FakeCluster:
    """A cluster in this process: calls are done when they are waited for, or lost."""

    def __init__(self, cpus: Sequence[int] = (1, 1)) -> None:
        self.cpus = list(cpus)
        self.to_lose = 0
        self.parts: list[int] = []
        self.cancelled: list[int] = []
        self.is_open = False
        self.wanted: dict[str, str] = {}
        self._sent: dict[int, tuple[str, tuple[Any, ...]]] = {}

    @property
    def calls(self) -> FakeCluster:
        return self

    def __enter__(self) -> FakeCluster:
        self.is_open = True
        return self

    def __exit__(self, *error: object) -> None:
        self.is_open = False

    def nodes(self) -> list[Node]:
        return [Node(str(number), f"node {number}", cpus) for number, cpus in enumerate(self.cpus)]

    def put(self, data: bytes) -> bytes:
        return data

    def submit(self, target: str, *arguments: Any) -> int:
        parcel, number, state, parts, *rest = arguments
        self.parts.append(parts)
        self._sent[len(self.parts)] = target, (parcel, number, state, 1, *rest)
        return len(self.parts)

    def first_done(self, references: Sequence[int], *, wait_s: float) -> list[int]:
        return list(references)[:1] if self.cpus else []

    def result(self, reference: int) -> Any:
        target, arguments = self._sent.pop(reference)
        if self.to_lose:
            self.to_lose -= 1
            raise WorkerLost("the node is gone")
        assert target == ray_work.SLICE
        return ray_work.do_slice(*arguments)

    def cancel(self, references: Sequence[int]) -> None:
        assert self.is_open
        self.cancelled.extend(references)


@pytest.fixture(scope="module")
def simulator(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_rod(tmp_path_factory.mktemp("simulator") / "rod.simulator")


@pytest.fixture(scope="module")
def plan(simulator: Path) -> Plan:
    return plan_of(simulator)


def crew_on(cluster: FakeCluster, plan: Plan, **options: Any) -> RayCrew:
    return RayCrew("local", SliceWork(plan, seconds=0.0), cluster=cluster, **options)  # type: ignore[arg-type]


def kept_in(path: Path, plan: Plan) -> KeptRuns:
    kept = KeptRuns(path, plan.work)
    kept.begin(resume=False, force=False)
    return kept


def first_slice(plan: Plan, number: int = 1) -> Slice:
    return Slice(number, one_run.encode(one_run.first_state(plan, number)))


def test_lost_work_is_sent_again_and_nothing_else_changes(plan: Plan, tmp_path: Path) -> None:
    cluster = FakeCluster()
    cluster.to_lose = TRIES - 1
    with kept_in(tmp_path / "ray", plan) as kept, crew_on(cluster, plan) as crew:
        found = evolve(plan, kept, crew, Nobody())
    with kept_in(tmp_path / "local", plan) as kept, LocalCrew(1, SliceWork(plan)) as local:
        wanted = evolve(plan, kept, local, Nobody())
    assert [(run.engine, run.history) for run in found] == [(run.engine, run.history) for run in wanted]
    assert len(cluster.parts) == RUNS * GENERATIONS + TRIES - 1


def test_work_that_is_always_lost_ends_the_evolution(plan: Plan) -> None:
    cluster = FakeCluster()
    cluster.to_lose = 1000
    with crew_on(cluster, plan) as crew:
        crew.send(first_slice(plan))
        with pytest.raises(WorkerLost, match="the node is gone"):
            crew.receive()
    assert len(cluster.parts) == TRIES
    assert not cluster.is_open


def test_a_loss_long_ago_does_not_count(plan: Plan) -> None:
    cluster = FakeCluster()
    with crew_on(cluster, plan) as crew:
        part = first_slice(plan)
        for _ in range(GENERATIONS):
            cluster.to_lose = TRIES - 1
            crew.send(part)
            (done,) = crew.receive()
            part = Slice(done.number, done.state)


def test_what_the_work_raises_is_raised(plan: Plan) -> None:
    work = SliceWork(plan, evaluate=refuses)
    with RayCrew("local", work, cluster=FakeCluster()) as crew:  # type: ignore[arg-type]
        crew.send(first_slice(plan))
        with pytest.raises(BadInput, match="this simulator is refused"):
            crew.receive()


def test_room_follows_the_nodes(plan: Plan) -> None:
    cluster = FakeCluster([2, 1])
    with crew_on(cluster, plan) as crew:
        assert crew.room == 3
        crew.send(first_slice(plan))
        assert crew.room == 2
        cluster.cpus.append(4)
        assert crew.room == 6
        cluster.cpus[:] = [0, 1]
        assert crew.room == 0
        crew.receive()
        assert crew.room == 1
        cluster.cpus.clear()
        assert crew.room == 1, "one slice waits for the next node"


def test_it_does_not_wait_for_ever_for_a_node(plan: Plan) -> None:
    cluster = FakeCluster([])
    with crew_on(cluster, plan) as crew:
        crew.send(first_slice(plan))
        with pytest.raises(WorkerLost, match="no node to work on for 300 s; start one and --resume"):
            crew.receive()
    assert cluster.cancelled == [1]


def test_work_under_way_is_cancelled_at_the_end(plan: Plan) -> None:
    cluster = FakeCluster()
    with crew_on(cluster, plan) as crew:
        crew.send(first_slice(plan, 1))
        crew.send(first_slice(plan, 2))
    assert cluster.cancelled == [1, 2]
    assert not cluster.is_open


def test_processors_without_a_run_help_with_others(plan: Plan) -> None:
    cluster = FakeCluster([8])
    with crew_on(cluster, plan, least_genomes=5) as crew:
        for number in (1, 2, 3):
            crew.send(first_slice(plan, number))
    assert cluster.parts == [4, 4, 2]
    small = FakeCluster([8])
    with crew_on(small, plan) as crew:
        crew.send(first_slice(plan))
    assert small.parts == [1]


@pytest.mark.parametrize("address", ["local", "auto", "10.0.0.5:6379", "box.lan:6379", "ray://head:10001", "[::1]:1"])
def test_addresses_of_clusters(address: str) -> None:
    check_address(address)


@pytest.mark.parametrize(
    "address", ["", "head", "head:", "head:port", "head:0", "head:70000", "http://head:1", "ray://head", "a b:1", "-x"]
)
def test_what_is_no_address_is_told(address: str) -> None:
    with pytest.raises(BadInput, match=r"local, auto, HOST:PORT or ray://HOST:10001"):
        check_address(address)


def test_without_ray_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(BadInput, match=r"--cluster needs Ray.*EXTRAS=rig,lab,cluster,dev"):
        ray_module()


def test_a_node_with_another_flora_does_not_do_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_node, "_known", {})
    here = ray_node.versions()
    assert ray_node.call(here, ray_work.NOTHING) == (ray_node.DONE, None)
    what, (machine, name, version) = ray_node.call({**here, "flora": "9.9.9"}, "no_such_module:function")
    assert (what, name, version) == (ray_node.DIFFERS, "flora", here["flora"])
    assert machine


def test_a_machine_without_flora_can_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_node, "LIBRARIES", ("a-library-that-nobody-has",))
    monkeypatch.setattr(ray_node, "PACKAGES", ("a_package_that_nobody_has",))
    found = ray_node.versions()
    assert found["a-library-that-nobody-has"] == found["flora's source"] == "not installed"


def test_the_code_that_goes_to_nodes_needs_the_standard_library_only() -> None:
    lines = Path(ray_node.__file__).read_text().splitlines()
    imported = {line.split()[1].partition(".")[0] for line in lines if line.startswith(("import ", "from "))}
    assert imported <= sys.stdlib_module_names


def test_results_go_back_as_bytes(plan: Plan) -> None:
    part = first_slice(plan)
    work = SliceWork(plan, seconds=0.0, clock=float)
    answer = ray_work.do_slice(pickle.dumps(work), part.number, part.state, 1, [], {})
    assert pickle.loads(answer) == (True, work(part))
