"""An evolution that is not over: a folder beside the one that it will become, one file per run.

``.NAME.evolution/`` beside ``NAME``: ``work.json`` says what the work is, ``run-01.json`` and so on hold the runs as
they stood last, ``time.json`` how long commands have worked on them. Each file is replaced whole, so whoever is killed
has the one before. One process at a time holds the folder. It goes when the evolution stands.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec

from flora_common import files
from flora_common.errors import BadInput
from flora_common.lock import AlreadyHeld, hold
from flora_lab.evolve import one_run
from flora_lab.evolve.one_run import Clock, RunState
from flora_lab.stopped_work import check_same_work, unfinished

WORK_FILE: Final = "work.json"
TIME_FILE: Final = "time.json"
LOCK_FILE: Final = ".lock"
UNFINISHED: Final = files.TEMPORARY_SUFFIX
_REMEDY: Final = "give --force in place of --resume to begin anew, or another -o"


def kept_path(output: Path) -> Path:
    """Where the unfinished evolution of the folder ``output`` lies."""
    return output.parent / f".{output.name}.evolution"


class Worked(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How long commands have worked on an evolution.

    Attributes:
        commands: how many; those that ended before they had kept anything do not count.
        wall_s: seconds from the start of each to its end, added up. Of one that was stopped, up to when it last kept
            something.
    """

    commands: Annotated[int, msgspec.Meta(ge=0)] = 0
    wall_s: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0


class KeptRuns(contextlib.AbstractContextManager["KeptRuns"]):
    """The runs of one unfinished evolution. Who leaves the ``with`` block lets go of them; they stay where they are.

    Args:
        path: of :func:`kept_path`.
        work: what the work is, see :attr:`flora_lab.evolve.plan.Plan.work`.
        clock: seconds that only go forward. This command's time counts from here.
    """

    def __init__(self, path: Path, work: Mapping[str, Any], clock: Clock = time.monotonic) -> None:
        self.path = path
        self._work: dict[str, Any] = json.loads(json.dumps(dict(work)))
        self._clock, self._began = clock, clock()
        self._before = Worked()
        self._lock: int | None = None

    def begin(self, *, resume: bool, force: bool) -> bool:
        """Make sure that the folder is there, of this work, and this process's alone.

        Args:
            resume: go on with what is there.
            force: drop what is there, unless it is gone on with: then what is to be replaced is the finished one.

        Returns:
            Whether there was something to go on with.

        Raises:
            BadInput: there is something and neither is asked for, or it is of other work, or another process works in
                it, or nothing can be written.
        """
        try:
            files.make_folder(self.path)
            self._lock = self._held()
            kept = [entry for entry in self.path.iterdir() if entry.name != LOCK_FILE and entry.suffix != UNFINISHED]
            if kept and not resume:
                if not force:
                    raise unfinished(self.path, "evolution")
                for entry in kept:
                    entry.unlink()
            elif kept:
                check_same_work(self.path, self._read_work(), self._work, _REMEDY)
                self._before = self._read_time()
                return True
            files.write_text(self.path / WORK_FILE, json.dumps(self._work, indent=1) + "\n")
            return False
        except OSError as problem:
            raise BadInput(f"{self.path}: cannot be written ({problem.strerror})") from problem

    def __exit__(self, *_: object) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    @property
    def worked(self) -> Worked:
        """By all commands, this one included."""
        return Worked(self._before.commands + 1, self._before.wall_s + self._clock() - self._began)

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
        """Keep a run, and how long it has taken.

        Raises:
            DiskFull: no room; what was kept before stands.
        """
        files.write_bytes(self._file(number), state)
        files.write_bytes(self.path / TIME_FILE, msgspec.json.encode(self.worked))

    def remove(self) -> None:
        """The evolution stands."""
        shutil.rmtree(self.path)

    def _held(self) -> int:
        """The lock's descriptor."""
        path = self.path / LOCK_FILE
        try:
            descriptor = hold(path)
        except AlreadyHeld as problem:
            raise BadInput(
                f"{self.path}: process {problem.pid} works in it; wait for it, or name another folder with -o"
            ) from problem
        # who had it before may have finished, and removed it with its folder, between opening and holding
        if not path.exists() or not os.path.samestat(os.fstat(descriptor), path.stat()):
            os.close(descriptor)
            raise BadInput(f"{self.path}: the process that worked in it has just ended; look what it wrote")
        return descriptor

    def _file(self, number: int) -> Path:
        return self.path / f"run-{number:02d}.json"

    def _read_time(self) -> Worked:
        """No work at all where nothing was kept yet."""
        path = self.path / TIME_FILE
        try:
            return msgspec.json.decode(path.read_bytes(), type=Worked)
        except FileNotFoundError:
            return Worked()
        except (OSError, ValueError, RecursionError) as problem:
            raise BadInput(f"{path}: cannot be read; remove it, and time counts from now on") from problem

    def _read_work(self) -> dict[str, Any]:
        path = self.path / WORK_FILE
        try:
            work = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as problem:
            raise BadInput(f"{path}: cannot be read; {_REMEDY}") from problem
        if not isinstance(work, dict):
            raise BadInput(f"{path}: is damaged; {_REMEDY}")
        return work
