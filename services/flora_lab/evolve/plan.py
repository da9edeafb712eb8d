"""What an evolution is: everything that its result follows from, as one thing that can be sent to any machine."""

from __future__ import annotations

import functools
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flora_common import files
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.neat_settings import NeatSettings
from flora_lab.evolve.task import Task
from flora_lab.evolve.task_file import task_text
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.load import load, simulator_of
from flora_lab.simulator.store import INFO_FILE, WEIGHTS_FILE, SimulatorFile, read_stored, software


@dataclass(frozen=True, slots=True)
class SimulatorParcel:
    """A simulator folder as bytes: workers on other machines need not see this one's disk.

    Attributes:
        name: of the folder.
        info: content of ``simulator.toml``, checked.
        content: file names and contents.
    """

    name: str
    info: SimulatorFile
    content: tuple[tuple[str, bytes], ...]

    @property
    def simulator(self) -> Simulator[Any]:
        """The simulator itself; made once in a process."""
        return _unpacked(self.content)

    @property
    def dataset_sha256(self) -> str:
        """What the simulator was learned from: the training set's hash, or one over those of all its tracks."""
        provenance = self.info.provenance
        tracks = "\n".join(sorted(f"{track.sha256} {track.part}" for track in provenance.track))
        return provenance.dataset_sha256 or (files.sha256_of_bytes(tracks.encode()) if tracks else "")


@functools.lru_cache(maxsize=2)
def _unpacked(content: tuple[tuple[str, bytes], ...]) -> Simulator[Any]:
    with tempfile.TemporaryDirectory(prefix="flora-simulator-") as folder:
        for name, data in content:
            (Path(folder) / name).write_bytes(data)
        return load(Path(folder))


def parcel_of(path: Path) -> SimulatorParcel:
    """A simulator folder, checked.

    Raises:
        BadInput: it is none, is damaged, or is of a kind that this program does not know.
    """
    stored = read_stored(path)
    simulator_of(stored)
    content = tuple((name, (path / name).read_bytes()) for name in (INFO_FILE, WEIGHTS_FILE))
    return SimulatorParcel(path.resolve().name, stored.info, content)


@dataclass(frozen=True, slots=True)
class Plan:
    """An evolution.

    Attributes:
        parcel: the simulator that controllers are tried in.
        task: what they are to do.
        settings: of NEAT, population included.
        individuals: plants that each is tried on.
        runs: independent evolutions.
        generations: of each.
        seed: of all runs.
    """

    parcel: SimulatorParcel
    task: Task
    settings: NeatSettings
    individuals: Individuals
    runs: int
    generations: int
    seed: int

    def run_seed(self, number: int) -> int:
        """Of run ``number``, from 1. More runs of the same seed are the same ones and some more."""
        return int(np.random.SeedSequence([self.seed, number]).generate_state(1)[0])

    @property
    def members(self) -> int:
        """Of how many members of the simulator, or their mean, a drawn plant follows one; 0 where it follows none."""
        return len(self.parcel.simulator.members()) if self.individuals.count else 0

    @property
    def work(self) -> dict[str, Any]:
        """What makes this evolution another one, as plain values by names that people know."""
        members = {"individuals' members": self.members} if self.members else {}
        return members | {
            "simulator": self.parcel.info.weights_sha256,
            "simulator.toml": files.sha256_of_bytes(dict(self.parcel.content)[INFO_FILE]),
            "task": self.task.name,
            "task.toml": files.sha256_of_bytes(task_text(self.task).encode()),
            "settings of NEAT": files.sha256_of_bytes(self.settings.text.encode()),
            "individuals": self.individuals.count,
            "individuals' seed": self.individuals.seed,
            "judge": self.individuals.judge,
            "runs": self.runs,
            "generations": self.generations,
            "seed": self.seed,
            "software": software(),
        }
