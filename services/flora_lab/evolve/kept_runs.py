"""An evolution that is not over: a folder beside the one that it will become, one file per run.

``.NAME.evolution/`` beside ``NAME``: ``work.json`` says what the work is, ``run-01.json`` and so on hold the runs as
they stood last. Each file is replaced whole, so whoever is killed has the one before. The folder goes when the
evolution stands.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from flora_common import files
from flora_common.errors import BadInput
from flora_lab.evolve import one_run
from flora_lab.evolve.one_run import RunState
from flora_lab.stopped_work import check_same_work

WORK_FILE: Final = "work.json"
_REMEDY: Final = "add --force to begin anew"


def kept_path(output: Path) -> Path:
    """Where the unfinished evolution of the folder ``output`` lies."""
    return output.parent / f".{output.name}.evolution"


class KeptRuns:
    """The runs of one unfinished evolution.

    Args:
        path: of :func:`kept_path`.
        work: what the work is, see :attr:`flora_lab.evolve.plan.Plan.work`.
    """

    def __init__(self, path: Path, work: Mapping[str, Any]) -> None:
        self.path = path
        self._work: dict[str, Any] = json.loads(json.dumps(dict(work)))

    def begin(self, *, resume: bool, force: bool) -> None:
        """Make sure that the folder is there and of this work.

        Args:
            resume: go on with what is there.
            force: drop what is there.

        Raises:
            BadInput: there is something and neither is asked for, or it is of other work, or nothing can be written.
        """
        if self.path.exists() and force:
            self.remove()
        if self.path.exists():
            if not resume:
                raise BadInput(
                    f"{self.path}: holds an unfinished evolution; --resume goes on with it, --force drops it"
                )
            check_same_work(self.path, self._read_work(), self._work, _REMEDY)
            return
        try:
            files.make_folder(self.path)
            files.write_text(self.path / WORK_FILE, json.dumps(self._work, indent=1) + "\n")
        except PermissionError as problem:
            raise BadInput(f"{self.path}: cannot be written ({problem.strerror})") from problem

    def load(self, number: int) -> RunState | None:
        """Run ``number`` as it stood last, or None where it has not begun.

        Raises:
            BadInput: its file cannot be read or is damaged.
        """
        path = self._file(number)
        if not path.exists():
            return None
        try:
            state = one_run.decode(path.read_bytes())
        except OSError as problem:
            raise BadInput(f"{path}: cannot be read ({problem.strerror})") from problem
        except BadInput as problem:
            raise BadInput(f"{path}: {problem}; remove it to begin this run anew") from problem
        if state.number != number:
            raise BadInput(f"{path}: holds run {state.number}; remove it to begin run {number} anew")
        return state

    def save(self, number: int, state: bytes) -> None:
        """Keep a run.

        Raises:
            DiskFull: no room; what was kept before stands.
        """
        files.write_bytes(self._file(number), state)

    def remove(self) -> None:
        """The evolution stands, or is dropped."""
        shutil.rmtree(self.path)

    def _file(self, number: int) -> Path:
        return self.path / f"run-{number:02d}.json"

    def _read_work(self) -> dict[str, Any]:
        path = self.path / WORK_FILE
        try:
            work = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as problem:
            raise BadInput(f"{path}: cannot be read; {_REMEDY}") from problem
        if not isinstance(work, dict):
            raise BadInput(f"{path}: is damaged; {_REMEDY}")
        return work
