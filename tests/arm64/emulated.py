"""The processor of a Raspberry Pi 4, emulated: a Debian of its own architecture and the rig's own wheels, run by QEMU.

What runs is the machine code that runs on a Pi: Debian's Python, the NEON of NumPy and OpenCV, what Numba compiles.
What it talks to is this machine: its kernel, clock and files. There is no camera and no pin, and nothing is fast.

The tree is made once, in the user's cache. Nothing in it is started as a machine; QEMU maps one program at a time into
it, so that neither a chroot nor a registration with the kernel is needed. Programs that start one another do so by the
commands beside their Python, which here are small scripts that call QEMU again.
"""

from __future__ import annotations

import importlib.metadata
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

REPOSITORY: Final = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(REPOSITORY / "deploy"))

import rig_wheels  # noqa: E402

from debian_trees import cached_tree, must_run, packages_lacking  # noqa: E402

QEMU: Final = "qemu-aarch64-static"
CPU: Final = "cortex-a72"
"""Of a Raspberry Pi 4; that of a 3, Cortex-A53, has the same instructions."""
TOOLS: Final = {QEMU: "qemu-user-static", "debootstrap": "debootstrap", "dpkg-deb": "dpkg"}
RELEASE: Final = "bookworm"
TARGET: Final = rig_wheels.TARGETS[0]
BESIDES: Final = ("numba", "scipy", "safetensors", "threadpoolctl", "matplotlib")
"""Packages that the lab needs beyond the rig's; and what they need."""


def why_not() -> str:
    """Why nothing can be emulated here; empty where it can be tried."""
    if lacking := packages_lacking(TOOLS):
        return f"emulating a Pi's processor takes these packages: apt-get install {lacking}"
    if os.geteuid() != 0:
        return "debootstrap makes a tree for root only"
    return ""


def debian() -> Path:
    """``root`` with Debian's Python and ``site`` with the wheels.

    Raises:
        NotHere: they cannot be made.
    """
    return cached_tree(f"arm64-{RELEASE}", [RELEASE, TARGET, BESIDES, sorted(rig_wheels.pins().items())], _make)


def _make(tree: Path) -> None:
    tree.mkdir()
    _make_root(tree / "root")
    _make_site(tree / "site", tree / "wheels")


def _make_root(root: Path) -> None:
    """Packages are laid out, and none is set up: that would take programs of theirs, and Python needs none of it."""
    include = "--include=python3,ca-certificates,libsystemd0"
    must_run(["debootstrap", "--arch=arm64", "--foreign", "--variant=minbase", include, RELEASE, str(root)])
    for package in sorted((root / "var/cache/apt/archives").glob("*.deb")):
        must_run(["dpkg-deb", "--extract", str(package), str(root)])
        package.unlink()


def _make_site(site: Path, wheels: Path) -> None:
    parts = rig_wheels.parts_of(TARGET, wheels)
    files = [str(part.file) for part in parts if part.file is not None and part.file.suffix == ".whl"]
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--only-binary=:all:"]
    pip += [*TARGET.pip_options, "--target", str(site)]
    must_run([*pip, "--no-deps", *files])
    must_run([*pip, "--constraint", str(rig_wheels.CONSTRAINTS), *BESIDES])
    shutil.rmtree(wheels)


class Emulated:
    """Commands of this repository on the emulated processor.

    Args:
        folder: for what belongs to this session: the commands, and what Numba compiles.
    """

    def __init__(self, folder: Path) -> None:
        tree = debian()
        bin_, own = folder / "bin", folder / "own"
        bin_.mkdir(parents=True)
        own.mkdir()
        root = tree / "root"
        qemu = f"exec {shutil.which(QEMU)} -cpu {CPU} -L {root} {root}/usr/bin/python{TARGET.python}"
        self.python = _script(bin_ / "python", f'{qemu} "$@"')
        ours = importlib.metadata.distribution("flora")
        for entry in ours.entry_points.select(group="console_scripts"):
            start = f"import sys; sys.argv[0] = '{entry.name}'; from {entry.module} import main; sys.exit(main())"
            _script(bin_ / entry.name, f'exec {self.python} -c "{start}" "$@"')
        (own / "sitecustomize.py").write_text(f"import sys\n\nsys.executable = {str(self.python)!r}\n")
        metadata = own / "flora-0.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: flora\nVersion: {ours.version}\n")
        sources = [str(own), str(tree / "site"), str(REPOSITORY / "services"), str(REPOSITORY / "common")]
        self._environment = {
            "PATH": os.environ["PATH"],
            "HOME": str(folder),
            "PYTHONPATH": os.pathsep.join(sources),
            "PYTHONDONTWRITEBYTECODE": "1",
            "NUMBA_CACHE_DIR": str(folder / "compiled"),
            "OPENBLAS_NUM_THREADS": "1",
        }

    def run(self, command: str, *arguments: str | Path, within_s: float = 600.0) -> str:
        """Run ``python`` or an installed command to its end.

        Returns:
            What it wrote to stdout.

        Raises:
            AssertionError: it ended otherwise than well; with what it said.
        """
        line = [str(self.python.parent / command), *map(str, arguments)]
        done = subprocess.run(
            line, env=self._environment, capture_output=True, text=True, timeout=within_s, check=False
        )
        assert done.returncode == 0, (
            f"{command} ended with {done.returncode}: {done.stdout[-500:]}{done.stderr[-3000:]}"
        )
        return done.stdout


def _script(path: Path, line: str) -> Path:
    path.write_text(f"#!/bin/sh\n{line}\n")
    path.chmod(0o755)
    return path
