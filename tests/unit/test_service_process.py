"""The service loop as a process: ready, alive, hung, ended, a bug, an expected failure, started twice."""

from __future__ import annotations

import os
import resource
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fake_clock import FakeClock
from flora_bus.main import BusSection
from flora_common import service as service_module
from flora_common.app import App
from flora_common.config import RigSection
from flora_common.errors import ConfigError
from flora_common.log import SAME_KIND_S, Log
from flora_common.messages import Health, Tick
from flora_common.service import _only_one, run_service

SERVICE = """
import sys
import threading

import msgspec

from flora_common.errors import CameraGone
from flora_common.messages import Tick
from flora_common.app import App
from flora_common.service import run_service


class Section(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    pass


def build(app):
    def on_tick(tick):
        if tick.shot == "hang":
            threading.Event().wait()
        if tick.shot == "bug":
            raise ZeroDivisionError("a bug")
        if tick.shot == "expected":
            raise CameraGone("no camera at /dev/video7; is it plugged in?")
        if tick.shot == "trouble":
            app.trouble("camera", f"no photograph for tick {tick.tick}")
        if tick.shot == "more_trouble":
            app.trouble("disk", "no room")
        if tick.shot == "over":
            app.trouble("camera", "")
            app.trouble("disk", "")
        if tick.shot == "well":
            app.state("ready")

    app.on(Tick, on_tick)
    app.on_exit(lambda: print("dark", flush=True))


sys.exit(run_service("flora-twin", Section, build))
"""

PING_EVERY_S = 0.3


class Systemd:
    """A socket in systemd's place."""

    def __init__(self, folder: Path) -> None:
        self.path = str(folder / "n")
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(self.path)
        self.socket.settimeout(20.0)
        self.environment = {"NOTIFY_SOCKET": self.path, "WATCHDOG_USEC": str(round(PING_EVERY_S * 3 * 1e6))}

    def hear(self) -> list[str]:
        return self.socket.recv(4096).decode().splitlines()

    def until(self, wanted: str) -> list[list[str]]:
        heard = [self.hear()]
        while not any(line.startswith(wanted) for line in heard[-1]):
            heard.append(self.hear())
        return heard

    def is_silent_for(self, seconds: float) -> bool:
        self.socket.settimeout(seconds)
        try:
            self.hear()
        except TimeoutError:
            return True
        finally:
            self.socket.settimeout(20.0)
        return False


@pytest.fixture
def systemd(bus: Any) -> Iterator[Systemd]:
    made = Systemd(Path(bus.address.publish.removeprefix("ipc://")).parent)
    yield made
    made.socket.close()


@pytest.fixture
def service(bus: Any, systemd: Systemd) -> Any:
    script = bus.folder / "service.py"
    script.write_text(SERVICE, encoding="utf-8")

    def start() -> subprocess.Popen[str]:
        process: subprocess.Popen[str] = bus.start_service(str(script), env=systemd.environment)
        return process

    return start


def start_command(bus: Any, shot: str) -> Any:
    client = bus.client("flora-flash")
    bus.wait_ready(client, "flora-twin")
    client.publish(Tick(tick=1, time_s=0.0, shot=shot))
    return client


def test_ready_is_said_only_when_the_bus_has_answered(bus: Any, systemd: Systemd, service: Any) -> None:
    service()
    heard = systemd.until("STATUS=starting: waiting for the bus")
    for _ in range(4):
        heard += systemd.until("WATCHDOG=1")  # it lives, and waits
    assert not any("READY=1" in lines for lines in heard)
    bus.start_service("flora-bus")
    assert "STATUS=ready" in systemd.until("READY=1")[-1]


def test_health_is_on_the_bus(bus: Any, service: Any) -> None:
    bus.start_service("flora-bus")
    process = service()
    client = bus.client()
    heard = bus.hear(client, lambda heard: sum(from_service(a) for a in heard) >= 3)
    health = [a.message for a in heard if from_service(a)]
    first = health[0].seq
    assert [h.seq for h in health] == [first, first + 1, first + 2]
    assert all(h.state == "ready" for h in health)
    assert 5_000 < health[-1].resident_kib < 200_000
    assert health[-1].sent == first + 1
    assert len(health[-1].config_sha256) == 64
    assert process.poll() is None


def from_service(arrival: Any) -> bool:
    return isinstance(arrival.message, Health) and arrival.message.source == "flora-twin"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("has_bus", [True, False])
def test_a_signal_ends_it_well_within_a_second(
    bus: Any, systemd: Systemd, service: Any, number: signal.Signals, has_bus: bool
) -> None:
    if has_bus:
        bus.start_service("flora-bus")
    process = service()
    systemd.until("READY=1" if has_bus else "WATCHDOG=1")
    began_s = time.monotonic()
    process.send_signal(number)
    out, err = process.communicate(timeout=20)
    took_s = time.monotonic() - began_s
    assert process.returncode == 0, err
    assert out == "dark\n"
    assert took_s < 1.0
    assert systemd.until("STOPPING=1")


def test_a_hung_handler_starves_the_watchdog(bus: Any, systemd: Systemd, service: Any) -> None:
    bus.start_service("flora-bus")
    process = service()
    start_command(bus, "hang")
    end_s = time.monotonic() + 20
    while not systemd.is_silent_for(4 * PING_EVERY_S):
        assert time.monotonic() < end_s, "it goes on saying that it is alive"
    assert process.poll() is None


def test_a_bug_keeps_its_traceback_and_leaves_things_dark(bus: Any, service: Any) -> None:
    bus.start_service("flora-bus")
    process = service()
    start_command(bus, "bug")
    out, err = process.communicate(timeout=20)
    assert process.returncode == 1
    assert "Traceback" in err
    assert "ZeroDivisionError: a bug" in err
    assert out == "dark\n"


