"""A bus over TCP with keys, for tests: real files, a real flora-bus, clients with whatever keys they show."""

from __future__ import annotations

import contextlib
import select
import shutil
import socket
import subprocess
import threading
from pathlib import Path
from typing import Any, Self

from flora_common.bus import BusAddress, BusClient
from flora_common.bus_keys import BUS, CLIENT, ClientKeys, client_keys, make_authorized, make_pair
from flora_common.clock import SystemClock
from flora_common.messages import Tick


class NetworkBus:
    """The rig's own services by ``ipc://``, as ever; others at two ports, with keys.

    Args:
        bus: the test's private bus, not yet started.
    """

    def __init__(self, bus: Any) -> None:
        self.bus = bus
        self.folder: Path = bus.folder / "rig-keys"
        make_pair(self.folder, BUS)
        self.authorized = make_authorized(self.folder)
        self.ports: list[int] = bus.free_ports(2)
        self.address = BusAddress(*(f"tcp://127.0.0.1:{port}" for port in self.ports))
        bus.sections["rig"]["bus_keys"] = str(self.folder)
        bus.sections["bus"] = {"network_publish": self.address.publish, "network_subscribe": self.address.subscribe}

    def start(self) -> subprocess.Popen[str]:
        process: subprocess.Popen[str] = self.bus.start_service("flora-bus")
        return process

    def keys_of(self, name: str, *, is_known: bool = True) -> Path:
        """A machine's folder of keys, with the bus's public one."""
        folder: Path = self.bus.folder / f"{name}-keys"
        _, public = make_pair(folder, CLIENT)
        shutil.copy(self.folder / "bus.pub", folder)
        if is_known:
            self.admit(name, public)
        return folder

    def admit(self, name: str, public: Path) -> None:
        shutil.copy(public, self.authorized / f"{name}.pub")

    def client(self, keys: ClientKeys | Path | None, source: str = "far") -> BusClient:
        """Someone at the ports, who need not get in."""
        shown = client_keys(keys) if isinstance(keys, Path) else keys
        address = BusAddress(self.address.publish, self.address.subscribe, shown)
        client = BusClient(address, rig="test", source=source, clock=SystemClock())
        client.subscribe_prefixes(b"")
        self.bus.clients.append(client)
        client.connect()
        return client

    def config_of(self, keys: Path | None) -> Path:
        """A configuration for the commands of another machine."""
        path: Path = self.bus.folder / "lab.toml"
        with_keys = f'bus_keys = "{keys}"\n' if keys else ""
        path.write_text(
            f'[rig]\nname = "test"\nstate_dir = "{self.bus.folder}/lab-state"\nrun_dir = "{self.bus.run_dir}"\n'
            f'bus_publish = "{self.address.publish}"\nbus_subscribe = "{self.address.subscribe}"\n{with_keys}'
        )
        return path


def ticks(heard: list[Any]) -> list[int]:
    return [a.message.tick for a in heard if isinstance(a.message, Tick)]


def until_heard(net: NetworkBus, listener: BusClient, speaker: BusClient, tick: int) -> None:
    """As two loops do: what was said into a line that was already dead is said again when the speaker has noticed."""

    def is_heard(heard: list[Any]) -> bool:
        speaker.handle_publisher()
        return tick in ticks(heard)

    net.bus.hear(listener, is_heard)


class Line:
    """A network cable to a port of this machine, which can go dead: nothing comes through, and nobody hangs up."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._door = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp://127.0.0.1:{self._door.getsockname()[1]}"
        self._other: dict[socket.socket, socket.socket] = {}
        self._dead: list[socket.socket] = []
        self._is_to_die = threading.Event()
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._carry)

    def go_dead(self) -> None:
        """The connections that there are; later ones are alive."""
        self._is_to_die.set()
        while self._is_to_die.is_set():
            self._is_over.wait(0.01)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._thread.join()
        for each in (self._door, *self._other, *self._dead):
            each.close()

    def _carry(self) -> None:
        while not self._is_over.is_set():
            if self._is_to_die.is_set():
                self._dead += self._other
                self._other.clear()
                self._is_to_die.clear()
            for ready in select.select([self._door, *self._other], [], [], 0.02)[0]:
                if ready is self._door:
                    near = self._door.accept()[0]
                    far = socket.create_connection(("127.0.0.1", self._port))
                    self._other |= {near: far, far: near}
                elif ready in self._other:
                    self._pass_on(ready)

    def _pass_on(self, ready: socket.socket) -> None:
        with contextlib.suppress(OSError):
            data = ready.recv(65536)
            if data:
                self._other[ready].sendall(data)
                return
        other = self._other.pop(ready)
        self._other.pop(other, None)
        ready.close()
        other.close()
