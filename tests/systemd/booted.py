"""A Debian that is booted by its own systemd in a container, with an sshd: as near to a Pi as a build machine comes.

The tree is made once by debootstrap, in a cache folder outside the repository; a test session works in an overlay above
it, so that each begins with the same empty machine and leaves nothing behind.
"""

from __future__ import annotations

import io
import json
import os
import shlex
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from debian_trees import NotHere, cached_tree, must_run, packages_lacking

RELEASE: Final = os.environ.get("FLORA_DEBIAN", "bookworm")
"""As Raspberry Pi OS is named after it; the other one that is supported is `trixie`."""
MIRROR: Final = "http://deb.debian.org/debian"
PACKAGES: Final = (
    "systemd",
    "systemd-sysv",
    "dbus",
    "libpam-systemd",
    "openssh-server",
    "sudo",
    "ca-certificates",
    "python3",
    "python3-venv",
    "python3-dev",
    "gcc",
)
"""Of what a Raspberry Pi OS Lite has. python3-systemd is left out: the installation must bring it."""
MACHINE: Final = "flora-test-rig"
BOOTED_WITHIN_S: Final = 90.0
AT_REST_WITHIN_S: Final = 400.0
"""With what starts at boot. From systemd 254 on, that waits until a service that dies again and again has failed."""
TOOLS: Final = {
    "systemd-nspawn": "systemd-container",
    "debootstrap": "debootstrap",
    "nsenter": "util-linux",
    "ssh": "openssh-client",
    "ssh-keygen": "openssh-client",
}


def why_not() -> str:
    """Why no tree can be booted here; empty where it can be tried."""
    if os.geteuid() != 0:
        return "booting a tree under systemd-nspawn takes root"
    if lacking := packages_lacking(TOOLS):
        return f"booting a tree takes these packages: apt-get install {lacking}"
    return ""


def debian() -> Path:
    """The tree that every session begins with.

    Raises:
        NotHere: it cannot be made.
    """
    include = f"--include={','.join(PACKAGES)}"
    return cached_tree(
        f"debian-{RELEASE}",
        [RELEASE, *PACKAGES],
        lambda tree: must_run(["debootstrap", "--variant=minbase", include, RELEASE, str(tree), MIRROR]),
    )


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


