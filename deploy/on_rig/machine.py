"""What the installer does to a machine, and says that it did: a line for each thing that it changed."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

OPT = Path("/opt/flora")
CONFIG = Path("/etc/flora/flora.toml")
KEYS = Path("/etc/flora/keys")
UNIT_FOLDER = Path("/usr/local/lib/systemd/system")
"""Not ``/etc/systemd/system``: that is for people, and ``systemctl mask`` works only without a file there."""
COMMAND_FOLDER = Path("/usr/local/bin")
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
COMMANDS = (*SERVICES, "flora-monitor")
DEVICE_TREE_MODEL = Path("/proc/device-tree/model")


class Refused(Exception):
    """It cannot be done; the text says what, where, and what to do. Ends with status 2."""


class Failed(Exception):
    """It was tried and did not work; the text says how the rig was left. Ends with status 1."""


def say(text: str) -> None:
    """A line for people, who may have gone: what was begun is brought to its end without them."""
    with contextlib.suppress(BrokenPipeError):
        print(text, flush=True)


def run(command: Sequence[str], *, within_s: float = 600.0, check: bool = True) -> subprocess.CompletedProcess[str]:
    """A command, its output kept.

    Raises:
        Failed: it did not end with 0, and ``check`` is set; or it did not end.
    """
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=within_s, check=False)
    except subprocess.TimeoutExpired as problem:
        raise Failed(f"{' '.join(command)}: no end after {within_s:g} s") from problem
    if check and done.returncode != 0:
        said = (done.stderr.strip() or done.stdout.strip()).splitlines()
        raise Failed(f"{' '.join(command)}: {said[-1] if said else f'status {done.returncode}'}")
    return done


def write_if_other(path: Path, data: bytes, *, mode: int = 0o644) -> bool:
    """Write a file whole, or leave it alone where it is as it should be; True where it was written."""
    if path.is_file() and not path.is_symlink() and path.read_bytes() == data and path.stat().st_mode & 0o777 == mode:
        return False
    path.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
    new = path.with_name(f".{path.name}.new")
    with new.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    new.chmod(mode)
    new.replace(path)
    return True


def point(link: Path, target: str) -> bool:
    """Make ``link`` a symbolic link to ``target``, in one step; True where it was not."""
    if link.is_symlink() and os.readlink(link) == target:  # noqa: PTH115 - Path.readlink would make a path of it
        return False
    link.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
    new = link.with_name(f".{link.name}.new")
    new.unlink(missing_ok=True)
    new.symlink_to(target)
    new.replace(link)
    folder = os.open(link.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
    return True


def install_packages(names: Sequence[str]) -> None:
    """Debian packages that are missing.

    Raises:
        Refused: apt-get cannot install them.
    """
    lacking = [name for name in names if not _is_installed(name)]
    if not lacking:
        return
    os.environ["DEBIAN_FRONTEND"] = "noninteractive"
    try:
        run(["apt-get", "update", "-qq"])
        run(["apt-get", "install", "-y", "-qq", "--no-install-recommends", *lacking], within_s=1800.0)
    except Failed as problem:
        raise Refused(f"{problem}; these Debian packages are needed: sudo apt install {' '.join(lacking)}") from problem
    say(f"changed    Debian packages: {', '.join(lacking)}")


def _is_installed(package: str) -> bool:
    done = run(["dpkg-query", "-W", "-f=${db:Status-Status}", package], check=False)
    return done.stdout.strip() == "installed"


def is_pi() -> bool:
    """Whether this machine is a Raspberry Pi."""
    try:
        return b"Raspberry Pi" in DEVICE_TREE_MODEL.read_bytes()
    except OSError:
        return False


def remove_tree(folder: Path) -> None:
    """A folder that may not be there."""
    if folder.exists():
        shutil.rmtree(folder)
