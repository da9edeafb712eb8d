"""What is asked of an evaluation: which controllers, in which scenarios, on how many plants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from flora_common import files
from flora_common.controller_file import SUFFIX, LoadedController, load_controller
from flora_common.errors import BadInput
from flora_common.suggest import did_you_mean
from flora_lab.evolve.task import Task
from flora_lab.evolve.task_file import task_text


@dataclass(frozen=True, slots=True)
class NamedController:
    """A controller file that was read.

    Attributes:
        name: in tables; unique.
        path: as it was given.
        loaded: what it holds.
    """

    name: str
    path: Path
    loaded: LoadedController

    @property
    def sha256(self) -> str:
        return self.loaded.sha256


@dataclass(frozen=True, slots=True)
class Plan:
    """An evaluation, wherever it is done.

    Attributes:
        controllers: one or more.
        task: its scenarios are those in which controllers are tried.
        repeat: plants that each is tried on in each scenario.
        seed: which plants.
    """

    controllers: tuple[NamedController, ...]
    task: Task
    repeat: int
    seed: int

    @property
    def work(self) -> dict[str, Any]:
        """What makes results those of another evaluation, by names that people know.

        Not where it is done nor how often: more of either may be added to what is there.
        """
        return {
            "controllers": ", ".join(one.sha256[:12] for one in self.controllers),
            "task": self.task.name,
            "task.toml": files.sha256_of_bytes(task_text(self.task).encode()),
            "seed": self.seed,
        }


def load_controllers(paths: Sequence[Path]) -> tuple[NamedController, ...]:
    """Controller files by the names of their files; where two are called alike, their hashes tell them apart.

    Raises:
        BadInput: a file that no rig would take, or the same controller twice.
    """
    found: dict[str, NamedController] = {}
    stems = [_name(path) for path in paths]
    for path, stem in zip(paths, stems, strict=True):
        loaded = load_controller(path)
        if loaded.sha256 in found:
            raise BadInput(f"{path}: is the same controller as {found[loaded.sha256].path}; leave one of them out")
        name = f"{stem}-{loaded.sha256[:6]}" if stems.count(stem) > 1 else stem
        found[loaded.sha256] = NamedController(name, path, loaded)
    return tuple(found.values())


def only(task: Task, scenario: str | None) -> Task:
    """The task with one of its scenarios alone; as it is where None.

    Raises:
        BadInput: it has no such scenario.
    """
    if scenario is None:
        return task
    chosen = tuple(one for one in task.scenarios if one.name == scenario)
    if not chosen:
        names = [one.name for one in task.scenarios]
        raise BadInput(f"--scenario: task {task.name} has no scenario `{scenario[:40]}`{did_you_mean(scenario, names)}")
    return replace(task, scenarios=chosen)


def _name(path: Path) -> str:
    name = files.shown(path.name)
    return name.removesuffix(SUFFIX) or name
