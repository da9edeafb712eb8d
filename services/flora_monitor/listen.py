"""The monitor's ear: everything, or one rig, from the bus, with word when there is nothing to hear."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import zmq

from flora_common.bus import Arrival, BusClient
from flora_common.clock import NS, SystemClock
from flora_common.config import RigSection
from flora_common.errors import BusUnreachable
from flora_common.health import HealthBoard
from flora_common.messages import Health
from flora_monitor.stats import matches, rig_of, topic_text

SILENT_AFTER_S: Final = 3.0
MOST_RIGS: Final = 10
PROGRAM: Final = "flora-monitor"
IS_IT_RUNNING: Final = "is flora-bus running?"


@dataclass(frozen=True, slots=True)
class Batch:
    """What came at once; empty when it was only time to look again.

    Attributes:
        arrivals: those that fit pattern and rig.
        is_live: all that the bus had kept came before.
        real_s: monotonic seconds.
    """

    arrivals: list[Arrival]
    is_live: bool
    real_s: float


class Listener:
    """A subscriber to everything.

    Args:
        rig: where the bus is.
        only_rig: hear this rig alone; None for all.
        pattern: glob on ``<rig>/<kind>`` or kind.
        without_bus: what to advise where no bus answers; None for who has a line of its own for it.
    """

    def __init__(
        self,
        rig: RigSection,
        *,
        only_rig: str | None = None,
        pattern: str = "*",
        without_bus: str | None = "waiting for it",
    ) -> None:
        self.client = BusClient(rig.bus, rig=only_rig or rig.name, source=PROGRAM, clock=SystemClock())
        self.client.subscribe_prefixes(f"{only_rig}/".encode() if only_rig else b"")
        self._rig = rig
        self._only_rig = only_rig
        self._pattern = pattern
        self._poller = zmq.Poller()
        self._poller.register(self.client.subscriber, zmq.POLLIN)
        self._poller.register(self.client.publisher, zmq.POLLIN)
        self._looked_s, self._waited_s = time.monotonic(), 0.0
        self._connected_s: float | None = None
        self._has_heard = False
        self._has_warned = False
        self._is_told = False
        self._without_bus = without_bus
        self.client.connect()

    @property
    def connected(self) -> bool:
        """The bus has answered, and all that it kept has been read."""
        return self.client.connected

    @property
    def has_answered(self) -> bool:
        """The bus has answered once, be it gone by now: what it keeps may be heard before it says that it is there."""
        return self._has_heard or self._connected_s is not None

    @property
    def endpoint(self) -> str:
        """Where the bus is to answer."""
        return self._rig.bus_subscribe

    @property
    def misses_bus(self) -> bool:
        """It has waited for the bus's answer in vain; whoever waits on may be lucky."""
        return not self.connected and self.waited_s >= self.client.patience_s

    @property
    def waited_s(self) -> float:
        """Seconds since the start in which it listened: those in which it stood still itself are no silence."""
        return self._waited_s

    def batches(self, *, every_s: float = 0.25) -> Iterator[Batch]:
        """What comes, at least one batch (maybe empty) each ``every_s``; goes on until its caller stops."""
        while True:
            self._poller.poll(round(every_s * 1000))
            now_s = time.monotonic()
            self._waited_s += min(now_s - self._looked_s, 2.0 * every_s)
            self._looked_s = now_s
            was_connected = self.connected
            self.client.handle_publisher()
            heard = self.client.receive_all()
            self._has_heard = self._has_heard or bool(heard)
            arrivals = [a for a in heard if matches(self._pattern, topic_text(a))]
            if self.misses_bus and self._without_bus is not None and not self._has_warned:
                self._has_warned = True
                self.warn(self.client.hindrance or f"no bus answers at {self.endpoint}; {self._without_bus}")
            if self.connected and self._connected_s is None:
                self._connected_s = time.monotonic()
            if self._connected_s is not None and time.monotonic() - self._connected_s >= SILENT_AFTER_S:
                self.explain_silence()
            yield Batch(arrivals, was_connected, time.monotonic())

    def explain_silence(self) -> None:
        """Where nothing was heard so far and the bus answers: say once on stderr which rigs it has."""
        if self._is_told or self._has_heard or not self.connected:
            return
        self._is_told = True
        rigs = rigs_on(self._rig)
        if not rigs:
            self.warn(f"nothing is heard, of any rig; the bus at {self._rig.bus_subscribe} answers")
            return
        if self._only_rig is None or self._only_rig in rigs:
            return  # it has just begun to talk
        more = f" and {len(rigs) - MOST_RIGS} more" if len(rigs) > MOST_RIGS else ""
        self.warn(f"nothing is heard of rig `{self._only_rig}`; on this bus are: {', '.join(rigs[:MOST_RIGS])}{more}")

    def warn(self, text: str) -> None:
        """One line on stderr."""
        print(f"{PROGRAM}: {text}", file=sys.stderr, flush=True)

    def close(self) -> None:
        self.client.close()


