"""Progress bars that are also told to whoever waits for the command from afar.

A command that is started with ``FLORA_PROGRESS_FILE`` in its environment keeps its bars' state in that file, whole at
any moment, whether it draws them or not.
"""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path
from typing import Any, Final

import msgspec
from rich.progress import Progress, TaskID

ENVIRONMENT: Final = "FLORA_PROGRESS_FILE"
EVERY_S: Final = 0.5
_MOST_TEXT: Final = 200


class Told(msgspec.Struct, frozen=True):
    """How far a command is.

    Attributes:
        text: what it does now.
        share: of that, 0 to 1; None where it is not known.
    """

    text: str
    share: float | None = None


class Teller:
    """Writes to the file that the environment names; does nothing where it names none."""

    def __init__(self) -> None:
        self._path = os.environ.get(ENVIRONMENT, "")
        self._told = Told("")
        self._at_s = 0.0

    def tell(self, text: str, done: float, total: float | None) -> None:
        """How far it is; told at once where the text is another, else now and then."""
        if not self._path:
            return
        share = None if not total else min(1.0, max(0.0, done / total))
        told = Told(text[:_MOST_TEXT], share)
        now_s = time.monotonic()
        if told == self._told or (told.text == self._told.text and now_s - self._at_s < EVERY_S):
            return
        self._told, self._at_s = told, now_s
        temporary = Path(f"{self._path}.{os.getpid()}")
        # Who cannot be told is not told: the work itself must not end for that.
        with contextlib.suppress(OSError):
            temporary.write_bytes(msgspec.json.encode(told))
            temporary.replace(self._path)


def read_told(path: Path) -> Told | None:
    """What a command told last; None where it has told nothing that can be read."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=Told)
    except (OSError, ValueError, RecursionError):
        return None


class Bars(Progress):
    """As rich's, and told."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._teller = Teller()

    def add_task(self, description: str, *arguments: Any, **fields: Any) -> TaskID:
        task = super().add_task(description, *arguments, **fields)
        self._tell(task)
        return task

    def update(self, task_id: TaskID, **changes: Any) -> None:
        super().update(task_id, **changes)
        self._tell(task_id)

    def advance(self, task_id: TaskID, advance: float = 1) -> None:
        super().advance(task_id, advance)
        self._tell(task_id)

    def _tell(self, task_id: TaskID) -> None:
        task = self._tasks[task_id]
        if task.visible:
            self._teller.tell(task.description, task.completed, task.total)
