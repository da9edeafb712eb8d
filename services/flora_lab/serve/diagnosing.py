"""The folder in which one diagnosis at a time works."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Final

from flora_common import lock
from flora_common.errors import FloraError
from flora_common.files import TEMPORARY_SUFFIX

LOCK_FILE: Final = ".lock"


class StillBusy(FloraError):
    """A diagnosis that an earlier service started is not at its end."""


def held_folder(output: Path) -> int:
    """The lock of a folder, as a descriptor.

    Raises:
        StillBusy: another process holds it.
    """
    try:
        return lock.hold(output / LOCK_FILE)
    except lock.AlreadyHeld as by:
        raise StillBusy(
            f"{output}: a diagnosis that was started before (by process {by.pid}) still works in it"
        ) from by


def clear_left_over(output: Path) -> None:
    """Remove what diagnoses that were killed left half written; nothing while one is at work."""
    try:
        held = held_folder(output)
    except StillBusy:
        return
    try:
        for path in output.glob(f".*{TEMPORARY_SUFFIX}"):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
    finally:
        os.close(held)
