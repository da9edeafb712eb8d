"""flora-dashboard as a process on a real bus."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import struct
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from announced_frames import announced
from flora_common.messages import Departure, Frame, Stem, Tick
from flora_common.runs import CameraSection, RunFile, RunFolder, TargetSection, run_file_text

DEADLINE_S = 20.0
RUN = RunFile(camera=CameraSection((800.0, 1000.0), 18.0), plant="bean 7", target=TargetSection(-5.12, 17.9))
POINTS = tuple((-0.1 * i, 1.0 * i) for i in range(10))


class Page:
    """What a browser asks of it."""

    def __init__(self, bus: Any) -> None:
        (self.port,) = bus.free_ports(1)
        bus.sections["dashboard"] = {"port": self.port}

    def get(self, path: str) -> bytes:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.port}{path}", timeout=DEADLINE_S) as answer:
            return bytes(answer.read())

    def state(self) -> dict[str, Any]:
        return dict(json.loads(self.get("/api/state")))

    def wait(self, holds: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """The first state of which this holds."""
        end_s = time.monotonic() + DEADLINE_S
        while not holds(state := self.state()):
            assert time.monotonic() < end_s, state
            time.sleep(0.05)
        return state


@pytest.fixture
def page(bus: Any) -> Page:
    bus.run_dir.mkdir()
    run = RunFolder(bus.run_dir)
    run.run_toml.write_text(run_file_text(RUN))
    run.append_track(0.0, "dark", POINTS)
    return Page(bus)


def photograph(bus: Any, tick: int) -> tuple[Frame, bytes]:
    data = f"\xff\xd8 photograph {tick}".encode("latin-1")
    path = f"frames/{tick:06}.jpg"
    (bus.run_dir / "frames").mkdir(exist_ok=True)
    (bus.run_dir / path).write_bytes(data)
    return announced(path, data, tick), data


def test_what_the_rig_says_is_on_the_page(bus: Any, page: Page) -> None:
    bus.start_service("flora-bus")
    client = bus.client("flora-flash")
    frame, data = photograph(bus, 1)
    client.publish(Tick(tick=1, time_s=300.0))  # before the page is there: the bus keeps it
    bus.start_service("flora-dashboard")
    bus.wait_ready(client, "flora-dashboard")
    state = page.wait(lambda state: "tick" in state["last"])
    assert (state["rig"], state["run"], state["plant"]) == ("test", "run", "bean 7")
    assert state["rows_end"] == 1  # from track.csv
    client.publish(frame)
    client.publish(Stem(tick=1, time_s=300.0, outcome="ok", points_cm=POINTS, light="left", frame_sha256=frame.sha256))
    state = page.wait(lambda state: bool(state.get("is_measured")))
    assert page.get(f"/photographs/{state['photograph']['sha256']}") == data
    rows = json.loads(page.get("/api/history?from=0"))["rows"]
    assert [row[0] for row in rows] == [0.0, 300.0]
    assert rows[1][3:5] == [-0.9, 9.0]
    client.publish(Departure(run="run", is_departed=True, sentence="It leans to the right."))
    page.wait(lambda state: any("It leans to the right." in one["text"] for one in state["concerns"]))
    own = next(one for one in page.state()["services"] if one["name"] == "flora-dashboard")
    assert own["ok"]


def test_what_is_of_another_run_is_not_on_the_charts(bus: Any, page: Page) -> None:
    def stem(tick: int, time_s: float, run: str) -> Stem:
        return Stem(tick=tick, time_s=time_s, outcome="ok", points_cm=POINTS, light="left", run=run)

    def times_s() -> list[float]:
        return [row[0] for row in json.loads(page.get("/api/history?from=0"))["rows"]]

    bus.start_service("flora-bus")
    client = bus.client("flora-stem")
    client.publish(stem(900, 270_000.0, "bean-00"))  # the bus keeps it
    bus.start_service("flora-dashboard")
    bus.wait_ready(client, "flora-dashboard")
    client.publish(stem(901, 300.0, "run"))
    page.wait(lambda state: "stem" in state["last"])
    assert times_s() == [0.0, 300.0]
    before = page.state()["rows_end"]
    client.publish(stem(902, 100.0, "run"))  # the rows before it are those of a run of that name that was put aside
    state = page.wait(lambda state: state["last"]["stem"]["message"]["tick"] == 902)
    assert times_s() == [100.0]
    assert state["rows_begin"] > before  # pages that are open take it for all that there is


def test_where_run_dir_is_a_link_the_run_has_the_name_that_messages_give_it(bus: Any, page: Page) -> None:
    bus.run_dir.rename(bus.run_dir.with_name("bean-07"))
    bus.run_dir.symlink_to("bean-07")
    bus.start_service("flora-bus")
    client = bus.client("flora-lab")
    bus.start_service("flora-dashboard")
    bus.wait_ready(client, "flora-dashboard")
    client.publish(Departure(run="bean-07", is_departed=True, sentence="It leans to the right."))
    state = page.wait(lambda state: "departure" in state["last"])
    assert state["run"] == "bean-07"
    assert any("It leans to the right." in one["text"] for one in state["concerns"])


def test_it_goes_on_without_a_bus_and_says_so(bus: Any, page: Page) -> None:
    broker = bus.start_service("flora-bus")
    client = bus.client()
    service = bus.start_service("flora-dashboard")
    bus.wait_ready(client, "flora-dashboard")
    broker.kill()
    broker.wait()
    page.wait(lambda state: any(one["state"] == "silent" for one in state["services"]))
    assert service.poll() is None
    bus.start_service("flora-bus")
    client.publish(Tick(tick=9, time_s=2700.0))
    bus.hear(client, lambda heard: any(isinstance(one.message, Tick) for one in heard))
    page.wait(lambda state: state["last"].get("tick", {}).get("message", {}).get("tick") == 9)


def test_browsers_that_do_not_take_their_photograph_cost_no_copy_each(bus: Any, page: Page) -> None:
    def resident_mib() -> int:
        return int(Path(f"/proc/{service.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") >> 20

    bus.start_service("flora-bus")
    client = bus.client("flora-capture")
    service = bus.start_service("flora-dashboard")
    bus.wait_ready(client, "flora-dashboard")
    data = b"\xff\xd8" + bytes(8_000_000)
    (bus.run_dir / "frames").mkdir()
    (bus.run_dir / "frames/000001.jpg").write_bytes(data)
    client.publish(announced("frames/000001.jpg", data, 1))
    path = f"/photographs/{page.wait(lambda state: state['photograph'])['photograph']['sha256']}"
    assert page.get(path) == data
    before_mib = resident_mib()
    with contextlib.ExitStack() as browsers:
        for _ in range(40):
            browser = browsers.enter_context(socket.socket())
            browser.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            browser.connect(("127.0.0.1", page.port))
            browser.sendall(f"GET {path} HTTP/1.1\r\nHost: rig\r\n\r\n".encode())
            assert browser.recv(4) == b"HTTP"
        assert page.get(path) == data
        assert resident_mib() - before_mib < 80  # a copy each would be 300
    for _ in range(10):
        with socket.create_connection(("127.0.0.1", page.port)) as browser:
            browser.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # hangs up at once
            browser.sendall(f"GET {path} HTTP/1.1\r\nHost: rig\r\n\r\n".encode())
            assert browser.recv(4) == b"HTTP"
    assert page.get(path) == data
    _, _, err = bus.stop(service)
    assert "raised exception" not in err  # a line of log for each piece that found nobody any more


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_ends_politely_though_a_page_is_open(bus: Any, page: Page, number: signal.Signals) -> None:
    bus.start_service("flora-bus")
    service = bus.start_service("flora-dashboard")
    bus.wait_ready(bus.client(), "flora-dashboard")
    with urllib.request.urlopen(f"http://127.0.0.1:{page.port}/api/events", timeout=DEADLINE_S) as stream:
        assert stream.readline().startswith(b"data: ")
        service.send_signal(number)
        _, err = service.communicate(timeout=DEADLINE_S)
    assert service.returncode == 0
    assert "Traceback" not in err


def test_without_a_run_folder_it_shows_what_there_is(bus: Any) -> None:
    page = Page(bus)
    bus.start_service("flora-bus")
    client = bus.client()
    bus.start_service("flora-dashboard")
    bus.wait_ready(client, "flora-dashboard")
    state = page.wait(lambda state: bool(state.get("concerns")))
    assert "run.toml" in state["concerns"][0]["text"]
    with pytest.raises(urllib.error.HTTPError, match="404"):
        page.get("/photographs/" + 64 * "0")


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ({"port": 70_000}, "port"),
        ({"hots": "127.0.0.1"}, "host"),
        ({"host": "203.0.113.1"}, "203.0.113.1"),
        ({"viewers": 0}, "viewers"),
    ],
)
def test_what_it_cannot_use_is_told_in_a_line(bus: Any, section: dict[str, object], words: str) -> None:
    bus.sections["dashboard"] = section
    service = bus.start_service("flora-dashboard")
    _, err = service.communicate(timeout=DEADLINE_S)
    assert service.returncode == 2
    assert words in err
    assert len(err.strip().splitlines()) == 1


def test_a_port_that_somebody_else_has_is_told_in_a_line(bus: Any) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        bus.sections["dashboard"] = {"port": other.getsockname()[1]}
        service: subprocess.Popen[str] = bus.start_service("flora-dashboard")
        _, err = service.communicate(timeout=DEADLINE_S)
    assert service.returncode == 2
    assert "Address already in use" in err
    assert len(err.strip().splitlines()) == 1
