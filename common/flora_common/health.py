"""Which services are well: judged from their health messages, with time handed in."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from flora_common.bus import COMES_AND_GOES, LATE_FACTOR
from flora_common.clock import NS
from flora_common.messages import CATALOGUE, Health

EVERY_SERVICE: Final = "every service"
ONLY_LOOKS: Final = "flora-dashboard"
"""A rig is well without it; where it runs it is judged like the others."""


def services_of_catalogue() -> tuple[str, ...]:
    """The bus, and every service that owns a topic."""
    owners = [spec.owner for spec in CATALOGUE.values() if spec.owner not in (EVERY_SERVICE, COMES_AND_GOES)]
    return ("flora-bus", *dict.fromkeys(owners))


@dataclass(frozen=True, slots=True)
class Line:
    """One service.

    Attributes:
        state: what it says, or ``silent`` or ``never heard``.
        reason: why, in a sentence.
        age_s: seconds since its last health; None where that is not known.
        ok: it is ready, and was heard of late.
    """

    service: str
    state: str
    reason: str
    age_s: float | None
    uptime_s: float
    resident_kib: int
    gaps: int
    bad: int
    ok: bool


@dataclass(slots=True)
class _Heard:
    health: Health
    real_s: float
    is_live: bool


class HealthBoard:
    """The last health of each service.

    Args:
        expected: services that must be there.
        period_s: real seconds between health messages.
        ages_are_known: rig time is this machine's own clock, so that a kept value tells how old it is. Otherwise only
            a message that came after the bus's kept ones proves that its service lives.
    """

    def __init__(self, expected: Iterable[str], *, period_s: float, ages_are_known: bool) -> None:
        self._expected = tuple(expected)
        self._period_s = period_s
        self._ages_are_known = ages_are_known
        self._heard: dict[str, _Heard] = {}

    def hear(self, health: Health, *, real_s: float, is_live: bool) -> None:
        before = self._heard.get(health.source)
        self._heard[health.source] = _Heard(health, real_s, is_live or (before is not None and before.is_live))

    @property
    def is_decided(self) -> bool:
        """Nothing that may still come can change the verdict on any service."""
        if self._ages_are_known:
            return True
        heard = self._heard
        return all(name in heard for name in self._expected) and all(one.is_live for one in heard.values())

    def lines(self, *, real_s: float, mono_ns: int) -> list[Line]:
        """Expected services in their order, then others by name."""
        others = sorted(set(self._heard) - set(self._expected))
        return [self._line(name, real_s, mono_ns) for name in (*self._expected, *others)]

    def _line(self, service: str, real_s: float, mono_ns: int) -> Line:
        heard = self._heard.get(service)
        if heard is None:
            return Line(service, "never heard", "", None, 0.0, 0, 0, 0, ok=False)
        health = heard.health
        age_s: float | None = None
        if heard.is_live:
            age_s = real_s - heard.real_s
        # It counts its time by another machine's clock, and need not be there.
        is_elsewhere = service == COMES_AND_GOES
        if self._ages_are_known and not is_elsewhere:
            age_s = max(0.0, (mono_ns - health.t_mono_ns) / NS)
        is_silent = not is_elsewhere if age_s is None else age_s > LATE_FACTOR * self._period_s
        state, reason = str(health.state), health.reason
        if is_silent:
            state = "silent"
            since = "since before this command" if age_s is None else f"for {age_s:.0f} s"
            reason = f"{since}, a sign is due every {self._period_s:g} s; it last said: {health.state}"
        return Line(
            service=service,
            state=state,
            reason=reason,
            age_s=age_s,
            uptime_s=health.uptime_s,
            resident_kib=health.resident_kib,
            gaps=health.gaps,
            bad=health.bad,
            ok=state == "ready",
        )
