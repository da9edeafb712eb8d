"""What is of record, how often it is sent, how long to wait after a failure, how full a disk may be."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Final, Literal

Kind = Literal["once", "table"]

SKIPPED_SUFFIXES: Final = (".part", ".open", ".lock")
"""Ends of names that are still being written, or never meant to be kept."""

ONCE_FOLDERS: Final = ("frames", "background", "bus")
ONCE_SUFFIXES: Final = (".jpg", ".jpeg", ".png", ".mcap")
"""Written whole under a temporary name and never changed after that; everything else may grow."""

ALERT_STEPS: Final = (95, 80, 50)
"""Per cent of the spool's disk in use at which something is said; from 80 on the service is degraded."""

FIRST_WAIT_S: Final = 1.0
LONGEST_WAIT_S: Final = 600.0
SHORTEST_WAIT_S: Final = 0.05
TELL_EVERY_S: Final = 600.0
MOST_WAITS: Final = 10_000
"""Files whose own waiting times are remembered; beyond that the oldest are simply tried again."""


def is_of_record(name: str) -> bool:
    """Whether a file or folder of this name inside a run folder has to reach the target."""
    return not name.startswith(".") and not name.endswith(SKIPPED_SUFFIXES)


def kind_of(path: str) -> Kind:
    """``once`` for what never changes, ``table`` for what may grow; ``path`` is relative to the run folder."""
    pure = PurePosixPath(path)
    if pure.suffix.lower() in ONCE_SUFFIXES:
        return "once"
    return "once" if len(pure.parts) > 1 and pure.parts[0] in ONCE_FOLDERS else "table"


def is_photograph(path: str) -> bool:
    """Whether this is a picture of the plant: the only files whose hash is announced, and that may make room."""
    pure = PurePosixPath(path)
    return pure.parts[0] == "frames" and len(pure.parts) > 1 and pure.suffix.lower() == ".jpg"


class Backoff:
    """Waiting times that double from 1 s to 10 min, with full jitter, until something works again.

    Args:
        uniform: ``random.uniform`` or a test's stand-in.
    """

    def __init__(self, uniform: Callable[[float, float], float] = random.uniform) -> None:
        self._uniform = uniform
        self._failures = 0

    @property
    def longest_s(self) -> float:
        """Upper end of the next wait."""
        return min(LONGEST_WAIT_S, FIRST_WAIT_S * 2.0 ** min(self._failures, 20))

    def failed(self) -> float:
        """Seconds to wait before the next attempt."""
        wait_s = max(SHORTEST_WAIT_S, self._uniform(0.0, self.longest_s))
        self._failures += 1
        return wait_s

    def worked(self) -> None:
        self._failures = 0


class Pause:
    """The rest of everything after a problem of the whole target, and when to tell of it again.

    Args:
        uniform: as for :class:`Backoff`.

    Attributes:
        until_s: nothing is tried before this time.
    """

    def __init__(self, uniform: Callable[[float, float], float] = random.uniform) -> None:
        self._backoff = Backoff(uniform)
        self._told_at_s: float | None = None
        self.until_s = 0.0

    def begin(self, now_s: float, *, is_news: bool) -> bool:
        """After a failure. Returns whether to tell of it: when it is news, and every ten minutes."""
        self.until_s = now_s + self._backoff.failed()
        if not is_news and self._told_at_s is not None and now_s < self._told_at_s + TELL_EVERY_S:
            return False
        self._told_at_s = now_s
        return True

    def over(self) -> None:
        """Something worked."""
        self._backoff.worked()
        self._told_at_s = None


class Waits:
    """Waiting times of single files after failures of their own, each with its own back-off.

    Args:
        uniform: as for :class:`Backoff`.
    """

    def __init__(self, uniform: Callable[[float, float], float] = random.uniform) -> None:
        self._uniform = uniform
        self._waits: dict[tuple[str, str], tuple[Backoff, float]] = {}

    def begin(self, key: tuple[str, str], now_s: float) -> None:
        """This file failed: leave it alone for a while."""
        backoff, _ = self._waits.get(key, (Backoff(self._uniform), 0.0))
        self._waits[key] = (backoff, now_s + backoff.failed())
        while len(self._waits) > MOST_WAITS:
            self._waits.pop(next(iter(self._waits)))

    def is_over(self, key: tuple[str, str], now_s: float) -> bool:
        """Whether the file may be tried."""
        return key not in self._waits or now_s >= self._waits[key][1]

    def forget(self, key: tuple[str, str]) -> None:
        self._waits.pop(key, None)

    def ends_after(self, now_s: float) -> list[float]:
        """Times at which waits end that are not over yet."""
        return [until_s for _, until_s in self._waits.values() if until_s > now_s]


@dataclass(frozen=True, slots=True)
class DiskAlert:
    """A step of :data:`ALERT_STEPS` that has been passed."""

    percent: int

    @property
    def is_serious(self) -> bool:
        return self.percent >= 80


def disk_alert(percent_used: float, before: DiskAlert | None) -> DiskAlert | None:
    """The step that holds now. A step once passed holds until one per cent below it, so that it does not flicker."""
    for step in ALERT_STEPS:
        slack = 1.0 if before is not None and before.percent >= step else 0.0
        if percent_used >= step - slack:
            return DiskAlert(step)
    return None
