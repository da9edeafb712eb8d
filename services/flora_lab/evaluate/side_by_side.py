"""Several commands at a time, all of which end before this process does."""

from __future__ import annotations

import subprocess
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, TypeVar

from flora_lab.stopped_work import end_all

T = TypeVar("T")
_LOOK_EVERY_S: Final = 0.1


def side_by_side(
    work: Sequence[T],
    at_once: int,
    *,
    start: Callable[[T], subprocess.Popen[str]],
    ended: Callable[[T, subprocess.Popen[str], str], None],
) -> None:
    """Start a command for each piece of work, in order, so many at a time.

    Whatever ends the waiting ends the commands too, politely at first.

    Args:
        work: the pieces.
        at_once: commands that run at a time, 1 or more.
        start: starts one.
        ended: is told when one has ended, and what it said on stderr; nothing where that went elsewhere.
    """
    waiting, running = deque(work), deque[tuple[T, subprocess.Popen[str]]]()
    try:
        while waiting or running:
            while waiting and len(running) < at_once:
                running.append((waiting[0], start(waiting.popleft())))
            piece, process = running[0]
            try:
                _, said = process.communicate(timeout=_LOOK_EVERY_S)
            except subprocess.TimeoutExpired:
                running.rotate(-1)
                continue
            running.popleft()
            ended(piece, process, said or "")
    except BaseException:
        end_all([process for _, process in running])
        raise
