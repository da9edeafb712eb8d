"""Word to systemd, heard at a real socket in its place."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from flora_common.notify import Notifier


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[tuple[socket.socket, str]]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        path = str(tmp_path / "notify")
        heard.bind(path)
        heard.settimeout(5.0)
        yield heard, path


def test_says_ready_status_alive_and_stopping(systemd: tuple[socket.socket, str]) -> None:
    heard, path = systemd
    notifier = Notifier({"NOTIFY_SOCKET": path})
    notifier.ready("degraded: no NAS")
    notifier.status("ready")
    notifier.alive()
    notifier.stopping("stopping")
    assert [heard.recv(200) for _ in range(4)] == [
        b"READY=1\nSTATUS=degraded: no NAS",
        b"STATUS=ready",
        b"WATCHDOG=1",
        b"STOPPING=1\nSTATUS=stopping",
    ]
    notifier.close()


def test_a_status_is_one_line_whatever_is_in_it(systemd: tuple[socket.socket, str]) -> None:
    heard, path = systemd
    notifier = Notifier({"NOTIFY_SOCKET": path})
    status = "x\r\nWATCHDOG_USEC=1\x00\x1b\x85STOPPING=1\u2028\u2029y \udcff"
    notifier.ready(status)
    notifier.status(status)
    notifier.stopping(status)
    line = b"STATUS=x WATCHDOG_USEC=1 STOPPING=1 y ?"
    assert [heard.recv(200) for _ in range(3)] == [b"READY=1\n" + line, line, b"STOPPING=1\n" + line]
    notifier.close()


def test_abstract_addresses_work() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        heard.bind("")  # the kernel picks an abstract name
        heard.settimeout(5.0)
        notifier = Notifier({"NOTIFY_SOCKET": "@" + heard.getsockname()[1:].decode()})
        notifier.alive()
        assert heard.recv(100) == b"WATCHDOG=1"
        notifier.close()


def test_without_systemd_nothing_happens() -> None:
    notifier = Notifier({})
    notifier.ready("ready")
    notifier.alive()
    notifier.close()
    assert notifier.watchdog_s is None


def test_nobody_listening_ends_nothing(tmp_path: Path) -> None:
    notifier = Notifier({"NOTIFY_SOCKET": str(tmp_path / "gone")})
    notifier.alive()
    notifier.close()


@pytest.mark.parametrize(
    ("environment", "watchdog_s"),
    [
        ({"WATCHDOG_USEC": "30000000"}, 30.0),
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "7"}, 30.0),
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "8"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({}, None),
    ],
)
def test_watchdog_interval_is_ours_only_when_meant_for_us(
    environment: dict[str, str], watchdog_s: float | None
) -> None:
    assert Notifier(environment, pid=7).watchdog_s == watchdog_s
