"""In which order files of tests go to the processes of a run (``make test``, which keeps it)."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

Item = TypeVar("Item")

WAITING = ("rig", "contract")
"""Folders of tests that start services, and wait for them."""
WORKING = ("discovery", "lab")
"""Folders of tests that take all of a core."""


def spread(items: Sequence[Item], file_of: Callable[[Item], Path]) -> list[Item]:
    """The files in which tests wait for processes evenly among those that work for long, and those of quick tests after
    them; each file whole, and each kind in its order.

    Where all that wait came together two cores would have nothing to do for a third of the time.
    """
    kinds: dict[str, dict[Path, list[Item]]] = {}
    for item in items:
        file = file_of(item)
        folder = file.parent.name
        kind = "waits" if folder in WAITING else "works" if folder in WORKING else "quick"
        kinds.setdefault(kind, {}).setdefault(file, []).append(item)
    placed = [
        ((kind == "quick", (number + 0.5) / len(files), kind), whole)
        for kind, files in kinds.items()
        for number, whole in enumerate(files.values())
    ]
    return list(itertools.chain.from_iterable(whole for _, whole in sorted(placed, key=lambda one: one[0])))
