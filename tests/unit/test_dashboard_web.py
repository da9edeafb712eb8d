"""The page's server: addresses, streams that follow, how many, how it ends, and what it says where it cannot begin."""

from __future__ import annotations

import errno
import hashlib
import http.client
import json
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from announced_frames import announced
from flora_common.errors import ConfigError
from flora_dashboard.photographs import Photographs
from flora_dashboard.server import SILENT_CHECKS, PageServer, listen, url_of
from flora_dashboard.web import PAGE, make_app

WITHIN_S = 10.0


class Served:
    """A server with two viewers at most, and what a browser asks of it."""

    def __init__(self, folder: Path) -> None:
        self.photographs = Photographs(folder)
        self.listener = listen("127.0.0.1", 0)
        self.port = int(self.listener.getsockname()[1])
        rows: Callable[[int], bytes] = lambda number: json.dumps({"begin": number, "rows": []}).encode()  # noqa: E731
        self.server = PageServer(self.listener, lambda latest: make_app(latest, self.photographs, rows, most_viewers=2))
        self.server.start()

    def get(self, path: str, method: str = "GET") -> tuple[int, dict[str, str], bytes]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=WITHIN_S)
        connection.request(method, path)
        answer = connection.getresponse()
        body = answer.read()
        connection.close()
        return answer.status, {name.lower(): value for name, value in answer.getheaders()}, body

    def wait(self, is_so: Callable[[], bool]) -> None:
        end_s = time.monotonic() + WITHIN_S
        while not is_so():
            assert time.monotonic() < end_s
            time.sleep(0.01)

    @contextmanager
    def stream(self) -> Iterator[http.client.HTTPResponse]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=WITHIN_S)
        connection.request("GET", "/api/events")
        answer = connection.getresponse()
        try:
            yield answer
        finally:
            answer.close()
            connection.close()


def event(answer: http.client.HTTPResponse) -> bytes:
    """The next event of a stream; signs of life are passed over."""
    while True:
        line = answer.readline()
        assert line, "the stream has ended"
        if line.startswith(b"data: "):
            assert answer.readline() == b"\n"
            return line[6:].strip()


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    served = Served(tmp_path)
    yield served
    served.server.stop()


def test_the_page_and_all_that_it_loads_are_there(served: Served) -> None:
    status, headers, body = served.get("/")
    assert (status, headers["content-type"]) == (200, "text/html; charset=utf-8")
    for file in sorted(PAGE.iterdir()):
        if file.name != "index.html":
            status, headers, content = served.get(f"/{file.name}")
            assert (status, content) == (200, file.read_bytes())
    for name in (b'href="leaf.svg"', b'href="dashboard.css"', b'src="dashboard.js"'):
        assert name in body
    assert b"://" not in body  # nothing from elsewhere: a grow box need not have an Internet


def test_nothing_foreign_may_run_in_it_and_nothing_can_be_changed(served: Served) -> None:
    for path in ("/", "/api/state", "/nothing"):
        _, headers, _ = served.get(path)
        assert "default-src 'none'" in headers["content-security-policy"]
        assert "script-src 'self'" in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
    for method in ("POST", "PUT", "DELETE"):
        for path in ("/", "/api/state", "/api/events", "/api/history", "/photographs/" + 64 * "0"):
            assert served.get(path, method)[0] == 405


def test_the_state_is_what_was_told_last(served: Served) -> None:
    assert served.get("/api/state")[2] == b"{}"
    for text in (b'{"a":1}', b'{"a":2}'):
        served.server.tell(text)
        served.wait(lambda text=text: served.get("/api/state")[2] == text)  # type: ignore[misc]


@pytest.mark.parametrize("asked", ["-1", "1.5", "x", "", "%00", "9" * 13])
def test_history_from_no_number_is_refused_in_a_line(served: Served, asked: str) -> None:
    status, _, body = served.get(f"/api/history?from={asked}")
    assert (status, body.count(b"\n")) == (400, 1)


