"""Install this checkout on a rig over ssh, or go back there to the release before.

``make install-rig RIG=user@host`` and ``make rollback-rig RIG=user@host``. All packages are fetched here, for the rig's
machine and Python, and carried over: the rig needs no network but for Debian's packages. What happens there is in
``on_rig/``.

Ends with 0 when the rig is well, with 1 when it is not, and says which release runs; with 2 when it cannot be tried at
all.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

from rig_wheels import ROOT, Part, Target, WheelsMissing, missing, parts_of

SSH = ["ssh", "-o", "BatchMode=yes", "-o", "ConnectTimeout=20", "-o", "ServerAliveInterval=15"]
LOST = 255
"""Status of ssh itself."""
OLDEST_PYTHON = (3, 11)
INCOMING = "/opt/flora/incoming"
INSTALLER = "/opt/flora/current/share/flora/installer"
ADDRESS = re.compile(r"[A-Za-z0-9_.][A-Za-z0-9_.@:%\[\]-]*")

PROBE = """
import json, os, pathlib, platform, subprocess, sys
sudo = os.geteuid() == 0 or subprocess.run(["sudo", "-n", "true"], capture_output=True).returncode == 0
print(json.dumps({
    "python": "%d.%d" % sys.version_info[:2],
    "machine": platform.machine(),
    "glibc": platform.libc_ver()[1],
    "root": os.geteuid() == 0,
    "may": sudo,
    "systemd": pathlib.Path("/run/systemd/system").is_dir(),
    "releases": [path.parent.name for path in pathlib.Path("/opt/flora/releases").glob("*/release.json")],
}))
"""


class Refused(Exception):
    """It cannot be tried: what, where, and what to do."""


@dataclass(frozen=True, slots=True)
class Rig:
    """A machine that answers.

    Attributes:
        address: as ssh takes it.
        root: what a command of root's begins with.
        target: its Python and machine.
        releases: those that are whole.
    """

    address: str
    root: list[str]
    target: Target
    releases: list[str]

    def run(self, command: list[str], *, stdin: int | None = subprocess.DEVNULL) -> int:
        """A command as root, its output ours; returns its status."""
        there = shlex.join([*self.root, *command])
        return subprocess.run([*SSH, "--", self.address, there], stdin=stdin, check=False).returncode


def look_at(address: str) -> Rig:
    """Ask the rig what it is.

    Raises:
        Refused: it does not answer, or cannot be a rig.
    """
    if not ADDRESS.fullmatch(address):
        raise Refused(f"RIG={address!r}: write RIG=user@host")
    command = [*SSH, "--", address, "python3 -"]
    done = subprocess.run(command, input=PROBE, capture_output=True, text=True, check=False)
    if done.returncode == LOST:
        raise Refused(f"no connection to {address}: {_last(done.stderr)}; try `ssh {address}` by hand, with a key")
    try:
        said = json.loads(done.stdout.splitlines()[-1])
    except (ValueError, IndexError):
        raise Refused(f"{address}: python3 does not run there ({_last(done.stderr)})") from None
    python = tuple(int(part) for part in said["python"].split("."))
    if python < OLDEST_PYTHON:
        raise Refused(f"{address} has Python {said['python']}; Raspberry Pi OS Bookworm or newer is needed")
    if not said["systemd"]:
        raise Refused(f"{address} is not run by systemd")
    if not said["may"]:
        raise Refused(f"{address}: sudo asks for a password there; install as root, or let this user go without")
    if not said["glibc"].startswith("2."):
        raise Refused(f"{address}: no glibc, there are no wheels for it")
    target = Target(said["python"], said["machine"], int(said["glibc"].split(".")[1]), address)
    return Rig(address, [] if said["root"] else ["sudo", "-n"], target, said["releases"])


def _last(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1] if lines else "it says nothing"


def make_bundle(folder: Path, target: Target) -> str:
    """Everything that the rig needs, in one folder; returns the release's name.

    Raises:
        Refused: a wheel is missing, or flora's own cannot be built.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "flora" / "wheels" / target.key
    try:
        parts = parts_of(target, cache)
    except WheelsMissing as problem:
        raise Refused(str(problem)) from problem
    lacking = missing(parts)
    if lacking:
        raise Refused(
            f"no wheel of {', '.join(lacking)} for Python {target.python} on {target.machine}; "
            "is the network there? A rig has 64 bit: aarch64"
        )
    wheels = folder / "wheels"
    wheels.mkdir()
    _build_own_wheel(wheels)
    for part in parts:
        if part.file is not None:
            shutil.copy(part.file, wheels)
    shutil.copytree(ROOT / "systemd", folder / "systemd", ignore=shutil.ignore_patterns("lab"))
    installer = ROOT / "deploy" / "on_rig"
    shutil.copytree(installer, folder / "installer", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "deploy" / "flora.toml", folder)
    shutil.copy(ROOT / "README.md", folder)
    name, about = _name(folder, parts, target)
    (folder / "release.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    return name


def _build_own_wheel(folder: Path) -> None:
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps"]
    done = subprocess.run(
        [*command, "--wheel-dir", str(folder), str(ROOT)], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise Refused(f"the wheel of flora cannot be built: {_last(done.stderr)}")


def _name(folder: Path, parts: list[Part], target: Target) -> tuple[str, dict[str, object]]:
    """The same content has the same name: version, commit, Python, and a hash where it is not just that commit.

    A release is an environment of one Python: after an upgrade of the rig's Debian the same commit is another release.
    """
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    content = hashlib.sha256(target.key.encode())
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        content.update(f"{path.relative_to(folder)}\0".encode() + hashlib.sha256(path.read_bytes()).digest())
    commit = _git("rev-parse", "--short=10", "HEAD")
    is_clean = commit != "" and _git("status", "--porcelain", "--", ".") == ""
    hashed = [] if is_clean else [content.hexdigest()[:10]]
    words = [version, *([commit] if commit else []), f"py{target.python}", *hashed]
    name = "-".join(words)
    packages = {part.name: part.version for part in parts}
    about = {"release": name, "version": version, "commit": commit, "is_clean": is_clean, "packages": packages}
    return name, about


def _git(*arguments: str) -> str:
    if not (ROOT / ".git").exists():
        return ""
    command = ["git", "--no-optional-locks", "-C", str(ROOT), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout.strip() if done.returncode == 0 else "?"


def install(rig: Rig) -> int:
    """Make a bundle, bring it over, and let the rig do the rest; returns the exit status."""
    target = rig.target
    print(f"{rig.address}: {target.machine}, Python {target.python}, glibc 2.{target.glibc}", flush=True)
    with tempfile.TemporaryDirectory(prefix="flora-install-") as scratch:
        folder = Path(scratch)
        name = make_bundle(folder, target)
        if name in rig.releases:
            shutil.rmtree(folder / "wheels")
        print(f"release    {name}", flush=True)
        there = f"{INCOMING}/{name}"
        # Half of it, where the connection breaks, would lie there for ever: the next release has another name.
        unpack = f"rm -rf {there} && mkdir -p {there} && tar -C {there} -xf - || {{ rm -rf {there}; exit 1; }}"
        with subprocess.Popen(
            ["tar", "-C", scratch, "--owner=0", "--group=0", "--mode=go-w,a+rX", "-cf", "-", "."],
            stdout=subprocess.PIPE,
        ) as tar:
            assert tar.stdout is not None
            status = rig.run(["sh", "-c", unpack], stdin=tar.stdout.fileno())
        if status != 0:
            raise Refused(f"{rig.address}: the release could not be brought over (status {status})")
    return rig.run(["python3", f"{there}/installer", "install", there])


def roll_back(rig: Rig) -> int:
    """Let the rig go back; returns the exit status."""
    return rig.run(["python3", INSTALLER, "rollback"])


def main() -> int:
    parser = argparse.ArgumentParser("make install-rig")
    parser.add_argument("rig", help="user@host")
    parser.add_argument("--rollback", action="store_true", help="go back to the release before")
    options = parser.parse_args()
    name = "make rollback-rig" if options.rollback else "make install-rig"
    try:
        rig = look_at(options.rig)
        status = roll_back(rig) if options.rollback else install(rig)
    except Refused as problem:
        print(f"{name}: {problem}", file=sys.stderr)
        return 2
    if status == LOST:
        print(
            f"{name}: the connection to {rig.address} broke; a switch that was begun is decided there without us",
            file=sys.stderr,
        )
        return 1
    return status


if __name__ == "__main__":
    sys.exit(main())
