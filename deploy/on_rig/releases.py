"""Releases side by side in ``/opt/flora/releases``, each a virtual environment of its own; ``current`` points at one.

A release is there when its file ``release.json`` is: that is written last. Nothing in a release is changed afterwards.
"""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

from machine import COMMAND_FOLDER, COMMANDS, OPT, Failed, Refused, point, remove_tree, run, say

RELEASES = OPT / "releases"
CURRENT = OPT / "current"
PREVIOUS = OPT / "previous"
COMPLETE = "release.json"
SHARE = Path("share/flora")
"""In a release: its units and its installer."""
KEPT = 3


def name_of(link: Path) -> str | None:
    """The release that a link points at, where it is there."""
    if not link.is_symlink():
        return None
    name = Path(os.readlink(link)).name  # noqa: PTH115 - the text of the link is what counts
    return name if is_complete(name) else None


def is_complete(name: str) -> bool:
    return (RELEASES / name / COMPLETE).is_file()


def installed() -> list[str]:
    """All whole releases, newest first."""
    found = [path.parent for path in RELEASES.glob(f"*/{COMPLETE}")]
    return [path.name for path in sorted(found, key=lambda p: (p / COMPLETE).stat().st_mtime_ns, reverse=True)]


def read_bundle(bundle: Path) -> dict[str, Any]:
    """What the bundle says of itself.

    Raises:
        Refused: it is not a bundle.
    """
    try:
        about: dict[str, Any] = json.loads((bundle / COMPLETE).read_text(encoding="utf-8"))
        name = about["release"]
    except (OSError, ValueError, KeyError, TypeError) as problem:
        raise Refused(f"{bundle}: not a bundle of `make install-rig` ({problem})") from problem
    if not isinstance(name, str) or not name or name.startswith(".") or "/" in name:
        raise Refused(f"{bundle}: `{name}` cannot be a release's name")
    return about


def build(bundle: Path, name: str) -> None:
    """Make the release from its bundle.

    Raises:
        Failed: pip could not; nothing is left of it.
    """
    if is_complete(name):
        say(f"unchanged  release {name} is there")
        return
    folder = RELEASES / name
    remove_tree(folder)
    folder.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
    try:
        _fill(bundle, folder)
    except (Failed, OSError):
        remove_tree(folder)
        raise
    os.sync()
    data = (bundle / COMPLETE).read_bytes()
    (folder / f".{COMPLETE}").write_bytes(data)
    (folder / f".{COMPLETE}").replace(folder / COMPLETE)
    say(f"changed    release {name} in {folder}")


def _fill(bundle: Path, folder: Path) -> None:
    # Debian's packages are seen: picamera2 and libcamera come from nowhere else, and so does python3-systemd.
    run(["python3", "-m", "venv", "--system-site-packages", str(folder)])
    pip = [str(folder / "bin/python"), "-m", "pip", "--disable-pip-version-check", "--no-input"]
    wheels = sorted((bundle / "wheels").glob("*.whl"))
    sources = sorted((bundle / "wheels").glob("*.tar.gz"))
    # Every package is named, and in one version: nothing is left to be looked for, and nothing asked of a network.
    offline = ["install", "--quiet", "--no-index", "--no-deps", "--ignore-installed"]
    run([*pip, *offline, *map(str, wheels)], within_s=1800.0)
    for source in sources:
        run([*pip, *offline, "--no-build-isolation", str(source)], within_s=1800.0)
    shutil.copytree(bundle / "systemd", folder / SHARE / "systemd")
    shutil.copytree(bundle / "installer", folder / SHARE / "installer")
    documents = folder / "share/doc/flora"
    documents.mkdir(parents=True)
    shutil.copy(bundle / "README.md", documents)


def check(name: str, config: Path) -> None:
    """Each service of a release loads, and reads the rig's configuration; nothing is started.

    Raises:
        Failed: one does not.
    """
    for command in COMMANDS:
        program = str(RELEASES / name / "bin" / command)
        run([program, "--version"], within_s=120.0)
        if command != "flora-monitor":
            run([program, "--config", str(config), "--check-config"], within_s=120.0)


def switch(name: str) -> None:
    """Let ``current`` point at another release; the one before is remembered as ``previous``."""
    before = name_of(CURRENT)
    if before is not None and before != name:
        point(PREVIOUS, f"releases/{before}")
    if point(CURRENT, f"releases/{name}"):
        say(f"changed    {CURRENT} -> {name}")
    linked = [name for name in COMMANDS if point(COMMAND_FOLDER / name, str(CURRENT / "bin" / name))]
    if linked:
        say(f"changed    commands in {COMMAND_FOLDER}: {', '.join(linked)}")


def discard(name: str) -> None:
    """Remove a release that was not well: it is not to take the place of one that was."""
    if name not in (name_of(CURRENT), name_of(PREVIOUS)):
        remove_tree(RELEASES / name)
        say(f"changed    removed release {name}")


def prune() -> None:
    """Keep the last three: what runs, what ran before, and the newest of the others."""
    first = [name for name in (name_of(CURRENT), name_of(PREVIOUS)) if name is not None]
    kept = list(dict.fromkeys([*first, *installed()]))[:KEPT]
    for folder in RELEASES.iterdir():
        if folder.name not in kept:
            remove_tree(folder)
            say(f"changed    removed release {folder.name}")