def test_history_begins_where_it_was_asked_to(served: Served) -> None:
    assert json.loads(served.get("/api/history?from=17")[2]) == {"begin": 17, "rows": []}
    assert json.loads(served.get("/api/history")[2]) == {"begin": 0, "rows": []}


def test_a_photograph_is_given_by_its_hash(served: Served, tmp_path: Path) -> None:
    data = b"\xff\xd8 a photograph"
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "1.jpg").write_bytes(data)
    sha256 = hashlib.sha256(data).hexdigest()
    assert served.get(f"/photographs/{sha256}")[0] == 404
    served.photographs.announce(announced("frames/1.jpg", data, 1))
    status, headers, body = served.get(f"/photographs/{sha256}")
    assert (status, headers["content-type"], body) == (200, "image/jpeg", data)
    for path in ("/photographs/..%2f..%2fetc%2fpasswd", "/photographs/", "/photographs/" + 64 * "z"):
        assert served.get(path)[0] == 404


def test_a_stream_begins_with_what_is_and_follows_what_comes(served: Served) -> None:
    served.server.tell(b"1")
    served.wait(lambda: served.get("/api/state")[2] == b"1")
    with served.stream() as answer:
        assert answer.getheader("content-type") == "text/event-stream; charset=utf-8"
        assert event(answer) == b"1"
        served.server.tell(b"2")
        assert event(answer) == b"2"


def test_one_page_too_many_is_asked_to_come_later_and_let_in_when_another_has_gone(served: Served) -> None:
    with served.stream() as first:
        event(first)
        with served.stream() as second:
            event(second)
            status, headers, body = served.get("/api/events")
            assert (status, headers["retry-after"], body.count(b"\n")) == (503, "30", 1)
            assert served.get("/api/state")[0] == 200
        served.server.tell(b"3")

    def is_let_in() -> bool:
        with served.stream() as answer:
            return answer.status == 200

    served.wait(is_let_in)


def test_it_ends_at_once_though_pages_are_open(tmp_path: Path) -> None:
    served = Served(tmp_path)
    with served.stream() as answer:
        event(answer)
        began_s = time.monotonic()
        served.server.stop()
        assert time.monotonic() - began_s < 3.0
        assert answer.read() in (b"", b": alive\n\n")
    with pytest.raises(OSError):
        served.get("/")
    with pytest.raises(RuntimeError, match="has ended"):
        served.server.check()
    served.server.tell(b"nobody hears it")


