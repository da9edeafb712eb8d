"""The camera process as the service sees it: started, asked, killed, started again; nothing here ever waits."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol

from flora_capture.wire import Answer, Assembler, CameraSettings, Request, pack
from flora_common.errors import CameraGone

SHORTEST_WAIT_S: Final = 1.0
LONGEST_WAIT_S: Final = 60.0
END_WAIT_S: Final = 1.0
MOST_STUCK: Final = 2
"""Killed and not ended yet, because the kernel does not let go of them: each further one would be stuck there too, and
take its memory along, with every tick another one."""
REAP_WAIT_S: Final = 0.2
PIECE_BYTES: Final = 1 << 20


class Loop(Protocol):
    """What is needed of :class:`flora_common.service.App`."""

    def on_readable(self, source: Any, handler: Callable[[], None]) -> None: ...
    def forget_readable(self, source: Any) -> None: ...
    def after(self, real_s: float, call: Callable[[], None]) -> Any: ...


class CameraProcess:
    """One child at a time.

    Args:
        loop: where its answers are waited for.
        settings: the first thing that every child is told.
        on_answer: called with each answer; number 0 says that the camera is open, or why it is not.
        on_gone: called with a sentence when a child has ended that nobody killed, or when none can be started.
        command: the child's command line.
    """

    def __init__(
        self,
        loop: Loop,
        settings: CameraSettings,
        *,
        on_answer: Callable[[Answer], None],
        on_gone: Callable[[str], None],
        command: Sequence[str] = (sys.executable, "-m", "flora_capture.child"),
    ) -> None:
        self._loop = loop
        self._settings = settings
        self._on_answer = on_answer
        self._on_gone = on_gone
        self._command = list(command)
        self._child: subprocess.Popen[bytes] | None = None
        self._ended: list[subprocess.Popen[bytes]] = []
        self._assembler = Assembler()
        self._wait_s = SHORTEST_WAIT_S
        self._is_waiting = False
        self._is_over = False

    @property
    def pid(self) -> int | None:
        """Process id of the present child."""
        return self._child.pid if self._child else None

    def start(self) -> None:
        """Start a child unless there is one, or is to be none any more."""
        if self._child is not None or self._is_over:
            return
        self._ended = [child for child in self._ended if child.poll() is None]
        if len(self._ended) >= MOST_STUCK:
            pids = ", ".join(str(child.pid) for child in self._ended)
            self._not_started(
                f"the camera's driver hangs: camera processes {pids} were killed and have not ended; restart the Pi"
            )
            return
        self._assembler = Assembler()
        try:
            child = subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)
        except OSError as problem:  # no memory or no descriptor for it just now
            self._not_started(f"the camera process cannot be started ({problem.strerror}); tried again by itself")
            return
        assert child.stdout is not None
        os.set_blocking(child.stdout.fileno(), False)
        self._child, self._is_waiting = child, False
        self._loop.on_readable(child.stdout.fileno(), self._readable)
        self._send(pack(self._settings))

    def _not_started(self, reason: str) -> None:
        self._start_later()
        self._on_gone(reason)

    def ask(self, request: Request) -> None:
        """Ask for a photograph; a child that is still opening its camera reads this afterwards."""
        self.start()
        if self._child is not None:
            self._send(pack(request))

    def kill(self) -> None:
        """End the child at once, whatever it does. The next one starts by itself, after a wait that grows."""
        child, self._child = self._child, None
        if child is None:
            return
        assert child.stdin is not None
        assert child.stdout is not None
        self._loop.forget_readable(child.stdout.fileno())
        child.kill()
        child.stdin.close()
        child.stdout.close()
        # Not waited for: a process stuck in the camera driver ends when the kernel lets it.
        if child.poll() is None:
            self._ended.append(child)
        self._start_later()

    def _start_later(self) -> None:
        if not self._is_waiting and not self._is_over:
            self._is_waiting = True
            self._loop.after(self._wait_s, self._start_if_waiting)
            self._wait_s = min(LONGEST_WAIT_S, 2 * self._wait_s)

    def retire(self) -> None:
        """End the child; there is no use for another one."""
        self._is_over = True
        self.kill()

    def close(self) -> None:
        """End the child for good, and wait until it has ended."""
        self.retire()
        for child in self._ended:
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(END_WAIT_S)

    def _start_if_waiting(self) -> None:
        if self._is_waiting:
            self._is_waiting = False
            self.start()

    def _send(self, data: bytes) -> None:
        assert self._child is not None
        assert self._child.stdin is not None
        # One that has died is told by the end of its stdout. A few hundred bytes into an empty pipe do not block.
        with contextlib.suppress(BrokenPipeError):
            self._child.stdin.write(data)

    def _readable(self) -> None:
        if self._child is None or self._child.stdout is None:
            return
        try:
            piece = os.read(self._child.stdout.fileno(), PIECE_BYTES)
        except BlockingIOError:
            return
        if not piece:
            self._lost(_how_it_ended(self._child))
            return
        try:
            answers = self._assembler.add(piece)
        except CameraGone as problem:
            self._lost(str(problem))
            return
        for answer in answers:
            if not answer.problem:
                self._wait_s = SHORTEST_WAIT_S
            self._on_answer(answer)

    def _lost(self, reason: str) -> None:
        self.kill()
        self._on_gone(reason)


def _how_it_ended(child: subprocess.Popen[bytes]) -> str:
    try:
        status = child.wait(REAP_WAIT_S)  # its output ends a moment before it does
    except subprocess.TimeoutExpired:
        return "the camera process closed its output"
    return (
        f"the camera process was killed by signal {-status}"
        if status < 0
        else (f"the camera process ended with status {status}; its last words are in the log")
    )
