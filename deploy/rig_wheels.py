"""The Python packages of a rig: which, in which version, and whether each is there as a wheel for the rig's machine.

``python deploy/rig_wheels.py`` (``make wheels``) prints a table for Raspberry Pi OS Bookworm and Trixie and ends with 1
where a wheel is missing. ``make install-rig`` fetches the same wheels and carries them to the rig, which needs no
network.

Versions are those of ``constraints.txt`` and ``pi-parts.txt``. What requires what is read from the wheels themselves,
with the target's Python and machine in mind: pip would judge by those of the machine that it runs on.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from email.parser import HeaderParser
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name, parse_wheel_filename

ROOT = Path(__file__).resolve().parent.parent
CONSTRAINTS = ROOT / "deploy" / "constraints.txt"
PI_PARTS = ROOT / "deploy" / "pi-parts.txt"
EXTRA = "rig"
FROM_APT = {"systemd-python": "apt: python3-systemd"}
"""There is no wheel of it; Debian has it compiled, and the rig's environment sees Debian's packages."""
FROM_SOURCE = {"rpi-ws281x": "source, compiled on the rig"}
OLDEST_GLIBC = 5
"""Of ``manylinux_2_5``; manylinux names every glibc from there on."""
FETCH_WITHIN_S = 600.0


class WheelsMissing(Exception):
    """A package has no wheel for the target, or nobody answered; the text is for people."""


@dataclass(frozen=True, slots=True)
class Target:
    """A rig's machine.

    Attributes:
        python: such as ``3.11``.
        machine: as ``uname -m`` says it.
        glibc: minor number of its version 2.
        name: for people.
    """

    python: str
    machine: str
    glibc: int
    name: str = ""

    @property
    def key(self) -> str:
        """A folder's name."""
        return f"{self.machine}-python{self.python}-glibc2.{self.glibc}"

    @property
    def marker_environment(self) -> dict[str, str]:
        """What requirements may ask for (PyPA, dependency specifiers)."""
        return {
            "python_version": self.python,
            "python_full_version": f"{self.python}.0",
            "implementation_name": "cpython",
            "implementation_version": f"{self.python}.0",
            "platform_python_implementation": "CPython",
            "platform_machine": self.machine,
            "platform_system": "Linux",
            "platform_release": "",
            "platform_version": "",
            "os_name": "posix",
            "sys_platform": "linux",
            "extra": "",
        }

    @property
    def pip_options(self) -> list[str]:
        platforms = [f"manylinux_2_{minor}_{self.machine}" for minor in range(self.glibc, OLDEST_GLIBC - 1, -1)]
        platforms += [f"manylinux2014_{self.machine}", f"linux_{self.machine}"]
        return ["--python-version", self.python, "--implementation", "cp", *(f"--platform={p}" for p in platforms)]


TARGETS = (
    Target("3.11", "aarch64", 36, "Raspberry Pi OS Bookworm, 64 bit"),
    Target("3.13", "aarch64", 41, "Raspberry Pi OS Trixie, 64 bit"),
)


@dataclass(frozen=True, slots=True)
class Part:
    """One package of a rig.

    Attributes:
        file: where it was fetched to; None where the rig gets it from elsewhere, or where there is no wheel.
        how: the wheel's tag, or from where else it comes; empty where it is missing.
    """

    name: str
    version: str
    file: Path | None
    how: str


def pins() -> dict[str, str]:
    """Version of each package by its canonical name."""
    found: dict[str, str] = {}
    for path in (CONSTRAINTS, PI_PARTS):
        for requirement in _requirements(path.read_text(encoding="utf-8")):
            (specifier,) = requirement.specifier
            found[canonicalize_name(requirement.name)] = specifier.version
    return found


def parts_of(target: Target, folder: Path) -> list[Part]:
    """Every package that a rig needs, fetched into ``folder`` where it is not there yet.

    Raises:
        WheelsMissing: a package that has no pin.
    """
    folder.mkdir(parents=True, exist_ok=True)
    pinned = pins()
    found: dict[str, Part] = {}
    asked = _first_requirements(target)
    while asked:
        names: list[str] = sorted({canonicalize_name(requirement.name) for requirement in asked} - found.keys())
        unpinned = [name for name in names if name not in pinned]
        if unpinned:
            raise WheelsMissing(f"{CONSTRAINTS.name} has no version of {', '.join(unpinned)}: make pins")
        fetched = [_part(name, pinned[name], folder) for name in _fetch(names, pinned, target, folder)]
        found |= {part.name: part for part in fetched}
        asked = [r for part in fetched if part.file is not None for r in _requires(part.file, asked, target)]
        asked = [r for r in asked if canonicalize_name(r.name) not in found]
    return [found[name] for name in sorted(found)]


