"""What a training has come to, beside the simulator that it will become.

``.NAME.checkpoint`` beside the folder ``NAME`` is one file: a line with its form and the SHA-256 of all that follows, a
line of JSON with what the work is and what else is needed, and the arrays as safetensors. It is replaced whole, so
whoever is killed has the one before. It goes when the simulator stands.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import numpy as np
import safetensors.numpy

from flora_common import files
from flora_common.arrays import Array
from flora_common.errors import BadInput
from flora_lab.stopped_work import check_same_work

FORMAT: Final = "flora-checkpoint-2"
EVERY_S: Final = 1.0


@dataclass(frozen=True, slots=True)
class Saved:
    """The content of a checkpoint.

    Attributes:
        arrays: name to array.
        state: plain values: the number of the epoch, what the stopping rule remembers, ...
    """

    arrays: Mapping[str, Array]
    state: Mapping[str, Any]


def checkpoint_path(output: Path) -> Path:
    """Where the checkpoint of the simulator ``output`` lies."""
    return output.parent / f".{output.name}.checkpoint"


class Checkpoint:
    """The checkpoint of one piece of work. A context manager: what was offered last is on the disk when it ends.

    Args:
        path: of :func:`checkpoint_path`.
        work: what the work is, as plain values: data, seed, settings, software. Another work's checkpoint is refused.
        every_s: how often to write at most; writing takes longer than an epoch may.
        clock: seconds.
    """

    def __init__(
        self,
        path: Path,
        work: Mapping[str, Any],
        *,
        every_s: float = EVERY_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.path = path
        self._work: dict[str, Any] = json.loads(json.dumps(work))
        self._every_s = every_s
        self._clock = clock
        self._written_s = clock()
        self._pending: Saved | None = None

    def __enter__(self) -> Checkpoint:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.flush()

    def offer(self, arrays: Mapping[str, Array], state: Mapping[str, Any]) -> None:
        """Tell what there is after an epoch. It is copied, and written if the last time was ``every_s`` ago.

        Raises:
            DiskFull: no room; the checkpoint before it stands.
        """
        self._pending = Saved({name: array.copy() for name, array in arrays.items()}, dict(state))
        if self._clock() - self._written_s >= self._every_s:
            self.flush()

    def flush(self) -> None:
        """Write what was offered last, unless it is written already."""
        if self._pending is None:
            return
        about = json.dumps({"work": self._work, "state": self._pending.state}).encode()
        body = about + b"\n" + safetensors.numpy.save(dict(self._pending.arrays))
        files.write_bytes(self.path, f"{FORMAT} {files.sha256_of_bytes(body)}\n".encode() + body)
        self._pending = None
        self._written_s = self._clock()

    def begin(self, *, resume: bool) -> Saved | None:
        """What to go on from, or None: then what was kept before is dropped.

        Raises:
            BadInput: see :meth:`load`; or it cannot be dropped.
        """
        if resume:
            return self.load()
        try:
            self.path.unlink(missing_ok=True)
        except OSError as problem:
            raise BadInput(f"{self.path}: cannot be removed ({problem.strerror}); {_IN_THE_WAY}") from problem
        return None

    def load(self) -> Saved | None:
        """What was kept, or None where there is no checkpoint.

        Raises:
            BadInput: it cannot be read, or is of other work; one line that says what differs.
        """
        if not self.path.exists():
            return None
        if not self.path.is_file():
            raise BadInput(f"{self.path}: not a regular file; {_IN_THE_WAY}")
        try:
            data = self.path.read_bytes()
        except OSError as problem:
            raise BadInput(f"{self.path}: cannot be read ({problem.strerror}); {_REMEDY}") from problem
        work, saved = self._opened(data)
        check_same_work(self.path, work, self._work, _REMEDY)
        return saved

    def _opened(self, data: bytes) -> tuple[Mapping[str, Any], Saved]:
        """What the work was, and what was kept. The recipes trust it: nothing that has changed comes past here."""
        seal, _, body = data.partition(b"\n")
        if not seal.startswith(f"{FORMAT} ".encode()):
            raise BadInput(f"{self.path}: is damaged, or no checkpoint of this version of flora; {_REMEDY}")
        if seal != f"{FORMAT} {files.sha256_of_bytes(body)}".encode():
            raise BadInput(f"{self.path}: is damaged; {_REMEDY}")
        about, _, arrays = body.partition(b"\n")
        kept = json.loads(about)
        # copies: a training goes on in them, and those of safetensors cannot be written
        found = {name: np.array(array) for name, array in safetensors.numpy.load(arrays).items()}
        return kept["work"], Saved(found, kept["state"])


_REMEDY: Final = "give --force in place of --resume to begin anew, or another -o"
_IN_THE_WAY: Final = "remove it, or give another -o"
