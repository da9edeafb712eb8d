"""Run folders in which a run has ended."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from flora_common import files
from flora_common.errors import BadInput
from flora_common.runs import RunFolder
from flora_lab.serve.ledger import Entry

_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
"""Of runs: other folders are none that a rig made."""


@dataclass(frozen=True, slots=True)
class Lasting:
    """The run that a rig is at.

    Attributes:
        run: its name; empty for none.
        quiet_s: real seconds since anything was heard of it.
        is_over: whether the bus said so.
    """

    run: str
    quiet_s: float
    is_over: bool


@dataclass(frozen=True, slots=True)
class Patience:
    """Real seconds without anything new after which a run has ended."""

    settled_s: float
    settled_when_told_s: float

    def lasts(self, lasting: Lasting) -> bool:
        """Whether a run still goes on, by what was heard of it."""
        return lasting.quiet_s < (self.settled_when_told_s if lasting.is_over else self.settled_s)


def finished(
    rig: str,
    folder: Path,
    lasting: Lasting,
    patience: Patience,
    now_s: float,
    is_known: Callable[[str, str, int, int], bool],
    *,
    is_settled: bool = False,
    on_unreadable: Callable[[str], None] = lambda _: None,
) -> Iterator[Entry]:
    """Runs that have ended and are not known yet, by name.

    Args:
        rig: whose they are.
        folder: that holds the run folders.
        lasting: the run that the rig is at.
        patience: how long is waited.
        now_s: Unix time.
        is_known: see :meth:`flora_lab.serve.ledger.Ledger.knows`.
        is_settled: whether tracks in this folder are written when their run has ended, so that nothing is waited for.
        on_unreadable: told of a run that cannot be read, and why; the others are found.

    Raises:
        OSError: the folder itself cannot be read.
    """
    if not folder.is_dir():
        return
    for path in sorted(folder.iterdir()):
        if not _NAME.fullmatch(path.name):
            continue
        is_own = path.name == lasting.run
        if is_own and patience.lasts(lasting):
            continue
        wait_s = patience.settled_when_told_s if is_own and lasting.is_over else patience.settled_s
        track = RunFolder(path).track_csv
        try:
            status = track.stat()
            is_waited_for = not is_settled and now_s - status.st_mtime < wait_s
            if is_waited_for or is_known(rig, path.name, status.st_size, status.st_mtime_ns):
                continue
            sha256 = files.sha256_of_file(track)
            yield Entry(rig, path.name, _plant(path), str(path), sha256, status.st_size, status.st_mtime_ns)
        except (FileNotFoundError, NotADirectoryError):
            continue  # no run, or one whose stems nobody found
        except OSError as problem:
            on_unreadable(f"{path}: cannot be read ({problem.strerror})")


def _plant(path: Path) -> str:
    folder = RunFolder(path)
    try:
        return folder.read_run_file().plant.strip() or path.name
    except BadInput:
        return path.name  # what is wrong with the run file the diagnosis says
