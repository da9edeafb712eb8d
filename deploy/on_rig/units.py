"""The release's units in systemd's folders, and what systemd says of the services."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from pathlib import Path

from machine import OPT, SERVICES, UNIT_FOLDER, run, say, write_if_other
from releases import RELEASES, SHARE

TARGET = "flora-rig.target"
CONFIRM = "on-flora-installed.service"
MANIFEST = OPT / "unit-files"
"""The unit files that an installation wrote: those that a later release lacks are removed."""
OF_THE_MACHINE = {
    "sysusers.d/flora.conf": Path("/etc/sysusers.d/flora.conf"),
    "tmpfiles.d/flora.conf": Path("/etc/tmpfiles.d/flora.conf"),
    "journald.conf.d/99-flora.conf": Path("/etc/systemd/journald.conf.d/99-flora.conf"),
    "system.conf.d/50-flora.conf": Path("/etc/systemd/system.conf.d/50-flora.conf"),
}
"""What stays as the newest installation left it; an older release does as well with it."""
SINCE = "since-"
"""Unit files in ``since-254/`` are for a systemd of that version and newer."""


def install_machine_files(release: str) -> None:
    """User, groups, folders and journal, before any unit needs them; the machine's watchdog, from its next start on."""
    changed = set()
    for name, path in OF_THE_MACHINE.items():
        if write_if_other(path, (RELEASES / release / SHARE / "systemd" / name).read_bytes()):
            changed.add(name)
            say(f"changed    {path}")
    run(["systemd-sysusers", str(OF_THE_MACHINE["sysusers.d/flora.conf"])])
    run(["systemd-tmpfiles", "--create", str(OF_THE_MACHINE["tmpfiles.d/flora.conf"])])
    if "journald.conf.d/99-flora.conf" in changed:
        run(["systemctl", "restart", "systemd-journald.service"])


def install_units(release: str) -> bool:
    """Put the release's units in place; True where one changed."""
    files = _unit_files(RELEASES / release / SHARE / "systemd")
    names = sorted(files)
    changed = [name for name in names if write_if_other(UNIT_FOLDER / name, files[name].read_bytes())]
    before = MANIFEST.read_text(encoding="utf-8").splitlines() if MANIFEST.is_file() else []
    gone = [name for name in before if name not in names]
    for name in gone:
        (UNIT_FOLDER / name).unlink(missing_ok=True)
    write_if_other(MANIFEST, "".join(f"{name}\n" for name in names).encode())
    if changed or gone:
        say(f"changed    units: {', '.join([*changed, *(f'{name} (removed)' for name in gone)])}")
        run(["systemctl", "daemon-reload"])
    return bool(changed or gone)


def _unit_files(source: Path) -> dict[str, Path]:
    """Where each unit file comes from, by its name in systemd's folder; those that this systemd is too old for are left
    out."""
    found = {}
    for path in source.rglob("*"):
        name = str(path.relative_to(source))
        if not path.is_file() or name in OF_THE_MACHINE:
            continue
        first, _, rest = name.partition("/")
        if not first.startswith(SINCE):
            found[name] = path
        elif systemd_version() >= int(first.removeprefix(SINCE)):
            found[rest] = path
    return found


def systemd_version() -> int:
    """Of this machine: 252 in Debian 12, 257 in Debian 13; 0 where it does not say."""
    told = re.match(r"systemd (\d+)", run(["systemctl", "--version"]).stdout)
    return int(told[1]) if told else 0


@dataclass(frozen=True, slots=True)
class State:
    """One service.

    Attributes:
        is_masked: a person leaves it out.
        is_ready: it runs, and has said READY.
        restarts: how often systemd has started it again by itself.
    """

    is_masked: bool
    is_ready: bool
    restarts: int
    pid: str


def states() -> dict[str, State]:
    """What systemd says of each service."""
    properties = "Id,LoadState,ActiveState,SubState,NRestarts,MainPID"
    done = run(["systemctl", "show", f"--property={properties}", *(f"{name}.service" for name in SERVICES)])
    found = {}
    for block in done.stdout.split("\n\n"):
        of = dict(line.partition("=")[::2] for line in block.splitlines() if "=" in line)
        found[of["Id"].removesuffix(".service")] = State(
            is_masked=of["LoadState"] == "masked",
            is_ready=(of["ActiveState"], of["SubState"]) == ("active", "running"),
            restarts=int(of.get("NRestarts") or 0),
            pid=of.get("MainPID", "0"),
        )
    return found


def is_enabled() -> bool:
    """Whether the rig starts at boot: it was started by an installation, or by a person."""
    return run(["systemctl", "is-enabled", "--quiet", TARGET], check=False).returncode == 0


def ready_now() -> list[str]:
    """The services that run."""
    return [name for name, state in states().items() if state.is_ready]


def restart() -> None:
    """Start what is stopped, restart what runs; does not wait. Starting the anchor also ends safe mode."""
    run(["systemctl", "reset-failed", *(f"{name}.service" for name in SERVICES)], check=False)
    run(["systemctl", "--no-block", "restart", TARGET])


def wait_steady(expected: list[str], *, within_s: float, steady_s: float, most_restarts: int) -> str:
    """Wait until all services in ``expected`` have been ready for a while without dying.

    Returns:
        an empty text, or who is not well, in a sentence.
    """
    before = {name: state.restarts for name, state in states().items()}
    deadline_s = time.monotonic() + within_s
    since_s: float | None = None
    pids: dict[str, str] = {}
    while True:
        now = states()
        dying = [
            name for name in expected if now[name].restarts - min(before[name], now[name].restarts) > most_restarts
        ]
        if dying:
            return f"{', '.join(dying)} ends again and again (journalctl -u {dying[0]})"
        unready = [name for name in expected if not now[name].is_ready]
        running = {name: now[name].pid for name in expected}
        if unready or running != pids:
            since_s, pids = None, running
        elif since_s is None:
            since_s = time.monotonic()
        elif time.monotonic() - since_s >= steady_s:
            return ""
        if time.monotonic() > deadline_s:
            return f"{', '.join(unready) or 'a service'} not ready after {within_s:g} s (systemctl status 'flora-*')"
        time.sleep(0.5)
