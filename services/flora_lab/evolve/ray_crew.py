"""A crew on the machines of a Ray cluster: ``flora-lab evolve --cluster ADDRESS``."""

from __future__ import annotations

import contextlib
import pickle
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Final, Self

from flora_lab.evolve import ray_work
from flora_lab.evolve.crew import TRIES, Slice, SliceDone, SliceWork
from flora_lab.evolve.ray_cluster import RayCluster
from flora_lab.evolve.shards import LEAST_GENOMES, shard_count
from flora_lab.worker_process import WorkerLost

_WAIT_S: Final = 1.0
"""How often it is looked whether there is still a node, while no slice comes in."""
NO_NODE_S: Final = 300.0
"""How long the last node that left may take to come back."""


class RayCrew:
    """Machines of a Ray cluster. A :class:`flora_lab.evolve.crew.Crew`.

    A slice whose node is lost is done anew: by Ray, and where it gives up, :data:`flora_lab.evolve.crew.TRIES` times
    from here. Nodes may come and go; each takes as many slices as it has CPUs. Where there are more CPUs than runs,
    several of them evaluate one population.

    Args:
        address: see :class:`flora_lab.evolve.ray_cluster.RayCluster`.
        work: on slices.
        least_genomes: that are worth a machine's while, see :data:`flora_lab.evolve.shards.LEAST_GENOMES`.
        cluster: the connection; one to ``address`` where none is given.
    """

    def __init__(
        self,
        address: str,
        work: SliceWork,
        *,
        least_genomes: int = LEAST_GENOMES,
        cluster: RayCluster | None = None,
    ) -> None:
        self._cluster = cluster if cluster is not None else RayCluster(address)
        self._work = work
        self._least_genomes = least_genomes
        self._parcel: Any = None
        self._busy: dict[Any, Slice] = {}
        self._lost: dict[int, int] = {}
        self._after = contextlib.ExitStack()

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as undo:
            undo.enter_context(self._cluster)
            self._parcel = self._cluster.calls.put(pickle.dumps(self._work, protocol=pickle.HIGHEST_PROTOCOL))
            undo.callback(lambda: self._cluster.cancel(list(self._busy)))
            self._after = undo.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._after.close()

    @property
    def room(self) -> int:
        """See :class:`flora_lab.evolve.crew.Crew`. There is always room for one slice, which waits for a node."""
        return max(self._cpus() - len(self._busy), 0 if self._busy else 1)

    def send(self, part: Slice) -> None:
        """See :class:`flora_lab.evolve.crew.Crew`."""
        population = self._work.plan.settings.population
        parts = shard_count(population, self._cpus() // (len(self._busy) + 1), least=self._least_genomes)
        calls = self._cluster.calls
        reference = calls.submit(
            ray_work.SLICE, self._parcel, part.number, part.state, parts, [self._parcel], calls.wanted
        )
        self._busy[reference] = part

    def receive(self) -> Sequence[SliceDone]:
        """See :class:`flora_lab.evolve.crew.Crew`."""
        done: list[SliceDone] = []
        alone_s = 0.0
        while not done:
            ready = self._cluster.first_done(list(self._busy), wait_s=_WAIT_S)
            alone_s = alone_s + _WAIT_S if not ready and not self._cpus() else 0.0
            if alone_s >= NO_NODE_S:
                raise WorkerLost(f"the cluster has had no node to work on for {NO_NODE_S:g} s; start one and --resume")
            for reference in ready:
                part = self._busy.pop(reference)
                try:
                    done.append(self._done(reference))
                except WorkerLost as problem:
                    self._again(part, problem)
                else:
                    self._lost.pop(part.number, None)
        return done

    def _done(self, reference: Any) -> SliceDone:
        fine, result = pickle.loads(self._cluster.calls.result(reference))
        if not fine:
            raise result
        done: SliceDone = result
        return done

    def _again(self, part: Slice, problem: WorkerLost) -> None:
        self._lost[part.number] = self._lost.get(part.number, 0) + 1
        if self._lost[part.number] >= TRIES:
            raise problem
        self.send(part)

    def _cpus(self) -> int:
        return sum(node.cpus for node in self._cluster.nodes())
