"""The monitor's ear: everything, or one rig, from the bus, with word when there is no bus."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import zmq

from flora_common.bus import Arrival, BusClient
from flora_common.clock import SystemClock
from flora_common.config import RigSection
from flora_monitor.stats import matches, topic_text

NO_BUS_AFTER_S: Final = 2.0
PROGRAM: Final = "flora-monitor"


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
        is_patient: the command waits for a bus that is not there.
    """

    def __init__(
        self, rig: RigSection, *, only_rig: str | None = None, pattern: str = "*", is_patient: bool = True
    ) -> None:
        self.client = BusClient(rig.bus, rig=only_rig or rig.name, source=PROGRAM, clock=SystemClock())
        self.client.subscribe_prefixes(f"{only_rig}/".encode() if only_rig else b"")
        self._address = rig.bus_subscribe
        self._pattern = pattern
        self._poller = zmq.Poller()
        self._poller.register(self.client.subscriber, zmq.POLLIN)
        self._poller.register(self.client.publisher, zmq.POLLIN)
        self._began_s = time.monotonic()
        self._has_warned = False
        self._is_patient = is_patient
        self.client.connect()

    @property
    def connected(self) -> bool:
        """The bus has answered, and all that it kept has been read."""
        return self.client.connected

    @property
    def waited_s(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self._began_s

    def batches(self, *, every_s: float = 0.25) -> Iterator[Batch]:
        """What comes, at least one batch (maybe empty) each ``every_s``; goes on until its caller stops."""
        while True:
            self._poller.poll(round(every_s * 1000))
            was_connected = self.connected
            self.client.handle_publisher()
            arrivals = [a for a in self.client.receive_all() if matches(self._pattern, topic_text(a))]
            if not self.connected and not self._has_warned and self.waited_s >= NO_BUS_AFTER_S:
                self._has_warned = True
                self.warn(
                    f"no bus answers at {self._address}; "
                    + ("waiting for it" if self._is_patient else "is flora-bus running?")
                )
            yield Batch(arrivals, was_connected, time.monotonic())

    def warn(self, text: str) -> None:
        """One line on stderr."""
        print(f"{PROGRAM}: {text}", file=sys.stderr, flush=True)

    def close(self) -> None:
        self.client.close()
