"""Long work that is stopped, and what is left of it to go on with."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from flora_common.errors import BadInput

TERMINATED_STATUS: Final = 128 + int(signal.SIGTERM)
WITHIN: Final = "FLORA_WITHIN"
"""In the environment of a command that another one started as a step of its work: what a person has typed."""
_MOST_TOLD: Final = 3
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


def going_on() -> str:
    """How a person goes on with what was stopped."""
    within = os.environ.get(WITHIN)
    return f"the same `{within}` goes on" if within else "the same command with --resume goes on"


@contextlib.contextmanager
def kept_told(*, is_silent: bool) -> Iterator[None]:
    """Say on Ctrl-C or SIGTERM how a command goes on that finds out by itself what is finished.

    A step of another command says nothing: that one does.
    """
    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        if not is_silent and WITHIN not in os.environ:
            print("what is finished is kept; the same command goes on", file=sys.stderr)
        raise


def unfinished(path: Path, what: str, drop: str = "--force") -> BadInput:
    """The refusal to drop stopped work unasked: hours may have gone into it.

    Args:
        path: where it is kept.
        what: names it.
        drop: the option that drops it.
    """
    return BadInput(
        f"{path}: holds an unfinished {what}; --resume goes on with it, {drop} drops it, another -o leaves it there"
    )


def nothing_kept(path: Path) -> str:
    """What ``--resume`` is answered where nothing is kept: whoever believed that there was learns it at the beginning.

    Args:
        path: where it would be.
    """
    return f"{path}: nothing is kept there to go on from; starting from the beginning"


def check_same_work(path: Path, then: Mapping[str, Any], now: Mapping[str, Any], remedy: str) -> None:
    """Whether what is kept in ``path`` is of the work that is asked for.

    Args:
        path: a file or folder.
        then, now: what the work was and is, as plain values.
        remedy: what to do about a difference.

    Raises:
        BadInput: one line that says what differs, by the name of each setting, three of them at most; or ``then`` is
            nested as no work is.
    """
    try:
        was, is_now = _flat(then), _flat(now)
    except RecursionError as problem:
        raise BadInput(f"{path}: is damaged; {remedy}") from problem
    other = [name for name in sorted({*was, *is_now}) if was.get(name) != is_now.get(name)]
    if not other:
        return
    told = [_difference(name, str(was.get(name)), str(is_now.get(name))) for name in other[:_MOST_TOLD]]
    more = f" and {len(other) - _MOST_TOLD} more" if len(other) > _MOST_TOLD else ""
    raise BadInput(f"{path}: is of other work, {', '.join(told)}{more}; {remedy}")


def _flat(value: object, name: str = "") -> dict[str, object]:
    """Values by the names of all tables and lists that they are in: a whole table does not say what differs in it."""
    if isinstance(value, Mapping):
        parts = [(f"{name}.{key}" if name else str(key), inner) for key, inner in value.items()]
    elif isinstance(value, list | tuple):
        parts = [(f"{name}[{place}]", inner) for place, inner in enumerate(value)]
    else:
        parts = []
    if not parts:
        return {name: value}
    return {path: end for inner_name, inner in parts for path, end in _flat(inner, inner_name).items()}


def _difference(name: str, was: str, is_now: str) -> str:
    """Long values by a piece of them in which they differ."""
    same = next((at for at, (a, b) in enumerate(zip(was, is_now, strict=False)) if a != b), min(len(was), len(is_now)))
    return f"{name} was {_short(was, same)} and is {_short(is_now, same)} now"


def _short(text: str, same: int) -> str:
    if len(text) <= 40:
        return text
    begin = 0 if same < 12 else same - 4
    return f"{'…' if begin else ''}{text[begin : begin + 12]}…"
