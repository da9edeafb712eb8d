"""A rig on a booted machine, installed and looked at as people do it, and the table of what was seen."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import tomli_w
from booted import Box, Machine

from flora_common.runs import RunFile, run_file_text
from flora_twin.box import camera_section
from flora_twin.rig.layout import with_task

ROOT = Path(__file__).parents[2]
SERVICES = (
    "flora-bus",
    "flora-flash",
    "flora-capture",
    "flora-stem",
    "flora-controller",
    "flora-led",
    "flora-uploader",
    "flora-recorder",
    "flora-dashboard",
)
RUN = "bean-01"
INSTALLED_WITHIN_S = 480.0
BOX_UNIT = """
[Unit]
Description=virtual grow box
Before=flora-bus.service
[Service]
Type=notify
ExecStart=/opt/flora/current/bin/flora-twin serve --config /etc/flora/flora.toml
User=flora
UMask=0007
Restart=always
[Install]
WantedBy=multi-user.target
"""
RATE = 60.0
"""Five minutes of the plant pass in five seconds."""


class Table:
    """What was seen, a line each, in the order of the tests."""

    def __init__(self) -> None:
        self._rows: list[tuple[str, str]] = []

    def add(self, what: str, figure: str) -> None:
        self._rows.append((what, figure))

    def print(self) -> None:
        width = max((len(what) for what, _ in self._rows), default=0)
        print("\n\n" + "\n".join(f"{what:{width}}  {figure}" for what, figure in self._rows))


class Rig:
    """A booted machine, to be installed on as people do it.

    Attributes:
        source: a copy of this checkout, which stays as it is while tests run.
    """

    def __init__(self, machine: Machine, folder: Path) -> None:
        self.machine = machine
        self.box = Box(machine)
        self.source = self.copy_source(folder / "source")

    @staticmethod
    def copy_source(folder: Path, of: Path = ROOT) -> Path:
        """What an installation is made from."""
        folder.mkdir()
        for name in ("pyproject.toml", "README.md"):
            shutil.copy(of / name, folder)
        for name in ("common", "services", "systemd", "deploy"):
            shutil.copytree(of / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        return folder

    def changed_copy(self, folder: Path, file: str, old: str, new: str) -> Path:
        """A checkout that differs in one place."""
        copy = self.copy_source(folder, self.source)
        text = (copy / file).read_text()
        assert old in text
        (copy / file).write_text(text.replace(old, new, 1))
        return copy

    def broken_copy(self, folder: Path, why: str) -> Path:
        """A checkout whose flora-led loads, reads its configuration, and dies when it starts to work."""
        line = "def build(app: App[LedSection]) -> None:\n"
        return self.changed_copy(folder, "services/flora_led/main.py", line, f'{line}    raise RuntimeError("{why}")\n')

    def install(self, source: Path | None = None, *options: str) -> subprocess.CompletedProcess[str]:
        """What ``make install-rig`` runs."""
        command = [sys.executable, str((source or self.source) / "deploy/install_rig.py"), *options, "root@127.0.0.1"]
        environment = self.machine.environment
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=INSTALLED_WITHIN_S)
        print(f"\n{done.stdout}{done.stderr}", end="")
        return done

    def current(self) -> str:
        """The release that runs."""
        return self.machine.run("readlink", "/opt/flora/current").stdout.strip().removeprefix("releases/")

    def prepare_run(self) -> None:
        """Configuration, run folder, NAS and virtual box, as somebody would make them by hand."""
        sections = {
            "rig": {"run_dir": f"/var/lib/flora/runs/{RUN}", "health_every_s": 2.0, "clock": {"kind": "twin"}},
            "flash": {"backend": "virtual", "wait_for_background": True},
            "capture": {"backend": "virtual"},
            "led": {"backend": "virtual", "fallback": "open-loop"},
            "controller": {"use": "waypoint", "task": "any"},
            "uploader": {"target": "/srv/nas"},
            "twin": {"rate": RATE, "planted": False},
        }
        machine = self.machine
        machine.write("/etc/flora/flora.toml", tomli_w.dumps(sections))
        run_file = with_task(RunFile(camera=camera_section(), rig="box1", plant="virtual bean"))
        machine.write(f"/var/lib/flora/runs/{RUN}/run.toml", run_file_text(run_file))
        machine.write("/srv/nas/.flora-nas", "")
        machine.write("/etc/systemd/system/virtual-box.service", BOX_UNIT)
        machine.run("chown", "-R", "flora:flora", "/var/lib/flora/runs", "/srv/nas")
        machine.run("systemctl", "daemon-reload")
        machine.run("systemctl", "enable", "--now", "virtual-box.service")

    def are_ready(self, services: tuple[str, ...] = SERVICES) -> bool:
        """Whether all of these run and have said READY."""
        names = [f"{service}.service" for service in services]
        done = self.machine.run("systemctl", "is-active", *names, check=False)
        return done.stdout.split() == ["active"] * len(services)

    def are_stopped(self, services: tuple[str, ...] = SERVICES) -> bool:
        done = self.machine.run("systemctl", "is-active", *(f"{service}.service" for service in services), check=False)
        return done.stdout.split() == ["inactive"] * len(services)

    def wait_ready(self, within_s: float = 60.0) -> float:
        """Wait for all services; returns for how many seconds."""
        try:
            return self.machine.wait(self.are_ready, within_s=within_s, what="all services ready")
        except AssertionError as problem:
            units = (f"{service}.service" for service in SERVICES)
            said = self.machine.run("systemctl", "status", "--no-pager", "--lines", "8", *units, check=False).stdout
            raise AssertionError(f"{problem}:\n{said}") from problem

    def wait_lit(self) -> None:
        self.machine.wait(lambda: self.box.are_lamps_lit, within_s=90.0, what="a lamp lit")
