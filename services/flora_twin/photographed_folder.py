"""A folder of photographed runs, which takes minutes to make: there whole or not at all, and gone on with.

Until all runs are there, those that are lie in a hidden folder beside the output, each of them whole; the same command
goes on after them.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from flora_common import files
from flora_common.errors import BadInput
from flora_common.lock import AlreadyHeld, hold
from flora_twin.box import CAMERA, PinholeCamera
from flora_twin.photographs import write_run
from flora_twin.runs import PlannedRun

WORK_FILE: Final = "work.json"
LOCK_FILE: Final = "lock"


def part_folder(output: Path) -> Path:
    """Where the runs are until all of them are there."""
    return output.with_name(f".{output.name}{files.TEMPORARY_SUFFIX}")


def write_runs(
    output: Path,
    runs: Sequence[PlannedRun],
    hours: float,
    *,
    on_photograph: Callable[[], None],
    on_kept: Callable[[str], None] = lambda _name: None,
    camera: PinholeCamera = CAMERA,
) -> None:
    """Photograph runs into a new folder.

    Args:
        output: where; runs that an earlier call of the same work has left beside it are kept.
        runs: which.
        hours: length of each.
        on_photograph: called after each photograph.
        on_kept: called with the name of each run that was there.
        camera: that takes them.

    Raises:
        BadInput: the folder cannot be written to.
        DiskFull: no room.
    """
    part = part_folder(output)
    try:
        files.make_folder(part)
        lock = hold(part / LOCK_FILE)
    except AlreadyHeld as by:
        raise BadInput(f"{output}: is being made by another flora-twin (pid {by.pid})") from by
    except OSError as problem:
        raise BadInput(f"{output}: cannot be written ({problem.strerror})") from problem
    try:
        _forget_other_work(part, _work(runs, hours, camera))
        for run in runs:
            if (part / run.name).exists():
                on_kept(run.name)
                continue
            with files.whole_folder(part / run.name) as folder:
                write_run(folder, run, hours, on_photograph, camera)
        (part / WORK_FILE).unlink()
        (part / LOCK_FILE).unlink()
        part.rename(output)
        files.fsync_folder(output.parent)
    finally:
        os.close(lock)


def _forget_other_work(part: Path, work: dict[str, Any]) -> None:
    """Remove runs that were made with other settings, and what a killed process left; say what is made here."""
    is_same = _read_work(part) == work
    for left in part.iterdir():
        if left.is_dir() and (not is_same or left.suffix == files.TEMPORARY_SUFFIX):
            shutil.rmtree(left)
    files.write_text(part / WORK_FILE, json.dumps(work, indent=1) + "\n")


def _work(runs: Sequence[PlannedRun], hours: float, camera: PinholeCamera) -> dict[str, Any]:
    """What makes two calls the same work: runs with other settings are never mixed."""
    return {
        "software": importlib.metadata.version("flora"),
        "hours": hours,
        "size_px": [camera.width_px, camera.height_px],
        "runs": [[run.name, run.seed, run.run_text()] for run in runs],
    }


def _read_work(part: Path) -> Any:
    try:
        return json.loads((part / WORK_FILE).read_bytes())
    except (OSError, ValueError):
        return None
