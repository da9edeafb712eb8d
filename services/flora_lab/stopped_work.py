"""Long work that is stopped, and what is left of it to go on with."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from flora_common.errors import BadInput

TERMINATED_STATUS: Final = 128 + int(signal.SIGTERM)
CHILD_ENDS_WITHIN_S: Final = 120.0
"""Real seconds in which a command that is told to stop has stopped: a virtual rig ends every service of its own."""


@contextlib.contextmanager
def sigterm_ends() -> Iterator[None]:
    """Within the block SIGTERM ends the command as Ctrl-C does: what was done is kept."""

    def end(_number: int, _frame: object) -> None:
        sys.exit(TERMINATED_STATUS)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def waited_for(process: subprocess.Popen[str]) -> str:
    """What a child process said on stderr, when it has ended; nothing where that went elsewhere.

    Whatever ends the waiting ends the child too, politely at first.
    """
    try:
        _, said = process.communicate()
    except BaseException:
        end_all([process])
        raise
    return said or ""


def end_all(processes: Sequence[subprocess.Popen[str]]) -> None:
    """Tell child processes to stop, all at once, and wait for them; one that does not stop in time is killed."""
    for process in processes:
        process.terminate()
    for process in processes:
        try:
            process.communicate(timeout=CHILD_ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


def check_same_work(path: Path, then: Mapping[str, Any], now: Mapping[str, Any], remedy: str) -> None:
    """Whether what is kept in ``path`` is of the work that is asked for.

    Args:
        path: a file or folder.
        then, now: what the work was and is, as plain values.
        remedy: what to do about a difference.

    Raises:
        BadInput: one line that says what differs.
    """
    for name in sorted({*then, *now}):
        was, is_now = then.get(name), now.get(name)
        if was != is_now:
            raise BadInput(f"{path}: is of other work, {name} was {_short(was)} and is {_short(is_now)} now; {remedy}")


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 40 else f"{text[:12]}…"
