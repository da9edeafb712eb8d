"""A Pi in a folder, where all is well until a test spoils it, and what the doctor finds there."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from flora_common.config import RigSection
from flora_common.health import Line, services_of_catalogue
from flora_monitor.doctor import Finding, examine, take_case
from flora_monitor.doctor_case import Heard
from flora_monitor.doctor_units import TARGET
from flora_monitor.doctor_world import Account, Done, Room, World

SERVICES = services_of_catalogue()
FLORA = Account("flora", 4141, os.getgid(), frozenset({os.getgid()}))
"""Opens what the group of whoever runs the tests may open."""
STRANGER = Account("flora", 4242, 4242, frozenset({4242}))
ROOT = Account("root", 0, 0, frozenset({0}))
RUN = "/var/lib/flora/runs/bean"
GOOD = Done(0, "", "")
RUN_TOML = """
plant = "Saxa"
interval_s = 300.0
[camera]
anchor_px = [820.0, 984.0]
px_per_cm = 18.4
width_px = 1640
height_px = 1232
"""
PI_CONFIG = {
    "flora-capture": '[capture]\nbackend = "picamera2"\nsource = "0"\n',
    "flora-led": '[led]\nbackend = "neopixel"\npin = "D18"\n',
    "flora-flash": '[flash]\nbackend = "gpio"\nchip = "/dev/gpiochip0"\nline = 17\n',
    "flora-uploader": '[uploader]\ntarget = "/mnt/nas"\nmarker = ".flora-nas"\n',
    "flora-controller": '[controller]\nuse = "waypoint"\ntrust = "if-signed"\nkeys_dir = "/etc/flora/keys"\n',
}


def line_of(service: str, state: str = "ready", reason: str = "") -> Line:
    return Line(service, state, reason, 1.0, 100.0, 50_000, 0, 0, ok=state == "ready")


class Pi:
    """A machine in a folder: files as a Pi has them, child processes that answer as one's would."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.rig = RigSection(run_dir=RUN)
        self.heard = Heard(True, tuple(map(line_of, SERVICES)))
        self.is_synchronised = True
        self.room = Room(20_000_000_000, False, 1)
        self.accounts = {"flora": FLORA, "root": ROOT}
        self.me = ROOT
        self.touch = False
        self.asked: list[tuple[list[str], Account | None]] = []
        self.printed = dict(PI_CONFIG)
        self.units = {f"{name}.service": self.unit(name) for name in SERVICES} | {
            TARGET: {"LoadState": "loaded", "UnitFileState": "enabled", "ActiveState": "active"}
            | {"Wants": " ".join(f"{name}.service" for name in SERVICES)}
        }
        self.answers: dict[str, Done] = {
            "picamera2": Done(0, '["imx219"]\n', ""),
            "neopixel": Done(0, "true\n", ""),
            "gpiod": Done(0, '{"label": "pinctrl-bcm2711", "name": "GPIO17", "used": false, "by": ""}\n', ""),
            "import_module": Done(0, '{"python": "3.11.2", "learning": [], "journal": true}\n', ""),
            "doctor_nas": Done(0, '{"free_bytes": 900000000000, "device": 2}\n', ""),
            "vcgencmd": Done(0, "throttled=0x0\n", ""),
        }
        self.write("/proc/device-tree/model", "Raspberry Pi 4 Model B Rev 1.5\0")
        self.write("/proc/meminfo", "MemTotal:        3884000 kB\nMemAvailable:    2900000 kB\n")
        self.write("/proc/modules", "v4l2 1 0 - Live\n")
        self.write("/proc/self/mountinfo", "30 1 179:2 / / rw,noatime shared:1 - ext4 /dev/mmcblk0p2 rw\n")
        self.write("/boot/firmware/config.txt", "camera_auto_detect=1\n")
        self.write("/sys/fs/ext4/mmcblk0p2/errors_count", "0\n")
        self.write(f"{RUN}/run.toml", RUN_TOML)
        self.write(f"{RUN}/background/dark.jpg", "")
        self.write("/etc/flora/flora.toml", "")
        self.write("/etc/systemd/journald.conf.d/99-flora.conf", "[Journal]\nStorage=persistent\n")
        for device in ("/dev/gpiochip0", "/dev/mem", "/dev/media0", "/dev/video0"):
            self.write(device, "").chmod(0o660)
        (root / RUN.lstrip("/")).chmod(0o770)
        (root / "run/systemd/system").mkdir(parents=True)

    @staticmethod
    def unit(name: str) -> dict[str, str]:
        user = "root" if name == "flora-led" else "flora"
        return {"LoadState": "loaded", "UnitFileState": "enabled", "ActiveState": "active", "User": user} | {
            "ProtectSystem": "strict", "ProtectHome": "yes", "ReadWritePaths": "/var/lib/flora -/mnt",
        }  # fmt: skip

    def write(self, path: str, text: str) -> Path:
        file = self.root / path.lstrip("/")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        return file

    def run(self, command: Sequence[str], *, account: Account | None = None) -> Done:
        self.asked.append((list(command), account))
        program = Path(command[0]).name
        if command[-1] == "--print-config":
            printed = self.printed.get(program, "")
            return Done(2, "", printed) if printed.startswith(f"{program}: ") else Done(0, printed, "")
        if program == "systemctl":
            blocks = [{"Id": name} | unit for name, unit in self.units.items()]
            return Done(0, "\n\n".join("\n".join(f"{k}={v}" for k, v in block.items()) for block in blocks), "")
        said = " ".join(command)
        return next((answer for key, answer in self.answers.items() if key in said), GOOD)

    def findings(self, python: str = "/opt/flora/releases/1/bin/python") -> dict[str, Finding]:
        world = World(
            root=self.root,
            me=self.me,
            run=self.run,
            lookup=lambda name, groups: self.accounts.get(name),
            room=lambda path: self.room,
            is_synchronised=lambda: self.is_synchronised,
            python=Path(python),
        )
        case = take_case(world, self.rig, None, SERVICES, self.heard, touch=self.touch)
        return {finding.part: finding for finding in examine(case)}