class Machine:
    """One machine on an overlay; it may be booted, switched off, have its power cut, and be booted again.

    Args:
        folder: for the overlay, the keys and the console's log.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.root = folder / "root"
        self.console = folder / "console.log"
        self.port = free_port()
        self.boot_s = 0.0
        self._nspawn: subprocess.Popen[bytes] | None = None
        self._leader = 0
        for name in ("upper", "work", "root", "bin"):
            (folder / name).mkdir()
        layers = f"lowerdir={debian()},upperdir={folder / 'upper'},workdir={folder / 'work'}"
        mounted = subprocess.run(
            ["mount", "-t", "overlay", "flora-test", "-o", layers, str(self.root)], capture_output=True, text=True
        )
        if mounted.returncode != 0:
            raise NotHere(f"no overlay can be mounted here: {mounted.stderr.strip()}")
        self._let_in()

    def _let_in(self) -> None:
        """A key for root, and a command ``ssh`` that uses it: what is tested finds it in PATH."""
        key = self.folder / "key"
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(key)], check=True)
        keys = self.root / "root/.ssh/authorized_keys"
        keys.parent.mkdir(mode=0o700, exist_ok=True)
        shutil.copy(key.with_suffix(".pub"), keys)
        ours = f"ListenAddress 127.0.0.1\nPort {self.port}\nUseDNS no\n"
        (self.root / "etc/ssh/sshd_config.d/test.conf").write_text(ours)
        config = self.folder / "ssh_config"
        config.write_text(
            f"Host *\nPort {self.port}\nIdentityFile {key}\nIdentitiesOnly yes\n"
            f"UserKnownHostsFile {self.folder / 'known_hosts'}\nStrictHostKeyChecking accept-new\nLogLevel ERROR\n"
        )
        command = self.folder / "bin" / "ssh"
        command.write_text(f'#!/bin/sh\nexec {shutil.which("ssh")} -F {config} "$@"\n')
        command.chmod(0o755)

    @property
    def environment(self) -> dict[str, str]:
        """For commands that are to reach this machine by ssh."""
        return os.environ | {"PATH": f"{self.folder / 'bin'}:{os.environ['PATH']}"}

    def boot(self) -> str:
        """Boot; returns what ``systemctl is-system-running`` says in the end.

        Raises:
            NotHere: it does not come up.
        """
        # On nobody's list and in nobody's slice: neither machined nor a systemd of the host is needed.
        command = ["systemd-nspawn", "--quiet", "--register=no", "--keep-unit", "--boot", f"--machine={MACHINE}"]
        # As on a Pi, so that the lamps' capability can be granted, and networks of one's own have a loopback.
        command += ["--capability=CAP_SYS_RAWIO,CAP_NET_ADMIN", "--link-journal=no", f"--directory={self.root}"]
        began_s = time.monotonic()
        with self.console.open("ab") as log:
            self._nspawn = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        try:
            self.wait(lambda: self._find_leader() and self._answers(), within_s=BOOTED_WITHIN_S, what="systemd")
        except AssertionError as problem:
            tail = self.console.read_text(errors="replace").strip().splitlines()[-1:]
            raise NotHere(f"the tree does not come up under systemd-nspawn ({problem}): {''.join(tail)}") from problem
        done = self.run("systemctl", "is-system-running", "--wait", check=False, within_s=AT_REST_WITHIN_S)
        said = done.stdout.strip()
        self.boot_s = time.monotonic() - began_s
        return said

    def _find_leader(self) -> bool:
        assert self._nspawn is not None
        if self._nspawn.poll() is not None:
            tail = self.console.read_text(errors="replace").strip().splitlines()[-1:]
            raise NotHere(f"systemd-nspawn ended with {self._nspawn.returncode}: {''.join(tail)}")
        children = Path(f"/proc/{self._nspawn.pid}/task/{self._nspawn.pid}/children").read_text().split()
        self._leader = int(children[0]) if children else 0
        return self._leader > 0

    def _answers(self) -> bool:
        return self.run("test", "-S", "/run/dbus/system_bus_socket", check=False).returncode == 0

    def power_off(self) -> int:
        """As a person does; returns the status of the container."""
        assert self._nspawn is not None
        self.run("systemctl", "poweroff", check=False)
        return self._nspawn.wait(timeout=BOOTED_WITHIN_S)

    def cut_power(self) -> None:
        """Every process at once, with nothing written down any more."""
        assert self._nspawn is not None
        os.kill(self._leader, signal.SIGKILL)
        self._nspawn.wait(timeout=30)

    def close(self) -> None:
        """Leave nothing behind."""
        if self._nspawn is not None and self._nspawn.poll() is None:
            self.cut_power()
        subprocess.run(["umount", "--recursive", str(self.root)], check=True)

    def run(self, *command: str, check: bool = True, within_s: float = 120.0) -> subprocess.CompletedProcess[str]:
        """A command on the machine, as root, past ssh."""
        # The control groups as they are: a command of ours must not die with a service.
        inside = ["nsenter", f"--target={self._leader}", "--mount", "--uts", "--ipc", "--pid", "--root", "--wd"]
        done = subprocess.run([*inside, *command], capture_output=True, text=True, timeout=within_s)
        if check:
            assert done.returncode == 0, f"{shlex.join(command)}: {done.returncode}\n{done.stdout}{done.stderr}"
        return done

    def file(self, path: str) -> Path:
        """A file of the machine as this one sees it."""
        if self._nspawn is not None and self._nspawn.poll() is None:
            return Path(f"/proc/{self._leader}/root") / path.lstrip("/")
        return self.root / path.lstrip("/")

    def write(self, path: str, text: str) -> None:
        self.file(path).parent.mkdir(parents=True, exist_ok=True)
        self.file(path).write_text(text)

    def show(self, unit: str, *properties: str) -> dict[str, str]:
        """Properties of a unit."""
        done = self.run("systemctl", "show", f"--property={','.join(properties)}", unit)
        return dict(line.partition("=")[::2] for line in done.stdout.splitlines() if "=" in line)

    def is_active(self, unit: str) -> bool:
        return self.run("systemctl", "is-active", unit, check=False).stdout.strip() == "active"

    def pid(self, service: str) -> int:
        """Of the main process, as the machine numbers it; 0 where it does not run."""
        return int(self.show(f"{service}.service", "MainPID")["MainPID"])

    def journal(self, *options: str) -> list[dict[str, Any]]:
        """Entries with all their fields."""
        done = self.run("journalctl", "--no-pager", "--output=json", "--all", *options)
        return [json.loads(line) for line in done.stdout.splitlines()]

    def wait(self, condition: Callable[[], object], *, within_s: float, what: str, every_s: float = 0.2) -> float:
        """Wait until something holds; returns for how many seconds."""
        began_s = time.monotonic()
        while not condition():
            if time.monotonic() - began_s > within_s:
                raise AssertionError(f"{what}: not within {within_s:g} s")
            time.sleep(every_s)
        return time.monotonic() - began_s


class Box:
    """What really shines in the virtual grow box of a machine: its own memory, written after every change."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine

    def _head(self) -> dict[str, Any]:
        data = self._machine.file("/var/lib/flora/state/twin/world.npz").read_bytes()
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            head: dict[str, Any] = json.loads(archive["head"].tobytes())
        return head

    @property
    def are_lamps_lit(self) -> bool:
        return any(level > 0.0 for lamp in self._head()["lamps"] for level in lamp)


def machine_or_skip(folder: Path) -> Machine:
    """A booted machine, or the reason why there is none."""
    reason = why_not()
    if reason:
        pytest.skip(reason)
    machine = None
    try:
        machine = Machine(folder)
        machine.boot()
    except NotHere as problem:
        if machine is not None:
            machine.close()
        pytest.skip(str(problem))
    return machine
