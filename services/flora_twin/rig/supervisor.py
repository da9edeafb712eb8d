"""What systemd does on a Pi, for a rig of plain processes: start, READY, watchdog, restart, darken, stop.

The same promises as the units in ``systemd/``: a service that dies is started again, one that falls silent is killed,
and after a lamp service's death, by whatever cause, its lamps are darkened.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import socket
import subprocess
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from flora_common.errors import BadInput, FloraError

RESTART_AFTER_S: Final = 0.1
START_LIMIT: Final = 20
START_LIMIT_WINDOW_S: Final = 30.0
WATCHDOG_S: Final = 60.0
STOP_TIMEOUT_S: Final = 15.0
PR_SET_PDEATHSIG: Final = 1
_LIBC: Final = ctypes.CDLL(None)
DARKENED: Final = ("flora-led", "flora-flash")
"""Services whose unit has ``ExecStopPost=… --dark``."""


class ServiceFailed(FloraError):
    """A service of the virtual rig does not start, or keeps dying."""


class ServiceRefused(BadInput):
    """A service of the virtual rig was given something that it cannot use."""


@dataclass
class Child:
    """One supervised process."""

    name: str
    argv: Sequence[str]
    log: Path
    notify: socket.socket
    process: subprocess.Popen[bytes] | None = None
    ready: bool = False
    was_ready: bool = False
    last_alive_s: float = 0.0
    restarts: int = 0
    restart_at_s: float | None = None
    darkens: bool = False
    darkening: subprocess.Popen[bytes] | None = None
    darken_until_s: float = 0.0
    deaths: deque[float] = field(default_factory=lambda: deque(maxlen=START_LIMIT))

    @property
    def pid(self) -> int | None:
        return self.process.pid if self.process is not None and self.process.poll() is None else None


class Supervisor:
    """Starts and watches processes. Nothing runs by itself: call :meth:`poll` often.

    Args:
        sockets: folder for the notify sockets; its path must be short.
        logs: folder for each process's output.
    """

    def __init__(self, sockets: Path, logs: Path) -> None:
        self.children: dict[str, Child] = {}
        self._is_interrupted = False
        self._sockets = sockets
        self._logs = logs

    def start(self, name: str, argv: Sequence[str], *, ready_within_s: float = 30.0) -> None:
        """Start one process and wait for its READY.

        Raises:
            ServiceFailed: it ended, or did not say READY in time; the end of its log is in the message.
        """
        self.launch(name, argv)
        self.wait_ready([name], within_s=ready_within_s)

    def launch(self, name: str, argv: Sequence[str]) -> None:
        """Start one process without waiting."""
        address = self._sockets / f"notify-{name}"
        address.unlink(missing_ok=True)
        notify = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        notify.bind(str(address))
        notify.setblocking(False)
        child = Child(name, list(argv), self._logs / f"{name}.log", notify, darkens=name in DARKENED)
        self.children[name] = child
        self._spawn(child)

    def wait_ready(self, names: Sequence[str], *, within_s: float = 30.0) -> None:
        """Wait until all of these have said READY (see :meth:`start`)."""
        deadline_s = time.monotonic() + within_s
        while not all(self.children[name].ready for name in names):
            self.poll()
            if time.monotonic() > deadline_s:
                late = next(name for name in names if not self.children[name].ready)
                raise ServiceFailed(f"{late} was not ready after {within_s:g} s: {self._last_line(late)}")
            time.sleep(0.005)

    def interrupt(self) -> None:
        """For signal handlers: the next :meth:`poll` raises KeyboardInterrupt.

        Raising in the handler itself would lose the signal where it strikes inside a fork, and with it a process.
        """
        self._is_interrupted = True

    def poll(self) -> None:
        """Hear notifications, reap the dead, restart them, kill the silent.

        Raises:
            KeyboardInterrupt: :meth:`interrupt` was called.
            ServiceFailed, ServiceRefused: a process keeps dying, or cannot use what it was given.
        """
        if self._is_interrupted:
            raise KeyboardInterrupt
        now_s = time.monotonic()
        for child in self.children.values():
            self._hear(child, now_s)
            if child.process is None:
                if child.darkening is not None:
                    if child.darkening.poll() is None and now_s < child.darken_until_s:
                        continue
                    _end(child.darkening)
                    child.darkening = None
                if child.restart_at_s is not None and now_s >= child.restart_at_s:
                    child.restarts += 1
                    self._spawn(child)
            elif child.process.poll() is not None:
                self._died(child, now_s)
            elif child.ready and now_s - child.last_alive_s > WATCHDOG_S:
                child.process.send_signal(signal.SIGABRT)

    def kill(self, name: str, number: signal.Signals = signal.SIGKILL) -> None:
        """Send a signal; :meth:`poll` then does what systemd would."""
        process = self.children[name].process
        if process is not None and process.poll() is None:
            process.send_signal(number)

    def stop(self, name: str) -> int:
        """SIGTERM, then SIGKILL after a time-out; not restarted. Returns the exit status."""
        child = self.children.pop(name)
        status = 0
        if child.process is not None:
            status = _end(child.process)
            _end_group(child.process.pid)
            self._stop_post(child)
        if child.darkening is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.darkening.wait(STOP_TIMEOUT_S)
            _end(child.darkening)
        child.notify.close()
        (self._sockets / f"notify-{name}").unlink(missing_ok=True)
        return status

    def stop_all(self, order: Sequence[str] = ()) -> dict[str, int]:
        """Stop these first, in this order, then the others, latest started first."""
        names = [n for n in order if n in self.children]
        names += [n for n in reversed(list(self.children)) if n not in names]
        return {name: self.stop(name) for name in names}

    def end_all(self, names: Sequence[str]) -> None:
        """After a failure or Ctrl-C: these at once, then what they rest on; lamps go with their box and stay as lit."""
        for child in self.children.values():
            child.darkens = False
            if child.name in names and child.process is not None:
                child.process.terminate()
        self.stop_all(names)

    def _spawn(self, child: Child) -> None:
        environment = {
            **os.environ,
            "NOTIFY_SOCKET": str(self._sockets / f"notify-{child.name}"),
            "WATCHDOG_USEC": str(round(WATCHDOG_S * 1e6)),
            "PYTHONUNBUFFERED": "1",
            # Two cores and small arrays: thread pools of each process would only stand in each other's way.
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }
        environment.pop("JOURNAL_STREAM", None)
        child.ready, child.restart_at_s, child.last_alive_s = False, None, time.monotonic()
        with child.log.open("ab") as log:
            child.process = subprocess.Popen(
                child.argv,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env=environment,
                start_new_session=True,
                preexec_fn=end_with_parent(),  # noqa: PLW1509 - the supervisor has one thread
            )

    def _hear(self, child: Child, now_s: float) -> None:
        while True:
            try:
                lines = child.notify.recv(4096).decode("utf-8", "replace").split("\n")
            except BlockingIOError:
                return
            child.last_alive_s = now_s
            child.ready = child.ready or "READY=1" in lines
            child.was_ready = child.was_ready or child.ready

    def _died(self, child: Child, now_s: float) -> None:
        status = 0
        if child.process is not None:
            status = child.process.returncode
            _end_group(child.process.pid)
        child.process = None
        self._stop_post(child)
        child.deaths.append(now_s)
        if status == BadInput.exit_status:
            raise ServiceRefused(self._last_line(child.name))
        # One that ends by itself before it was ever ready would do so again; one that was killed need not.
        if status > 0 and not child.was_ready:
            raise ServiceFailed(f"{child.name} ended with status {status} at its start: {self._last_line(child.name)}")
        if len(child.deaths) == START_LIMIT and now_s - child.deaths[0] < START_LIMIT_WINDOW_S:
            raise ServiceFailed(f"{child.name} ended with status {status}: {self._last_line(child.name)}")
        child.restart_at_s = now_s + RESTART_AFTER_S

    def _stop_post(self, child: Child) -> None:
        """Begin to darken. Not waited for: it may need a box that :meth:`poll` has yet to start again."""
        if child.darkens:
            child.darken_until_s = time.monotonic() + STOP_TIMEOUT_S
            with child.log.open("ab") as log:
                child.darkening = subprocess.Popen(
                    [*child.argv, "--dark"], stdin=subprocess.DEVNULL, stdout=log, stderr=log
                )

    def _last_line(self, name: str) -> str:
        lines = self.children[name].log.read_text(errors="replace").strip().splitlines()
        return f"{lines[-1]} (all of it: {self.children[name].log})" if lines else "it said nothing"


def _end(process: subprocess.Popen[bytes]) -> int:
    process.terminate()
    try:
        return process.wait(STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()


def end_with_parent() -> Callable[[], None]:
    """What a child is to do first: a rig without its supervisor, however that died, would run for ever."""
    parent_pid = os.getpid()

    def ask() -> None:
        _LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent_pid:  # it has died before the kernel was asked to tell
            os._exit(1)

    return ask


def _end_group(leader_pid: int) -> None:
    """What a dead service leaves running (a camera process) goes with it, as systemd does by control group."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(leader_pid, signal.SIGKILL)


def wait_until(
    condition: Callable[[], bool], *, within_s: float, poll: Callable[[], None], what: str, pause_s: float = 0.005
) -> None:
    """Poll until ``condition`` holds.

    Raises:
        ServiceFailed: not within the given real seconds.
    """
    deadline_s = time.monotonic() + within_s
    while not condition():
        if time.monotonic() > deadline_s:
            raise ServiceFailed(f"{what}: not within {within_s:g} s")
        poll()
        time.sleep(pause_s)
