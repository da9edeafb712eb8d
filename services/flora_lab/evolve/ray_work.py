"""What nodes of a Ray cluster do: slices of runs, and parts of populations."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from flora_lab.evolve import shards
from flora_lab.evolve.crew import Slice, SliceWork
from flora_lab.evolve.evaluate import Evaluated, evaluate
from flora_lab.evolve.genome_arrays import GenomeArrays
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.ray_calls import Calls
from flora_lab.evolve.task import Task
from flora_lab.simulator.interface import Simulator
from flora_lab.threads import one_blas_thread
from flora_lab.worker_process import outcome

NOTHING: Final = f"{__name__}:nothing"
SLICE: Final = f"{__name__}:do_slice"
PART: Final = f"{__name__}:do_part"


def nothing() -> None:
    """Only whether flora can be called there."""


def do_slice(parcel: bytes, number: int, state: bytes, parts: int, again: list[Any], wanted: dict[str, str]) -> bytes:
    """Do a slice.

    Args:
        parcel: a pickled :class:`flora_lab.evolve.crew.SliceWork`.
        number, state: of the :class:`flora_lab.evolve.crew.Slice`.
        parts: in which each generation is evaluated; with more than one, other nodes take part.
        again: the reference to ``parcel``; in a list, for Ray puts its content in place of a bare one.
        wanted: versions, for the calls of other nodes.

    Returns:
        Pickled: whether it was done, and the :class:`flora_lab.evolve.crew.SliceDone` or what it raised.
    """
    work: SliceWork = pickle.loads(parcel)
    if parts > 1:
        work = replace(work, evaluate=Sharded(parts, again[0], wanted))
    return pickle.dumps(outcome(work, Slice(number, state)), protocol=pickle.HIGHEST_PROTOCOL)


def do_part(parcel: bytes, genomes: bytes) -> bytes:
    """Evaluate a part of a population.

    Args:
        parcel: as in :func:`do_slice`.
        genomes: a pickled :class:`flora_lab.evolve.genome_arrays.GenomeArrays`.

    Returns:
        Pickled: whether it was done, and :func:`flora_lab.evolve.shards.to_bytes` or what it raised.
    """
    work: SliceWork = pickle.loads(parcel)

    def evaluated(part: GenomeArrays) -> bytes:
        plan = work.plan
        with one_blas_thread():
            return shards.to_bytes(evaluate(part, plan.parcel.simulator, plan.task, plan.individuals))

    return pickle.dumps(outcome(evaluated, pickle.loads(genomes)), protocol=pickle.HIGHEST_PROTOCOL)


@dataclass(frozen=True, slots=True)
class Sharded:
    """Evaluates the first part of a population here and the others on other nodes.

    Attributes:
        parts: how many.
        parcel: reference to the work.
        wanted: versions.
    """

    parts: int
    parcel: Any
    wanted: Mapping[str, str]

    def __call__(
        self, genomes: GenomeArrays, simulator: Simulator[Any], task: Task, individuals: Individuals
    ) -> Evaluated:
        """See :func:`flora_lab.evolve.evaluate.evaluate`.

        Raises:
            WorkerLost: parts were lost, as often as Ray does them anew.
        """
        calls = Calls(self.wanted)
        first, *others = shards.divided(genomes, self.parts)
        sent = [calls.submit(PART, self.parcel, pickle.dumps(part, pickle.HIGHEST_PROTOCOL)) for part in others]
        done = [evaluate(first, simulator, task, individuals)]
        for reference in sent:
            fine, result = pickle.loads(calls.result(reference))
            if not fine:
                raise result
            done.append(shards.from_bytes(result))
        return shards.joined(done)
