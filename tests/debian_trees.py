"""Trees of Debian for tests, made once by debootstrap in a cache folder outside the repository."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

BUILT_WITHIN_S: Final = 900.0


class NotHere(Exception):
    """This machine cannot make a tree, or cannot run what is in one; the text says why."""


def packages_lacking(tools: Mapping[str, str]) -> str:
    """Those of this machine that are needed, given a package by each tool; empty where all tools are there."""
    return " ".join(sorted({package for tool, package in tools.items() if shutil.which(tool) is None}))


def cached_tree(name: str, of: object, make: Callable[[Path], None]) -> Path:
    """A tree from the cache; made where it is not there yet.

    Args:
        name: begins the folder's name.
        of: what it is made of: with another ``repr`` it is another tree.
        make: makes it in the folder that it is given, which is not there yet.

    Raises:
        NotHere: it cannot be made, for want of a network as a rule.
    """
    key = hashlib.sha256(repr(of).encode()).hexdigest()[:12]
    tree = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "flora" / f"{name}-{key}"
    if tree.is_dir():
        return tree
    new = tree.with_suffix(".new")
    shutil.rmtree(new, ignore_errors=True)
    new.parent.mkdir(parents=True, exist_ok=True)
    try:
        make(new)
    except BaseException:
        shutil.rmtree(new, ignore_errors=True)
        raise
    new.rename(tree)
    return tree


def must_run(command: list[str]) -> None:
    """Run a command to its end.

    Raises:
        NotHere: it did not end with 0; with the last that it said.
    """
    ended = subprocess.run(command, capture_output=True, text=True, timeout=BUILT_WITHIN_S, check=False)
    if ended.returncode != 0:
        lines = (ended.stdout + ended.stderr).strip().splitlines()
        raise NotHere(f"{command[0]} failed: {lines[-1] if lines else ended.returncode}")
