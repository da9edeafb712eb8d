"""Work for tests of clusters, that nodes must be able to import.

:class:`GatedEvaluate` stands still on one node until that node is killed, so that no clock decides what is lost. There
are two named pipes in a folder. Once they are there, whoever evaluates on the victim opens ``arrived`` and waits, which
the test hears; everybody else waits until the test opens ``gate``.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flora_common.errors import BadInput
from flora_lab.evolve.evaluate import Evaluated, evaluate
from flora_lab.evolve.genome_arrays import GenomeArrays
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.task import Task

ARRIVED, GATE, VICTIM = "arrived", "gate", "victim"


def close_gate(folder: Path, victim: str) -> None:
    """From now on work stands still.

    Args:
        folder: of the pipes.
        victim: Ray's name for the node.
    """
    (folder / VICTIM).write_text(victim)
    os.mkfifo(folder / ARRIVED)
    os.mkfifo(folder / GATE)


@dataclass(frozen=True, slots=True)
class GatedEvaluate:
    """Evaluates as :func:`flora_lab.evolve.evaluate.evaluate` does, and stops at the gate.

    Attributes:
        folder: of the pipes.
    """

    folder: Path

    def __call__(self, genomes: GenomeArrays, simulator: Any, task: Task, individuals: Individuals) -> Evaluated:
        if (self.folder / GATE).exists():
            is_victim = node() == (self.folder / VICTIM).read_text()
            with (self.folder / (ARRIVED if is_victim else GATE)).open("rb") as pipe:
                if is_victim:
                    pipe.read()  # to its end, which comes when the test is over
        return evaluate(genomes, simulator, task, individuals)


def node() -> str:
    """Ray's name for the node that this runs on."""
    import ray

    return str(ray.get_runtime_context().get_node_id())


def refuses(genomes: GenomeArrays, simulator: Any, task: Task, individuals: Individuals) -> Evaluated:
    """Evaluates nothing."""
    raise BadInput("this simulator is refused")