def hear_health(listener: Listener, board: HealthBoard, *, pattern: str, limit_s: float, ends_early: bool) -> bool:
    """Fill a board from the bus; returns whether the bus answered.

    Args:
        listener: of ``health``.
        board: what is heard goes there.
        pattern: glob on the services' names.
        limit_s: so long after the bus has answered.
        ends_early: end as soon as nothing that may still come can change a verdict.
    """
    answered_s: float | None = None
    for batch in listener.batches(every_s=0.05):
        for arrival in batch.arrivals:
            if isinstance(arrival.message, Health) and matches(pattern, arrival.message.source):
                board.hear(arrival.message, real_s=batch.real_s, is_live=batch.is_live)
        if not listener.connected:
            if listener.misses_bus:
                return False
            continue
        answered_s = batch.real_s if answered_s is None else answered_s
        if batch.real_s - answered_s >= limit_s or (ends_early and batch.is_live and board.is_decided):
            break
    return True


@dataclass(frozen=True, slots=True)
class Alive:
    """A service that was heard to live."""

    rig: str
    source: str


def hear_life(listener: Listener, rigs: set[str], *, within_s: float, ages_are_known: bool) -> Alive | None:
    """A service of one of these rigs that lives, the bus aside; None where none does.

    What the bus had kept proves nothing: a recording that was played leaves it too. Where there is such a value, a sign
    of life is waited for.

    Args:
        listener: of ``health``.
        rigs: their names.
        within_s: how long, after the bus has answered; a living service says something within that time.
        ages_are_known: rig time is this machine's own clock: what is older is no sign of life, and not waited for.

    Raises:
        BusUnreachable: no bus answers, which may do so, and take what is said to it, a moment later.
    """
    is_doubtful, answered_s = False, None
    for batch in listener.batches(every_s=0.05):
        for arrival in batch.arrivals:
            said = arrival.message
            if arrival.rig in rigs and isinstance(said, Health) and said.source != "flora-bus":
                if batch.is_live:
                    return Alive(arrival.rig, said.source)
                age_s = (SystemClock().mono_ns() - said.t_mono_ns) / NS
                is_doubtful = is_doubtful or not ages_are_known or 0.0 <= age_s <= within_s
        if not listener.connected:
            if listener.misses_bus:
                raise BusUnreachable(listener.client.hindrance or f"no bus answers at {listener.endpoint}")
            continue
        if answered_s is None:
            answered_s = batch.real_s
            if is_doubtful:
                listener.warn(f"the bus has kept health of that rig; waiting {within_s:g} s for a sign of life")
        if not is_doubtful or batch.real_s - answered_s >= within_s:
            return None
    return None


def rigs_on(rig: RigSection) -> list[str]:
    """Names of the rigs whose messages a bus keeps, or passes on meanwhile; none where it does not answer in time."""
    listener = Listener(rig, without_bus=None)
    found: set[str] = set()
    try:
        for batch in listener.batches(every_s=0.05):
            found |= {rig_of(arrival) for arrival in batch.arrivals}
            if listener.connected or listener.misses_bus:
                break
    finally:
        listener.close()
    return sorted(found - {""})
