"""A running service: one loop with handlers for messages, sockets and timers, and the state that it tells.

One thread runs everything. The watchdog is fed by that loop and by nothing else, so a service that hangs in its work
is a service that systemd restarts. Handlers must be short, or give control back (child processes, sockets); bus
messages are handled at least once, so a handler that is told the same tick twice must not do its work twice.
"""

from __future__ import annotations

import contextlib
import functools
import heapq
import importlib.metadata
import itertools
import os
import signal
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

import msgspec
import zmq

from flora_common.bus import Arrival, BusClient, Freshness
from flora_common.bus_connection import RETRY_S
from flora_common.clock import Clock
from flora_common.config import RigSection, config_text
from flora_common.errors import BadInput, FloraError
from flora_common.files import sha256_of_bytes
from flora_common.log import Log
from flora_common.messages.catalogue import Health, State
from flora_common.messages.envelope import Message, as_sentence, spec_of
from flora_common.notify import Notifier
from flora_common.runs import RunFolder

S = TypeVar("S", bound=msgspec.Struct)
M = TypeVar("M", bound=Message)
Handler = Callable[[Any], None]

LONGEST_POLL_S: Final = 5.0


class Timer:
    """A call that is due at a real, monotonic time; cancelled by :meth:`cancel`."""

    def __init__(self, call: Callable[[], None]) -> None:
        self.call: Callable[[], None] | None = call

    def cancel(self) -> None:
        self.call = None