def test_an_expected_failure_degrades_and_is_told_and_the_rest_goes_on(bus: Any, service: Any) -> None:
    bus.start_service("flora-bus")
    process = service()
    client = start_command(bus, "expected")
    reason = "no camera at /dev/video7; is it plugged in?"
    is_told = lambda a: from_service(a) and (a.message.state, a.message.reason) == ("degraded", reason)  # noqa: E731
    bus.hear(client, lambda heard: any(is_told(a) for a in heard))
    client.publish(Tick(tick=2, time_s=1.0, shot="well"))
    bus.hear(client, lambda heard: any(from_service(a) and a.message.state == "ready" for a in heard))
    status, _, err = bus.stop(process)
    assert status == 0
    assert err.count(reason) == 1


def test_a_trouble_whose_text_changes_is_told_on_the_bus_each_time_and_in_the_log_once(bus: Any, service: Any) -> None:
    bus.start_service("flora-bus")
    process = service()
    client = bus.client("flora-flash")
    bus.wait_ready(client, "flora-twin")
    for tick in range(1, 6):
        client.publish(Tick(tick=tick, time_s=0.0, shot="trouble"))
        bus.hear(client, lambda heard, tick=tick: any(says(a, f"no photograph for tick {tick}") for a in heard))
    client.publish(Tick(tick=6, time_s=0.0, shot="more_trouble"))
    bus.hear(client, lambda heard: any(says(a, "no photograph for tick 5; no room") for a in heard))
    client.publish(Tick(tick=7, time_s=0.0, shot="over"))
    bus.hear(client, lambda heard: any(from_service(a) and a.message.state == "ready" for a in heard))
    _, _, err = bus.stop(process)
    told = [line for line in err.splitlines() if "degraded" in line]
    assert [line.partition("reason=")[2] for line in told] == [
        "'no photograph for tick 1'",
        "'no photograph for tick 5; no room'",
        "'no room'",
        "",
    ]
    assert told[-1].endswith("degraded_solved")


def test_a_text_that_was_held_back_is_told_when_its_time_has_come(tmp_path: Path) -> None:
    now_s, lines = 0.0, []
    log = Log("flora-twin", lambda *line: lines.append(line[3].get("reason")), now_s=lambda: now_s)
    rig = RigSection(run_dir=str(tmp_path), bus_publish=f"ipc://{tmp_path}/p", bus_subscribe=f"ipc://{tmp_path}/s")
    app = App("flora-twin", rig, BusSection(), log=log, clock=FakeClock())
    try:
        app.trouble("camera", "tick 1")
        app.trouble("camera", "tick 2")
        app._say_health()
        assert lines == ["tick 1"]
        now_s = SAME_KIND_S
        app._say_health()
        app._say_health()
        assert lines == ["tick 1", "tick 2"]
    finally:
        app.bus.close()


def says(arrival: Any, reason: str) -> bool:
    return from_service(arrival) and arrival.message.reason == reason


def test_messages_behind_one_that_fails_are_handled(bus: Any, service: Any) -> None:
    bus.start_service("flora-bus")
    process = service()
    client = bus.client("flora-flash")
    bus.wait_ready(client, "flora-twin")
    process.send_signal(signal.SIGSTOP)  # so that both are there at once
    client.publish(Tick(tick=1, time_s=0.0, shot="expected"))
    client.publish(Tick(tick=2, time_s=0.0, shot="bug"))
    bus.hear(client, lambda heard: sum(isinstance(a.message, Tick) for a in heard) == 2)
    process.send_signal(signal.SIGCONT)
    process.communicate(timeout=20)
    assert process.returncode == 1


def test_a_second_one_is_refused_and_a_killed_one_leaves_no_lock(bus: Any, systemd: Systemd, service: Any) -> None:
    bus.start_service("flora-bus")
    first = service()
    systemd.until("READY=1")
    second = service()
    _, err = second.communicate(timeout=20)
    assert second.returncode == 2
    assert err == f"flora-twin: flora-twin already runs for rig `test` (pid {first.pid}); stop it first\n"
    os.kill(first.pid, signal.SIGKILL)
    first.wait()
    service()
    systemd.until("READY=1")


def test_log_lines_name_the_run_as_messages_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[dict[str, Any]] = []

    def log(*_: Any, common: dict[str, Any], **__: Any) -> Log:
        told.append(common)
        raise ConfigError("enough")

    monkeypatch.setattr(service_module, "Log", log)
    (tmp_path / "bean-07").mkdir()
    (tmp_path / "current").symlink_to("bean-07")
    config = tmp_path / "flora.toml"
    config.write_text(f'[rig]\nrun_dir = "{tmp_path}/current"\n')
    assert run_service("flora-bus", BusSection, lambda app: None, argv=["--config", str(config)]) == 2
    assert told == [{"run": "bean-07"}]


def test_a_disk_without_room_keeps_no_service_from_starting_and_no_second_one_in(tmp_path: Path) -> None:
    rig = RigSection(state_dir=str(tmp_path))
    most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, most[1]))  # whatever is written finds no room
    try:
        with _only_one("flora-led", rig), pytest.raises(ConfigError, match="already runs"), _only_one("flora-led", rig):
            pass
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, most)


def test_a_bus_that_comes_back_is_told_everything_again(bus: Any, systemd: Systemd, service: Any) -> None:
    broker = bus.start_service("flora-bus")
    service()
    systemd.until("READY=1")
    broker.kill()
    broker.wait()
    bus.start_service("flora-bus")
    client = bus.client("late")
    bus.wait_ready(client, "flora-twin", "flora-bus")
