"""What takes long to make and many files of tests need: made by the process that comes first, read by the others."""

from __future__ import annotations

import fcntl
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

Made = TypeVar("Made")


class Folder:
    """Where the processes of one test run keep it.

    Attributes:
        path: None where there is one process alone.
    """

    path: Path | None = None


def made_once(name: str, make: Callable[[], Made]) -> Made:
    """What ``make`` gives, in whichever process of the test run it is called first; it can be pickled.

    Args:
        name: of it, as a file.
        make: called while other processes wait for it.
    """
    if Folder.path is None:
        return make()
    place = Folder.path / f"{name}.pickle"
    with place.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not place.exists():
            made = make()
            beside = place.with_suffix(".part")  # a process that is killed leaves no half of it
            beside.write_bytes(pickle.dumps(made))
            beside.replace(place)
            return made
    read: Made = pickle.loads(place.read_bytes())
    return read
