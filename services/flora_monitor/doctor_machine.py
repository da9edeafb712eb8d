"""The machine itself: clock, memory, power, what the services load, and whether its log outlasts a power cut."""

from __future__ import annotations

import re
from typing import Any, Final

from flora_monitor.doctor_case import Case
from flora_monitor.doctor_devices import pi_model
from flora_monitor.doctor_units import BOOTED
from flora_monitor.doctor_world import NotLookedAt, NotUsed, World, Wrong

SERVICES_MIB: Final = 400
"""All eight services with the camera process: 362 MiB resident were measured."""
SPARE_MIB: Final = 64
"""What should be left while they run: one photograph is 6 MB when it is unpacked."""
LEARNING: Final = ("torch", "neat", "numba", "scipy", "statsmodels", "matplotlib", "ray")

LOAD_SERVICES: Final = """
import importlib, importlib.util, json, platform, sys
for service in sys.argv[2:]:
    importlib.import_module(service.replace("-", "_") + ".main")
print(json.dumps({
    "python": platform.python_version(),
    "learning": [name for name in sys.argv[1].split(",") if name in sys.modules],
    "journal": all(importlib.util.find_spec(name) is not None for name in ("systemd", "systemd.journal")),
}))
"""

JOURNAL_FOLDERS: Final = ("/etc/systemd", "/run/systemd", "/usr/local/lib/systemd", "/usr/lib/systemd")
"""The first that has a file of a name wins (journald.conf(5))."""
JOURNAL_ADVICE: Final = (
    "write [Journal], Storage=persistent and SystemMaxUse=200M to /etc/systemd/journald.conf.d/99-flora.conf, then "
    "sudo systemctl restart systemd-journald"
)

UNDER_VOLTAGE_NOW, THROTTLED_NOW, UNDER_VOLTAGE_SINCE_BOOT, THROTTLED_SINCE_BOOT = 1 << 0, 1 << 2, 1 << 16, 1 << 18
"""Of ``vcgencmd get_throttled`` (Raspberry Pi documentation)."""


def check_clock(case: Case) -> str:
    """The wall clock was set by somebody who knows: a Pi has none of its own that outlasts a power cut."""
    if case.is_virtual:
        raise NotUsed(f'[rig.clock] kind = "twin": time is the grow box\'s, at {case.rig.clock.twin}')
    if not case.world.is_synchronised():
        raise Wrong(
            "the wall clock is not synchronised: sudo timedatectl set-ntp true, and see that UDP port 123 gets out; "
            "until then times in names are wrong and no expiry of a controller is believed"
        )
    own = (
        "a clock of its own"
        if case.world.at("/dev/rtc0").exists()
        else "no clock of its own, wrong after each power cut"
    )
    return f"synchronised; {own}"


def check_memory(case: Case) -> str:
    """Enough is free for the services, or beside them where they run."""
    text = case.world.read("/proc/meminfo") or ""
    found = {name: int(kib) // 1024 for name, kib in re.findall(r"^(MemTotal|MemAvailable):\s+(\d+) kB$", text, re.M)}
    if len(found) < 2:
        raise NotLookedAt("/proc/meminfo does not tell")
    is_running = any(line.ok for line in case.heard.lines)
    wanted = SPARE_MIB if is_running else SERVICES_MIB
    beside = "beside the services that run" if is_running else "for all services together"
    figures = f"{found['MemAvailable']} of {found['MemTotal']} MiB available"
    if found["MemAvailable"] < wanted:
        raise Wrong(f"{figures}; {wanted} MiB are wanted {beside}: end other programs, or run without a desktop")
    return figures


def check_power(case: Case) -> str:
    """The supply holds: undervoltage spoils photographs first and cards later."""
    if not pi_model(case.world):
        raise NotUsed("no Raspberry Pi")
    done = case.world.run(["vcgencmd", "get_throttled"])
    found = re.search(r"throttled=0x([0-9a-fA-F]+)", done.out)
    if found is None:
        raise NotLookedAt(f"vcgencmd does not tell ({done.reason})")
    bits = int(found[1], 16)
    if bits & (UNDER_VOLTAGE_NOW | UNDER_VOLTAGE_SINCE_BOOT):
        when = "now" if bits & UNDER_VOLTAGE_NOW else "since the last boot"
        raise Wrong(
            f"undervoltage {when}: the Pi needs its own supply, with a short cable; the strips need another one"
        )
    if bits & (THROTTLED_NOW | THROTTLED_SINCE_BOOT):
        raise Wrong(
            f"throttled since the last boot (0x{bits:x}), it was too warm: give it a heat sink, or shade from the lamps"
        )
    return "no undervoltage since the last boot"


def check_programs(case: Case) -> str:
    """Each service loads in its interpreter, and none brings what is made for the lab."""
    try:
        found: Any = case.ask_json("flora-bus", LOAD_SERVICES, ",".join(LEARNING), *case.services)
    except Wrong as problem:
        raise Wrong(f"a service cannot be loaded ({problem}): {case.world.install_anew}") from problem
    if found["learning"]:
        raise Wrong(
            f"the services load {', '.join(found['learning'])}, which belong in the lab: {case.world.install_anew}"
        )
    if case.world.at(BOOTED).is_dir() and not case.is_virtual and not found["journal"]:
        raise Wrong(
            "systemd-python is missing, so the journal gets plain lines without fields: sudo apt install "
            "python3-systemd, or install flora[rig]"
        )
    return f"{len(case.services)} services load in Python {found['python']}, nothing of the lab's"


def check_journal(case: Case) -> str:
    """The log is on the disk: Raspberry Pi OS keeps it in memory, where a reboot takes it away."""
    if case.is_virtual or not case.world.at(BOOTED).is_dir():
        raise NotUsed("no service of this rig writes to a journal")
    storage, file = journal_storage(case.world)
    has_folder = case.world.at("/var/log/journal").is_dir()
    if storage == "persistent" or (storage == "auto" and has_folder):
        return f"on the disk (Storage={storage})"
    why = f"Storage={storage} in {file}" if file else "Storage=auto, and there is no /var/log/journal"
    raise Wrong(f"the log is lost at each reboot ({why}): {JOURNAL_ADVICE}")


def journal_storage(world: World) -> tuple[str, str]:
    """``Storage=`` in force, and the file that says so: the last of main file and pieces, these in order of name."""
    mains = [f"{folder}/journald.conf" for folder in JOURNAL_FOLDERS]
    main = next((path for path in mains if world.at(path).is_file()), None)
    pieces: dict[str, str] = {}
    for folder in JOURNAL_FOLDERS:
        for path in world.at(f"{folder}/journald.conf.d").glob("*.conf"):
            pieces.setdefault(path.name, f"{folder}/journald.conf.d/{path.name}")
    storage, said_by = "auto", ""
    for file in [*([main] if main else []), *(pieces[name] for name in sorted(pieces))]:
        for found in re.finditer(r"^\s*Storage\s*=\s*(\w+)\s*$", world.read(file) or "", re.MULTILINE):
            storage, said_by = found[1].lower(), file
    return storage, said_by
