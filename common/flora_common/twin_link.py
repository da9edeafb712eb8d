"""The wire to the virtual grow box: what the ``virtual`` backends of camera, flash and strips speak.

One request at a time over ZeroMQ REQ/ROUTER, msgpack maps both ways. The box restarts without its clients noticing
more than a late answer: ZeroMQ forgets a request whose connection breaks, so it is asked again. Every operation states
what is to be; only a shutter pressed twice leaves a second line of truth behind, for one photograph.
"""

from __future__ import annotations

import time
from typing import Any

import msgspec
import zmq

from flora_common.clock import NS, Clock, FollowerClock, LeaderClock
from flora_common.errors import DeviceError

START_TIMEOUT_S = 10.0


class TwinGone(DeviceError):
    """The virtual grow box does not answer, or refused."""


class TwinLink:
    """A client of ``flora-twin serve``.

    Args:
        address: its endpoint.
        timeout_s: real seconds to wait for an answer before :class:`TwinGone`.
    """

    def __init__(self, address: str, *, timeout_s: float = 20.0, context: zmq.Context[Any] | None = None) -> None:
        self.address = address
        self._timeout_ms = round(timeout_s * 1000)
        self._socket = (context or zmq.Context.instance()).socket(zmq.REQ)
        self._socket.setsockopt(zmq.LINGER, 0)
        # A lost answer must not wedge the strict send/receive order of REQ, nor be taken for the next one's.
        self._socket.setsockopt(zmq.REQ_RELAXED, 1)
        self._socket.setsockopt(zmq.REQ_CORRELATE, 1)
        self._breaks = self._socket.get_monitor_socket(zmq.EVENT_DISCONNECTED)
        self._poller = zmq.Poller()
        self._poller.register(self._socket, zmq.POLLIN)
        self._poller.register(self._breaks, zmq.POLLIN)
        self._socket.connect(address)

    def ask(self, op: str, **arguments: Any) -> dict[str, Any]:
        """Send one operation and wait for its answer.

        Raises:
            TwinGone: no answer in time, or the box said no.
        """
        request = msgspec.msgpack.encode({"op": op, **arguments})
        self._forget_breaks()
        self._socket.send(request)
        end_s = time.monotonic() + self._timeout_ms / 1000
        while (body := self._received()) is None:
            left_ms = round((end_s - time.monotonic()) * 1000)
            if left_ms <= 0:
                waited_s = self._timeout_ms / 1000
                raise TwinGone(f"{self.address}: the virtual grow box did not answer `{op}` in {waited_s:g} s")
            if self._breaks in dict(self._poller.poll(left_ms)):
                self._forget_breaks()
                self._socket.send(request)
        try:
            answer = msgspec.msgpack.decode(body, type=dict[str, Any])
        except (ValueError, RecursionError) as problem:
            raise TwinGone(f"{self.address}: the answer to `{op}` is not a msgpack map ({problem})") from problem
        if answer.get("ok") is not True:
            raise TwinGone(f"{self.address}: `{op}` refused: {str(answer.get('error'))[:200]}")
        return answer

    def now(self) -> tuple[int, int, float]:
        """(mono_ns, utc_ns, rate) of the box."""
        answer = self.ask("now")
        return round(float(answer["time_s"]) * NS), int(answer["t_utc_ns"]), float(answer["rate"])

    def _received(self) -> bytes | None:
        # A late answer to a request of before makes the socket readable too; only reading finds out, and drops it.
        try:
            body: bytes = self._socket.recv(zmq.NOBLOCK)
        except zmq.Again:
            return None
        return body

    def _forget_breaks(self) -> None:
        while self._breaks.poll(0):
            self._breaks.recv_multipart()

    def close(self) -> None:
        self._socket.disable_monitor()
        self._breaks.close()
        self._socket.close()


def follower_clock(address: str) -> Clock:
    """The clock of a service in the virtual rig, started at the box's time."""
    link = TwinLink(address, timeout_s=START_TIMEOUT_S)
    try:
        mono_ns, utc_ns, rate = link.now()
    finally:
        link.close()
    return FollowerClock(rate, mono_ns=mono_ns, utc_ns=utc_ns)


def leader_clock(link: TwinLink) -> Clock:
    """The clock of the beat in the virtual rig, over a link that it keeps."""

    def wait(until_s: float) -> tuple[int, int]:
        answer = link.ask("wait", until_s=until_s)
        return round(float(answer["time_s"]) * NS), int(answer["t_utc_ns"])

    mono_ns, utc_ns, rate = link.now()
    return LeaderClock(rate, wait, mono_ns=mono_ns, utc_ns=utc_ns)