def _first_requirements(target: Target) -> list[Requirement]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = [*project["dependencies"], *project["optional-dependencies"][EXTRA]]
    lines += [str(requirement) for requirement in _requirements(PI_PARTS.read_text(encoding="utf-8"))]
    return _that_hold(map(Requirement, lines), target, extras={""})


def _requirements(text: str) -> list[Requirement]:
    return [Requirement(line) for line in text.splitlines() if line.strip() and not line.startswith("#")]


def _that_hold(requirements: Iterable[Requirement], target: Target, extras: set[str]) -> list[Requirement]:
    environments = [target.marker_environment | {"extra": extra} for extra in extras | {""}]
    return [r for r in requirements if r.marker is None or any(r.marker.evaluate(e) for e in environments)]


def _requires(wheel: Path, asked: list[Requirement], target: Target) -> list[Requirement]:
    if wheel.suffix != ".whl":
        return []  # a source says what it requires only when it is built; the one that we have requires nothing
    name = parse_wheel_filename(wheel.name)[0]
    extras = {
        extra for requirement in asked if canonicalize_name(requirement.name) == name for extra in requirement.extras
    }
    with zipfile.ZipFile(wheel) as archive:
        (metadata,) = [n for n in archive.namelist() if n.endswith(".dist-info/METADATA") and n.count("/") == 1]
        headers = HeaderParser().parsestr(archive.read(metadata).decode("utf-8"))
    return _that_hold(map(Requirement, headers.get_all("Requires-Dist", [])), target, extras)


def _fetch(names: list[str], pinned: dict[str, str], target: Target, folder: Path) -> list[str]:
    """Ask for all that are not there at once, and one by one where that fails; returns all names."""
    wanted = [f"{n}=={pinned[n]}" for n in names if n not in FROM_APT and _file(n, pinned[n], folder) is None]
    wheels = [line for line in wanted if line.partition("==")[0] not in FROM_SOURCE]
    if wheels and not _download(wheels, folder, ["--only-binary=:all:", *target.pip_options]) and len(wheels) > 1:
        for line in wheels:
            _download([line], folder, ["--only-binary=:all:", *target.pip_options])
    for line in set(wanted) - set(wheels):
        _download([line], folder, ["--no-binary=:all:"])
    return names


def _download(lines: list[str], folder: Path, options: list[str]) -> bool:
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    done = subprocess.run(
        [*command, "--dest", str(folder), *options, *lines], capture_output=True, timeout=FETCH_WITHIN_S, check=False
    )
    return done.returncode == 0


def _file(name: str, version: str, folder: Path) -> Path | None:
    stem = f"{name.replace('-', '_')}-{version}".lower()
    for path in sorted(folder.iterdir()):
        if (
            path.name.lower()
            .replace("-", "_")
            .startswith((stem.replace("-", "_") + "_", stem.replace("-", "_") + ".tar"))
        ):
            return path
    return None


def _part(name: str, version: str, folder: Path) -> Part:
    if name in FROM_APT:
        return Part(name, version, None, FROM_APT[name])
    path = _file(name, version, folder)
    if path is None:
        return Part(name, version, None, "")
    if name in FROM_SOURCE:
        return Part(name, version, path, FROM_SOURCE[name])
    return Part(name, version, path, path.stem.split("-", 2)[2])


def missing(parts: Iterable[Part]) -> list[str]:
    """Name and version of each package that is not to be had."""
    return [f"{part.name} {part.version}" for part in parts if not part.how]


def main() -> int:
    parser = argparse.ArgumentParser("make wheels", description="Is there a wheel of each package for a Raspberry Pi?")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="fetch into this folder and leave them there")
    options = parser.parse_args()
    lacking = []
    with tempfile.TemporaryDirectory() as scratch:
        for target in TARGETS:
            folder = (options.keep or Path(scratch)) / target.key
            try:
                parts = parts_of(target, folder)
            except WheelsMissing as problem:
                print(f"make wheels: {problem}", file=sys.stderr)
                return 1
            print(f"{target.name}: Python {target.python}, {target.machine}, glibc 2.{target.glibc}")
            for part in parts:
                print(f"  {part.name:42} {part.version:12} {part.how or 'MISSING'}")
            print(f"  {sum(part.how != '' for part in parts)} of {len(parts)} packages\n")
            lacking += [f"{name} (Python {target.python})" for name in missing(parts)]
    if lacking:
        print(f"make wheels: no wheel of {', '.join(lacking)}; is the network there?", file=sys.stderr)
    return 1 if lacking else 0


if __name__ == "__main__":
    sys.exit(main())
