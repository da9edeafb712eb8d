"""A clock for tests: its time is theirs."""

from __future__ import annotations

from flora_common.clock import NS


class FakeClock:
    """A clock that stands still until a test moves it."""

    def __init__(self, mono_ns: int = 0, utc_ns: int = 1_700_000_000 * NS) -> None:
        self._mono_ns = mono_ns
        self._utc_ns = utc_ns

    def mono_ns(self) -> int:
        return self._mono_ns

    def utc_ns(self) -> int:
        return self._utc_ns

    def observe(self, mono_ns: int, utc_ns: int) -> None:
        """Only the test moves it."""

    def real_s_until(self, mono_ns: int) -> float:
        return max(0.0, (mono_ns - self._mono_ns) / NS)

    def move_to(self, mono_ns: int) -> None:
        self.advance((mono_ns - self._mono_ns) / NS)

    def advance(self, seconds: float) -> None:
        """Both readings move on."""
        self._mono_ns += max(0, round(seconds * NS))
        self._utc_ns += max(0, round(seconds * NS))

    def jump_utc(self, seconds: float) -> None:
        """The wall clock alone is set, as by NTP or a hand."""
        self._utc_ns += round(seconds * NS)
