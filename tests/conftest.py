"""A bus of its own for each test: services as real processes, private sockets, nothing left behind."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import tomli_w
import zmq

from file_order import spread
from flora_common.bus import Arrival, BusAddress, BusClient
from flora_common.clock import SystemClock
from flora_common.messages import Health
from made_once import Folder

# Read once per process, by whichever test opens a film first: the library is not to write beside a command's one line.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
# Small matrices in two threads that wait for each other take fifty times as long where something else runs beside.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Started in the background of a script, a process ignores Ctrl-C, and so does all that it starts: tests of Ctrl-C would
# wait for ever.
signal.signal(signal.SIGINT, signal.default_int_handler)

COMMANDS = Path(sys.executable).parent
DEADLINE_S = 20.0
SLOW_TIMEOUT_S = 3600.0


EVOLUTION = ("test_evolve_", "test_evaluate_", "test_paper_", "test_diagnose_controllers")
"""Files in which populations are evaluated."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """File by file; but what takes long to compile goes to one process, so that only that one does."""
    from xdist.scheduler import LoadFileScheduling

    class ByCompiledCode(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = str(super()._split_scope(nodeid))
            if file.startswith("tests/discovery/"):
                return "worlds"
            return "evolution" if Path(file).name.startswith(EVOLUTION) else file

    return ByCompiledCode(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Those that take minutes may; those that wait come among those that work."""
    for item in items:
        if item.get_closest_marker("slow") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(SLOW_TIMEOUT_S))
    items[:] = spread(items, lambda item: item.path)


@pytest.fixture(scope="session", autouse=True)
def _made_once(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Processes of one run share what took long to make."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        Folder.path = tmp_path_factory.getbasetemp().parent


class PrivateBus:
    """Sockets, folders and a configuration file of one test; processes end with it."""

    def __init__(self, folder: Path, sockets: Path) -> None:
        self.folder = folder
        self.address = BusAddress(f"ipc://{sockets}/pub", f"ipc://{sockets}/sub")
        self.run_dir = folder / "run"
        self.sections: dict[str, dict[str, object]] = {
            "rig": {
                "name": "test",
                "run_dir": str(self.run_dir),
                "state_dir": str(folder / "state"),
                "bus_publish": self.address.publish,
                "bus_subscribe": self.address.subscribe,
                "health_every_s": 0.2,
            }
        }
        self.processes: list[subprocess.Popen[str]] = []
        self.clients: list[BusClient] = []
        self._reserved: list[socket.socket] = []
        self._started_ns: dict[str, int] = {}

    @property
    def config(self) -> Path:
        """The configuration file, written anew each time."""
        path = self.folder / "flora.toml"
        path.write_text(tomli_w.dumps(self.sections), encoding="utf-8")
        return path

    def free_ports(self, count: int) -> list[int]:
        """Ports of 127.0.0.1 that nobody is given before the test has ended; whoever names one may listen there."""
        reserved = [socket.socket() for _ in range(count)]
        self._reserved += reserved
        for each in reserved:
            # Bound until then, never listening: with this option on both sides a listener gets the port all the same.
            each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            each.bind(("127.0.0.1", 0))
        return [int(each.getsockname()[1]) for each in reserved]

    def start(self, command: str, *arguments: str, env: dict[str, str] | None = None) -> subprocess.Popen[str]:
        """A process of ours: an installed command, or a script."""
        program = [sys.executable, command] if command.endswith(".py") else [str(COMMANDS / command)]
        self._started_ns[command] = SystemClock().mono_ns()
        process = subprocess.Popen(
            [*program, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1", **(env or {})},
        )
        self.processes.append(process)
        return process

    def start_service(self, command: str, *arguments: str, env: dict[str, str] | None = None) -> subprocess.Popen[str]:
        """A service with this test's configuration."""
        return self.start(command, "--config", str(self.config), *arguments, env=env)

    def client(self, source: str = "flora-test", *, prefixes: tuple[bytes, ...] = (b"",)) -> BusClient:
        """A participant that hears everything (unless told) and is connected."""
        client = BusClient(self.address, rig="test", source=source, clock=SystemClock())
        client.subscribe_prefixes(*prefixes)
        self.clients.append(client)
        client.connect()
        self.hear(client, lambda _: client.connected)
        return client

    def hear(
        self, client: BusClient, until: Callable[[list[Arrival]], bool], *, deadline_s: float = DEADLINE_S
    ) -> list[Arrival]:
        """Receive until a condition on all that came holds; what came after that is left for the next time."""
        poller = zmq.Poller()
        poller.register(client.subscriber, zmq.POLLIN)
        poller.register(client.publisher, zmq.POLLIN)
        heard: list[Arrival] = []
        end_s = time.monotonic() + deadline_s
        while not until(heard):
            left_s = end_s - time.monotonic()
            assert left_s > 0, f"not heard in {deadline_s} s; heard: {heard[-5:]}; {self.what_they_said()}"
            poller.poll(max(1, round(min(left_s, 1.0) * 1000)))
            client.handle_publisher()
            heard += client.receive_all(1)
        return heard

    def wait_ready(self, client: BusClient, *services: str) -> None:
        """Until each of these says that it is ready: the last that was started, not one before it."""
        missing = set(services)

        def all_ready(heard: list[Arrival]) -> bool:
            for arrival in heard:
                said = arrival.message
                # What one that was ended had still said may be read only when the next one has been started.
                if (
                    isinstance(said, Health)
                    and said.state == "ready"
                    and said.t_mono_ns >= self._started_ns.get(said.source, 0)
                ):
                    missing.discard(said.source)
            return not missing

        self.hear(client, all_ready)

    def what_they_said(self) -> str:
        """What ended processes left on stderr."""
        ended = [p for p in self.processes if p.poll() is not None and p.stderr and not p.stderr.closed]
        return "; ".join(f"{p.args} ended {p.returncode}: {p.stderr.read()[-2000:]}" for p in ended if p.stderr)

    def stop(self, process: subprocess.Popen[str]) -> tuple[int, str, str]:
        """SIGTERM; returns (status, stdout, stderr)."""
        process.terminate()
        out, err = process.communicate(timeout=DEADLINE_S)
        return process.returncode, out, err

    def close(self) -> None:
        for client in self.clients:
            client.close()
        for process in self.processes:
            if process.poll() is None:
                process.kill()
            process.communicate()
        for reserved in self._reserved:
            reserved.close()


@pytest.fixture
def bus(tmp_path: Path) -> Iterator[PrivateBus]:
    """A private bus, not yet started."""
    # Socket paths have to be short (107 bytes), and pytest's folders are not.
    with tempfile.TemporaryDirectory(prefix="flora-") as sockets:
        private = PrivateBus(tmp_path, Path(sockets))
        try:
            yield private
        finally:
            private.close()
