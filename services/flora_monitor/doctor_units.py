"""What systemd says of the services: as whom they run, what they may write, whether they start by themselves."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

from flora_monitor.doctor_world import Account, NotLookedAt, NotUsed, World, Wrong

TARGET: Final = "flora-rig.target"
BOOTED: Final = "/run/systemd/system"
"""There where systemd runs the machine (sd_booted(3))."""
STARTS_BY_ITSELF: Final = frozenset({"enabled", "enabled-runtime", "static", "alias", "generated"})
PROPERTIES: Final = (
    "Id", "LoadState", "UnitFileState", "ActiveState", "Wants", "User", "SupplementaryGroups", "ProtectSystem",
    "ProtectHome", "ReadWritePaths", "StateDirectory", "DevicePolicy", "DeviceAllow",
)  # fmt: skip
DEVICE_CLASSES: Final = {"gpiochip": "char-gpiochip", "spidev": "char-spi", "video": "char-video4linux"}
"""Device files that a unit may allow by the name of their driver in /proc/devices."""
HOMES: Final = ("/home", "/root", "/run/user")
MANUAL: Final = "docs/how-to/first-start.md"
INSTALLING: Final = "docs/how-to/install-on-a-pi.md"


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit as ``systemctl show`` tells it; every property as text."""

    properties: dict[str, str]

    def __getitem__(self, name: str) -> str:
        return self.properties.get(name, "")

    @property
    def name(self) -> str:
        return self["Id"]

    @property
    def is_loaded(self) -> bool:
        return self["LoadState"] == "loaded"

    def may_write(self, path: Path) -> bool:
        """Whether the sandbox leaves a folder writable; what the disk itself allows is another question."""
        of_unit = [f"/var/lib/{name}" for name in self["StateDirectory"].split()]
        of_unit += [entry.lstrip("-+") for entry in self["ReadWritePaths"].split()]
        if any(PurePosixPath(path).is_relative_to(folder) for folder in of_unit):
            return True
        if self["ProtectHome"] in ("yes", "read-only", "tmpfs") and any(path.is_relative_to(home) for home in HOMES):
            return False
        return self["ProtectSystem"] != "strict"

    def may_open(self, device: str) -> bool:
        """Whether the sandbox lets the service at a device file; its permissions are another question."""
        allowed = self["DeviceAllow"].split()
        if self["DevicePolicy"] in ("", "auto") and not allowed:
            return True
        kind = re.match(r"/dev/([a-z]+)", device)
        return device in allowed or (kind is not None and DEVICE_CLASSES.get(kind[1]) in allowed)


Units = dict[str, Unit]


def read_units(world: World, services: Sequence[str]) -> Units:
    """The target and each service's unit, by the name without ``.service``; empty where systemd does not run here."""
    if not world.at(BOOTED).is_dir():
        return {}
    names = [TARGET, *(f"{service}.service" for service in services)]
    done = world.run(["systemctl", "show", f"--property={','.join(PROPERTIES)}", *names])
    if not done.is_good:
        return {}
    units = [Unit(_properties(block)) for block in done.out.split("\n\n")]
    return {unit.name.removesuffix(".service"): unit for unit in units if unit.name}


def _properties(block: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for line in block.splitlines():
        name, _, value = line.partition("=")
        found[name] = f"{found[name]} {value}" if name in found else value  # DeviceAllow= has a line for each device
    return found


def account_of(world: World, unit: Unit | None) -> Account:
    """Whom a service runs as: what its unit says, or whoever asks where there is none.

    Raises:
        NotLookedAt: the machine has no such user.
    """
    if unit is None or not unit.is_loaded:
        return world.me
    user = unit["User"] or "root"
    found = world.lookup(user, unit["SupplementaryGroups"].split())
    if found is None:
        raise NotLookedAt(f"{unit.name} runs as user `{user}`, whom this machine does not have")
    return found


def check_units(world: World, units: Units, services: Sequence[str]) -> str:
    """Every unit is there, the target starts them at boot, and none has failed."""
    if not world.at(BOOTED).is_dir():
        raise NotUsed("systemd does not run this machine")
    if not units:
        raise NotLookedAt("systemctl does not answer")
    missing = [s for s in (TARGET, *services) if s not in units or units[s]["LoadState"] == "not-found"]
    if missing:
        raise Wrong(f"not installed: {', '.join(missing)}; `make install-rig` brings the units ({INSTALLING})")
    problems = []
    for name, unit in units.items():
        if not unit.is_loaded:
            problems.append(
                f"{unit.name} is {unit['LoadState']}: systemctl unmask or mend it (systemctl status {name})"
            )
        elif unit["ActiveState"] == "failed":
            problems.append(f"{unit.name} has failed: journalctl -u {name}")
        elif name != TARGET and world.lookup(unit["User"] or "root", ()) is None:
            problems.append(f"{unit.name} runs as user `{unit['User']}`, whom this machine does not have")
    target = units[TARGET]
    unwanted = [s for s in services if f"{s}.service" not in target["Wants"].split()]
    if unwanted:
        problems.append(f"{TARGET} does not start {', '.join(unwanted)}: sudo systemctl enable {' '.join(unwanted)}")
    if target["UnitFileState"] not in STARTS_BY_ITSELF:
        problems.append(f"{TARGET} does not start at boot: sudo systemctl enable {TARGET}")
    if problems:
        raise Wrong("; ".join(problems))
    active = sum(units[s]["ActiveState"] == "active" for s in services)
    return f"{TARGET} starts {len(services)} services at boot, {active} are active now"