class App(Generic[S]):
    """A running service: bus, timers, state and log.

    Attributes:
        name: the command, such as ``flora-flash``.
        rig: the ``[rig]`` section.
        config: its own section.
        clock: rig time.
        run: the run folder.
        inbox: the last message of each type, and whether it is fresh.
    """

    def __init__(self, name: str, rig: RigSection, config: S, *, log: Log, clock: Clock) -> None:
        self.name = name
        self.rig = rig
        self.config = config
        self.log = log
        self.clock = clock
        self.run = RunFolder(Path(rig.run_dir))
        self.state_dir = Path(rig.state_dir)
        self.notifier = Notifier()
        self.bus = BusClient(rig.bus, rig=rig.name, source=name, clock=clock)
        self.inbox = Freshness(clock, tick_s=self._tick_s())
        self._handlers: dict[type[Message], list[Handler]] = {}
        self._raw_handlers: list[Callable[[Arrival], None]] = []
        self._timers: list[tuple[float, int, Timer]] = []
        self._order = itertools.count()
        self._readable: dict[Any, Callable[[], None]] = {}
        self._poller = zmq.Poller()
        self._exits = contextlib.ExitStack()
        self._ready_calls: list[Callable[[], None]] = []
        self._stopping: str | None = None
        self._status: tuple[State, str] = ("starting", "waiting for the bus")
        self._kind: str | None = None
        self._troubles: dict[str, str] = {}
        self._is_ready = False
        self._config_sha256 = sha256_of_bytes(config_text(rig, "own", config).encode())
        self._started_s = time.monotonic()
        self._slowest_s = 0.0
        self._alive_s = 0.0
        self.attend(self.bus, self._notice_bus)
        self.on_readable(self.bus.subscriber, self._receive)

    def _tick_s(self) -> float:
        try:
            return self.run.read_run_file().interval_s
        except BadInput:
            return 300.0  # no run folder yet: the paper's five minutes

    # what a service hangs its work on

    def on(self, type_: type[M], handler: Callable[[M], None]) -> None:
        """Call ``handler`` with each message of this type from its own rig."""
        if type_ not in self._handlers:
            self.bus.subscribe(type_)
        self._handlers.setdefault(type_, []).append(handler)

    def on_raw(self, handler: Callable[[Arrival], None]) -> None:
        """Call ``handler`` with everything of its own rig as it came, bad, unknown and repeated messages included."""
        self.bus.subscribe_prefixes(f"{self.rig.name}/".encode())
        self._raw_handlers.append(handler)

    def on_readable(self, source: Any, handler: Callable[[], None]) -> None:
        """Call ``handler`` when a ZeroMQ socket or file descriptor can be read."""
        self._readable[source] = handler
        self._poller.register(source, zmq.POLLIN)

    def forget_readable(self, source: Any) -> None:
        """Undo :meth:`on_readable`."""
        if self._readable.pop(source, None) is not None:
            self._poller.unregister(source)

    def attend(self, bus: BusClient, handler: Callable[[], None]) -> None:
        """Call ``handler``, which calls ``bus.handle_publisher``, whenever that is to be called."""
        self.on_readable(bus.publisher, handler)
        for monitor in bus.monitors:
            self.on_readable(monitor, handler)
        if bus.is_far:
            self.every(RETRY_S, handler)

    def after(self, real_s: float, call: Callable[[], None]) -> Timer:
        """Call once after real seconds."""
        timer = Timer(call)
        heapq.heappush(self._timers, (time.monotonic() + real_s, next(self._order), timer))
        return timer

    def every(self, real_s: float, call: Callable[[], None]) -> None:
        """Call every so many real seconds, the first time one period from now."""

        def again() -> None:
            self.after(real_s, again)
            call()

        self.after(real_s, again)

    def on_ready(self, call: Callable[[], None]) -> None:
        """Call once when the bus has answered."""
        self._ready_calls.append(call)

    def on_exit(self, call: Callable[[], None]) -> None:
        """Call when the loop ends for whatever reason, latest first; each is called even if another one fails."""
        self._exits.callback(call)

    def publish(self, message: Message) -> None:
        self.bus.publish(message)

    def state(self, state: State, reason: str = "", *, kind: str | None = None) -> None:
        """Say how the service is; a change is told at once on the bus, in the log and to systemd.

        Args:
            state: the state.
            reason: in a sentence.
            kind: where only the text differs, and not this, the log is told at most every ten minutes.
        """
        self._kind = kind
        if (state, reason) == self._status:
            return
        self._status = (state, reason)
        self._log_state()
        self.notifier.status(f"{state}: {reason}" if reason else state)
        if self._is_ready:
            self._say_health()

    def _log_state(self) -> None:
        state, reason = self._status
        if state in ("degraded", "fault"):
            self.log.problem("degraded", reason, kind=None if self._kind is None else f"{state}: {self._kind}")
        else:
            self.log.solved("degraded")

    def trouble(self, key: str, reason: str) -> None:
        """A problem that lasts, by its name; an empty reason says that it is over. The state tells all that last.

        The names are what kind of trouble it is: a reason that changes with each tick is not a log line with each tick.
        """
        if reason:
            self._troubles[key] = reason
        elif self._troubles.pop(key, None) is None:
            return
        if self._troubles:
            self.state(
                "degraded", as_sentence("; ".join(self._troubles.values())), kind=", ".join(sorted(self._troubles))
            )
        elif self._is_ready:
            self.state("ready")
        else:
            self.state("starting", "waiting for the bus")

    def stop(self, reason: str) -> None:
        """End the loop after the handler that is running."""
        self._stopping = reason

    # the loop

    def loop(self) -> None:
        """Run until stopped. Ends by an exception only where there is a bug."""
        with self._signals():
            try:
                with self._exits:
                    self.bus.connect()
                    self.notifier.status("starting: waiting for the bus")
                    while self._stopping is None:
                        self._step()
                    self.log.event("stopping", reason=self._stopping)
                    self.notifier.stopping("stopping")
            finally:
                self.bus.close()

    def _step(self) -> None:
        wait_s = LONGEST_POLL_S if self.notifier.watchdog_s is None else self.notifier.watchdog_s / 4
        if self._timers:
            wait_s = min(wait_s, max(0.0, self._timers[0][0] - time.monotonic()))
        # Rounded up: a timer must be due when poll returns, or the loop would spin through its last millisecond.
        ready = self._poller.poll(int(wait_s * 1000) + 1 if wait_s > 0 else 0)
        began_s = time.monotonic()
        for source, _ in ready:
            handler = self._readable.get(source)
            if handler is not None:
                self._guarded(handler)
        # One reading for all: a timer that arms itself anew with no delay must not keep the loop from bus and watchdog.
        now_s = time.monotonic()
        while self._timers and self._timers[0][0] <= now_s:
            timer = heapq.heappop(self._timers)[2]
            if timer.call is not None:
                self._guarded(timer.call)
        if not self._is_ready and self.bus.connected:
            self._become_ready()
        self._slowest_s = max(self._slowest_s, time.monotonic() - began_s)
        self._say_alive()

    def _say_alive(self) -> None:
        """Feed the watchdog, some times more often than it asks for."""
        interval_s, now_s = self.notifier.watchdog_s, time.monotonic()
        if interval_s is not None and now_s - self._alive_s >= interval_s / 4:
            self._alive_s = now_s
            self.notifier.alive()

    def _guarded(self, call: Callable[..., None], *arguments: Any) -> None:
        key = getattr(call, "__qualname__", "work")
        try:
            call(*arguments)
        except FloraError as problem:
            # Expected: told, and the service goes on. Anything else is a bug and ends the process with its traceback.
            self.trouble(key, as_sentence(str(problem)))
        else:
            if key in self._troubles:
                self.trouble(key, "")

    def _notice_bus(self) -> None:
        self.bus.handle_publisher()
        self.trouble("bus", self.bus.refusal)

    def _receive(self) -> None:
        # Each handler is guarded by itself: one that fails must not take the rest of what has arrived with it.
        for arrival in self.bus.receive_all():
            for raw_handler in self._raw_handlers:
                self._guarded(raw_handler, arrival)
            message = arrival.message
            if message is not None and arrival.verdict == "good" and arrival.rig == self.rig.name:
                self.inbox.hear(spec_of(type(message)).kind, message)
                for handler in self._handlers.get(type(message), ()):
                    self._guarded(handler, message)

    def _become_ready(self) -> None:
        self._is_ready = True
        if self._status[0] == "starting":
            self._status = ("ready", "")
        self.notifier.ready(": ".join(part for part in self._status if part))
        self.log.event("ready", bus=self.rig.bus_subscribe)
        self._say_health()
        self.every(self.rig.health_every_s, self._say_health)
        for call in self._ready_calls:
            self._guarded(call)

    def _say_health(self) -> None:
        self._log_state()  # a text that was held back is told when its time has come
        counters = self.bus.counters
        state, reason = self._status
        self.publish(
            Health(
                state=state,
                reason=as_sentence(reason),
                version=_version(),
                config_sha256=self._config_sha256,
                uptime_s=time.monotonic() - self._started_s,
                resident_kib=resident_kib(),
                sent=counters.sent,
                received=counters.received,
                gaps=counters.gaps,
                bad=counters.bad,
                unknown=counters.unknown,
                duplicates=counters.duplicates,
                slowest_ms=self._slowest_s * 1000,
            )
        )
        self._slowest_s = 0.0

    @contextlib.contextmanager
    def _signals(self) -> Iterator[None]:
        """SIGTERM and SIGINT end the loop, even while it waits."""
        reader, writer = socket.socketpair()
        reader.setblocking(False)
        writer.setblocking(False)
        before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
        old_fd = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)

        def heard() -> None:
            numbers = reader.recv(64)
            self.stop(f"signal {signal.Signals(numbers[0]).name}")

        for number in before:
            signal.signal(number, lambda *_: None)
        self.on_readable(reader.fileno(), heard)
        try:
            yield
        finally:
            signal.set_wakeup_fd(old_fd)
            for number, handler in before.items():
                signal.signal(number, handler)
            self.forget_readable(reader.fileno())
            reader.close()
            writer.close()


def resident_kib() -> int:
    """Resident memory of this process; 0 where /proc does not say."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE") // 1024


@functools.cache
def _version() -> str:
    return importlib.metadata.version("flora")
