"""Time, handed in: no core reads a clock.

Two readings everywhere: ``mono_ns`` for intervals and ages (never set back), ``utc_ns`` for people. On a rig they are
the machine's. In the virtual rig they are the grow box's: the beat moves the box's time on, and every other service
takes the time from the messages that it hears, so that no message is ever older than its cause.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

NS = 1_000_000_000


class Clock(Protocol):
    """What services know of time. Nanoseconds as int: floats lose them after 104 days."""

    def mono_ns(self) -> int:
        """Rig time that only goes forward; also through suspend."""
        ...

    def utc_ns(self) -> int:
        """Wall clock, UTC, since 1970; it can jump."""
        ...

    def observe(self, mono_ns: int, utc_ns: int) -> None:
        """Take notice of the time on a message that was heard."""
        ...

    def real_s_until(self, mono_ns: int) -> float:
        """Seconds of real waiting until rig time ``mono_ns``; 0 where it has passed, or can be moved to at once."""
        ...

    def move_to(self, mono_ns: int) -> None:
        """Called by the beat when ``real_s_until`` has gone by: a lock-step world moves on here."""
        ...


class SystemClock:
    """The machine's clocks. ``mono_ns`` counts through suspend (CLOCK_BOOTTIME), as plants do."""

    def mono_ns(self) -> int:
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME)

    def utc_ns(self) -> int:
        return time.time_ns()

    def observe(self, mono_ns: int, utc_ns: int) -> None:
        """Messages do not move the machine's clock."""

    def real_s_until(self, mono_ns: int) -> float:
        return max(0.0, (mono_ns - self.mono_ns()) / NS)

    def move_to(self, mono_ns: int) -> None:
        """The machine's time moves by itself."""


class FollowerClock:
    """Rig time as heard on the bus, running on at ``rate`` between messages.

    ``rate`` 0 is lock-step: time stands still until the next message. Real waiting is measured by ``real_ns``.
    """

    def __init__(
        self,
        rate: float,
        *,
        mono_ns: int = 0,
        utc_ns: int = 0,
        real_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._rate = rate
        self._real_ns = real_ns
        self._mono_ns = mono_ns
        self._utc_ns = utc_ns
        self._seen_at = real_ns()

    def _elapsed_ns(self) -> int:
        return round((self._real_ns() - self._seen_at) * self._rate)

    def mono_ns(self) -> int:
        return self._mono_ns + self._elapsed_ns()

    def utc_ns(self) -> int:
        return self._utc_ns + self._elapsed_ns()

    def observe(self, mono_ns: int, utc_ns: int) -> None:
        if mono_ns >= self.mono_ns():
            self._mono_ns, self._utc_ns, self._seen_at = mono_ns, utc_ns, self._real_ns()

    def real_s_until(self, mono_ns: int) -> float:
        if self._rate == 0.0:
            return 0.0
        return max(0.0, (mono_ns - self.mono_ns()) / NS / self._rate)

    def move_to(self, mono_ns: int) -> None:
        """A follower leads nobody."""


class LeaderClock(FollowerClock):
    """The virtual rig's clock as the beat holds it: in lock-step it asks the world to move on.

    Args:
        wait: asks the world to let time pass until the given seconds; returns (mono_ns, utc_ns) when it has.
    """

    def __init__(self, rate: float, wait: Callable[[float], tuple[int, int]], *, mono_ns: int, utc_ns: int) -> None:
        super().__init__(rate, mono_ns=mono_ns, utc_ns=utc_ns)
        self._wait = wait

    def observe(self, mono_ns: int, utc_ns: int) -> None:
        """The beat takes the time from the box alone: a message stamped by a stranger must not move the world on."""

    def move_to(self, mono_ns: int) -> None:
        super().observe(*self._wait(mono_ns / NS))


def unix_seconds(utc_ns: int) -> bytes:
    """The third frame of every message: seconds since 1970 as decimal text, microseconds kept."""
    return b"%d.%06d" % (utc_ns // NS, utc_ns % NS // 1000)
