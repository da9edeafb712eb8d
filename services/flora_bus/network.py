"""Where other machines find the bus: opened as soon as it can be, and shut for a while when too many have come in.

The rig's own services must not suffer by either. An address that the machine does not have yet is tried again. libzmq
4.3.5 ends the whole process when a service of the rig comes by ``ipc://`` and there is no file descriptor left for it
(``ipc_listener.cpp``, line 297), and it sets no bound to those who come over TCP; so this does, long before that.
"""

from __future__ import annotations

import contextlib
import math
import os
import resource
from pathlib import Path
from typing import Final

import zmq

from flora_bus.broker import Broker
from flora_bus.guard import Guard
from flora_common.bus import BusAddress

LOOK_EVERY_S: Final = 1.0
AGAIN_AFTER_S: Final = 5.0
"""Real seconds for which the network is left alone after it could not be opened, or had to be shut."""

MOST_OPEN: Final = 1024
"""Descriptors in use, sockets of the rig's own services included; half of those allowed where that is less."""
WANTED_LIMIT: Final = 65_536
"""Descriptors: more than can be taken between two looks."""

DESCRIPTORS: Final = Path("/proc/self/fd")


def allow_descriptors() -> None:
    """Use what the system allows this process; systemd's unit says how much that is, and lets nobody change it."""
    with contextlib.suppress(OSError, ValueError):
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        wanted = WANTED_LIMIT if hard == resource.RLIM_INFINITY else min(hard, WANTED_LIMIT)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, wanted), hard))


def most_open() -> int:
    """Descriptors in use above which there are too many."""
    try:
        return min(MOST_OPEN, resource.getrlimit(resource.RLIMIT_NOFILE)[0] // 2)
    except OSError:  # the unit's filter of system calls does not let it ask; the unit allows enough
        return MOST_OPEN


def _count() -> float:
    try:
        return len(os.listdir(DESCRIPTORS))  # noqa: PTH208 - a number is wanted, not paths
    except OSError:  # not even one is left to look with
        return math.inf


class Network:
    """The bus's endpoints for other machines.

    Args:
        broker: whose sockets are to be bound.
        address: where.
        guard: asks for keys; None lets everyone in.

    Attributes:
        is_open: whether others can come in.
        problem: why they cannot, in one sentence; empty where they can.
    """

    def __init__(self, broker: Broker, address: BusAddress, guard: Guard | None) -> None:
        self._broker = broker
        self._address = address
        self._guard = guard
        self._again_s = 0.0
        self.is_open = False
        self.problem = ""

    def look(self, now_s: float) -> None:
        """Open it where it is not; shut it where too many have come in, which hangs up on all of them.

        Args:
            now_s: real, monotonic seconds.
        """
        if self.is_open:
            if _count() > most_open():
                self._broker.shut_network()
                self._rest(now_s, "too many connections were open, and all that came from outside were hung up on")
        elif now_s >= self._again_s:
            try:
                self._broker.open_network(self._address, self._guard)
            except zmq.ZMQError as problem:
                self._rest(now_s, f"cannot listen at {problem.strerror}")
            else:
                self.is_open, self.problem = True, ""

    def _rest(self, now_s: float, why: str) -> None:
        self.is_open, self._again_s = False, now_s + AGAIN_AFTER_S
        self.problem = f"other machines are not let in: {why}; tried again every {AGAIN_AFTER_S:g} s"