def test_a_server_that_hangs_is_noticed(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flora_dashboard.server.SILENT_CHECKS", 2)
    served.server.check()
    served.wait(lambda: served.server._unanswered == 0)
    release = threading.Event()
    loop = served.server._loop
    assert loop is not None
    loop.call_soon_threadsafe(release.wait)
    assert [served.server.check(), served.server.check()] == ["", ""]
    try:
        with pytest.raises(RuntimeError, match="no sign"):
            served.server.check()
    finally:
        release.set()


def test_a_server_that_answers_while_it_is_asked_is_asked_again(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was not: its answer came before it was noted that it had been asked, and six checks later it had none."""
    asked: list[int] = []

    def at_once(answer: Callable[[], None]) -> None:
        asked.append(1)
        answer()

    assert served.server._loop is not None
    monkeypatch.setattr(served.server._loop, "call_soon_threadsafe", at_once)
    for _ in range(SILENT_CHECKS + 2):
        served.server.check()
    assert len(asked) == SILENT_CHECKS + 2
    monkeypatch.undo()


def test_who_asks_for_signs_may_stand_still_and_all_of_the_process_with_it(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = served.server._loop
    assert loop is not None
    release = threading.Event()
    loop.call_soon_threadsafe(release.wait)
    try:
        assert served.server.check() == ""
        later = SimpleNamespace(monotonic=lambda: time.monotonic() + 3600.0, sleep=time.sleep)
        monkeypatch.setattr("flora_dashboard.server.time", later)  # slept, or was stopped
        assert served.server.check() == ""  # the thread has not had its turn yet
    finally:
        release.set()
    served.wait(lambda: served.server._unanswered == 0)


def test_a_connection_that_asks_for_nothing_is_closed_and_one_that_did_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flora_dashboard.server.REQUEST_WITHIN_S", 0.3)
    served = Served(tmp_path)
    try:
        served.server.tell(b"{}")
        with served.stream() as answer, socket.create_connection(("127.0.0.1", served.port), WITHIN_S) as idle:
            event(answer)
            idle.sendall(b"GET / HT")
            assert idle.recv(100) == b""
            served.server.tell(b'{"still": "there"}')
            while event(answer) != b'{"still": "there"}':
                pass
    finally:
        served.server.stop()


@pytest.mark.parametrize("drip", [False, True])
def test_half_a_second_request_is_not_waited_for_without_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, drip: bool
) -> None:
    monkeypatch.setattr("flora_dashboard.server.REQUEST_WITHIN_S", 0.5)
    served = Served(tmp_path)
    try:
        with socket.create_connection(("127.0.0.1", served.port), WITHIN_S) as half:
            for _ in range(3):  # a connection that goes on asking is kept
                half.sendall(b"HEAD /nothing HTTP/1.1\r\nHost: x\r\n\r\n")
                assert b"404" in half.recv(1000)
                time.sleep(0.25)
            half.sendall(b"GET / HT")
            half.settimeout(0.1 if drip else WITHIN_S)
            end_s = time.monotonic() + WITHIN_S
            while True:
                assert time.monotonic() < end_s, "still open"
                try:
                    assert half.recv(100) == b""
                    break
                except TimeoutError:
                    half.sendall(b"x")
                except (ConnectionResetError, BrokenPipeError):
                    break
    finally:
        served.server.stop()


def test_connections_for_which_there_is_no_descriptor_are_counted_and_told_once(served: Served) -> None:
    loop = served.server._loop
    assert loop is not None
    told: list[dict[str, object]] = []
    for _ in range(70):
        loop.call_soon_threadsafe(
            loop.call_exception_handler,
            {"message": "accept", "exception": OSError(errno.EMFILE, "Too many")},
        )
    loop.call_soon_threadsafe(lambda: told.append({}))
    served.wait(lambda: bool(told))
    assert served.server.check() == "70 connections refused: too many are open"
    assert served.server.check() == ""


def test_an_address_that_is_taken_or_not_ours_is_told_in_a_line() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(ConfigError, match=r"cannot listen at 127.0.0.1 port \d+ \(Address already in use\)"):
            listen("127.0.0.1", other.getsockname()[1])
    with pytest.raises(ConfigError, match="host no such host"):
        listen("no such host", 0)


@pytest.mark.parametrize(("host", "shown"), [("127.0.0.1", "127.0.0.1"), ("0.0.0.0", "127.0.0.1")])
def test_its_address_is_one_that_a_browser_takes(host: str, shown: str) -> None:
    listener = listen(host, 0)
    assert url_of(listener) == f"http://{shown}:{listener.getsockname()[1]}/"
    listener.close()


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_the_page_s_scripts_can_be_read_and_its_axes_have_round_numbers() -> None:
    for script in PAGE.glob("*.js"):
        checked = subprocess.run(
            ["node", "--input-type=module", "--check"], input=script.read_text(), capture_output=True, text=True
        )
        assert checked.returncode == 0, checked.stderr
    program = (
        f"import {{ ticks, tickText, pathOf }} from '{(PAGE / 'svg.js').as_uri()}';"
        "console.log(JSON.stringify([ticks(0, 20, 5), ticks(-7.3, 2.1, 3), ticks(0, 0.5, 4),"
        " tickText(-2.5), tickText(0.30000000000000004), pathOf([[1, 2], [3.25, 4]])]))"
    )
    done = subprocess.run(["node", "--input-type=module", "-e", program], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == [
        [0, 5, 10, 15, 20],
        [-5, 0],
        [0, 0.2, 0.4],
        "\N{MINUS SIGN}2.5",
        "0.3",
        "M1.0 2.0L3.3 4.0",
    ]
