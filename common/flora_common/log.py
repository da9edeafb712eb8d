"""An event name and fields, to the journal where there is one, to the terminal elsewhere.

Logging never stops the work, and a problem that lasts is told when it begins and when it ends, not every five minutes.
"""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

Sink = Callable[[int, str, str, dict[str, Any]], None]

PRIORITIES: Final = {logging.DEBUG: 7, logging.INFO: 6, logging.WARNING: 4, logging.ERROR: 3, logging.CRITICAL: 2}
"""Python's levels to syslog's, which the journal filters on."""


SAME_KIND_S: Final = 600.0
"""A problem whose text changes, though it is the same, is told again after so many seconds."""


@dataclass(frozen=True, slots=True)
class _Told:
    reason: str
    kind: str | None
    at_s: float


class Log:
    """The log of one service.

    Args:
        service: its name.
        sink: where lines go: (level, service, text, fields).
        level: least level to let through.
        common: fields of every line, such as the run.
        now_s: real, monotonic seconds.
    """

    def __init__(
        self,
        service: str,
        sink: Sink,
        *,
        level: int = logging.INFO,
        common: dict[str, Any] | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._service = service
        self._sink = sink
        self._level = level
        self._common = common or {}
        self._now_s = now_s
        self._problems: dict[str, _Told] = {}

    def event(self, name: str, *, level: int = logging.INFO, **fields: Any) -> None:
        """Something happened: ``log.event("frame_saved", tick=3, bytes=512_000)``."""
        if level >= self._level:
            self._sink(level, self._service, name, {**self._common, **fields})

    def debug(self, name: str, **fields: Any) -> None:
        self.event(name, level=logging.DEBUG, **fields)

    def warning(self, name: str, **fields: Any) -> None:
        self.event(name, level=logging.WARNING, **fields)

    def error(self, name: str, **fields: Any) -> None:
        self.event(name, level=logging.ERROR, **fields)

    def problem(self, key: str, reason: str, *, kind: str | None = None, **fields: Any) -> None:
        """A lasting problem: told when it begins or changes.

        Args:
            key: its name, and the event's.
            reason: what is wrong.
            kind: what stays the same while the reason's text differs, as where it names the tick. Another text of
                the same kind is told when :data:`SAME_KIND_S` have passed since the last.
            fields: further fields of the line.
        """
        told, now_s = self._problems.get(key), self._now_s()
        if told is not None:
            if told.reason == reason:
                return
            if kind is not None and told.kind == kind and now_s - told.at_s < SAME_KIND_S:
                return
        self._problems[key] = _Told(reason, kind, now_s)
        self.warning(key, reason=reason, **fields)

    def solved(self, key: str) -> None:
        """The problem is over: told once."""
        if self._problems.pop(key, None) is not None:
            self.event(f"{key}_solved")


def terminal_sink(level: int, service: str, text: str, fields: dict[str, Any]) -> None:
    """``W flora-capture camera_hung tick=3`` on stderr."""
    shown = " ".join(f"{k}={_quoted(v)}" for k, v in fields.items() if k != "run")
    _print(f"{logging.getLevelName(level)[0]} {service} {text} {shown}".rstrip())


def journal_sink() -> Sink:
    """Structured lines to journald: ``journalctl FLORA_RUN=bean-07 FLORA_EVENT=frame_saved`` works."""
    from systemd import journal  # type: ignore[attr-defined]  # noqa: PLC0415 - Linux only, and only under systemd

    def sink(level: int, service: str, text: str, fields: dict[str, Any]) -> None:
        shown = " ".join(f"{k}={_quoted(v)}" for k, v in fields.items())
        try:
            journal.send(
                f"{text} {shown}".rstrip(),
                PRIORITY=PRIORITIES.get(level, 6),
                SYSLOG_IDENTIFIER=service,
                FLORA_EVENT=text,
                **{f"FLORA_{k.upper()}": str(v) for k, v in fields.items()},
            )
        except OSError as problem:
            _print(f"{service}: journal not reachable ({problem}): {text} {shown}")

    return sink


def choose_sink() -> Sink:
    """The journal when systemd connected our stderr to it, the terminal otherwise."""
    if "JOURNAL_STREAM" in os.environ:
        try:
            return journal_sink()
        except ImportError:
            print("systemd-python is not installed: plain lines to the journal", file=sys.stderr)
    return terminal_sink


def _print(line: str) -> None:
    # A full disk behind stderr, or a reader that has gone, must not end a service; there is nobody left to tell.
    with contextlib.suppress(OSError):
        print(line, file=sys.stderr, flush=True)


def _quoted(value: Any) -> str:
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return repr(text) if any(c.isspace() for c in text) else text
