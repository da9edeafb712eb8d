"""A folder of photographed runs, which takes minutes to make: there whole or not at all, and gone on with.

Until all runs are there, those that are lie in a hidden folder beside the output, each of them whole; the same command
goes on after them. A command of other settings does not, and drops them only where it is told to: each took a while.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from flora_common import files
from flora_common.counted import counted
from flora_common.errors import BadInput
from flora_common.lock import AlreadyHeld, hold
from flora_common.suggest import clipped
from flora_twin.box import CAMERA, PinholeCamera
from flora_twin.photographs import write_run
from flora_twin.runs import PlannedRun

WORK_FILE: Final = "work.json"
LOCK_FILE: Final = "lock"
_REMEDY: Final = "give the same settings to go on with it, --force to drop it, or another -o"


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
    force: bool = False,
) -> None:
    """Photograph runs into a new folder.

    Args:
        output: where; runs that an earlier call of the same work has left beside it are kept.
        runs: which.
        hours: length of each.
        on_photograph: called after each photograph.
        on_kept: called with the name of each run that was there.
        camera: that takes them.
        force: drop runs that an earlier call of other work has left there.

    Raises:
        BadInput: the folder cannot be written to, or holds runs of other work that are not to be dropped.
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
        _take_over(part, _work(runs, hours, camera), force=force)
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


def _take_over(part: Path, work: dict[str, Any], *, force: bool) -> None:
    """Remove what a killed process left, and runs of other work where that is asked for; say what is made here.

    Raises:
        BadInput: there are runs of other work, and ``force`` was not given.
    """
    folders = [left for left in part.iterdir() if left.is_dir()]
    whole = [left for left in folders if left.suffix != files.TEMPORARY_SUFFIX]
    then = _read_work(part)
    is_same = then == work
    if whole and not is_same and not force:
        count = counted(len(whole), "finished run")
        raise BadInput(f"{part}: holds {count} of other work, {_differences(then, work)}; {_REMEDY}")
    for left in folders:
        if not is_same or left not in whole:
            shutil.rmtree(left)
    files.write_text(part / WORK_FILE, json.dumps(work, indent=1) + "\n")


def _differences(then: object, now: Mapping[str, Any]) -> str:
    """By which settings two works differ; of the runs, which one is the first."""
    if not isinstance(then, Mapping):
        return f"its {WORK_FILE} does not say which"
    told = [
        f"{name} was {clipped(str(then.get(name)))} and is {clipped(str(now[name]))} now"
        for name in now
        if name != "runs" and then.get(name) != now[name]
    ]
    if then.get("runs") != now["runs"]:
        told.append(_other_runs(_run_names(then.get("runs")), _run_names(now["runs"])))
    return ", ".join(told) or "its settings differ"


def _other_runs(then: Sequence[str], now: Sequence[str]) -> str:
    """The first run in which two plans differ, and how many runs they have."""
    at = next((i for i, (a, b) in enumerate(zip(then, now, strict=False)) if a != b), None)
    if at is not None:
        return f"run {at + 1} was {then[at]} and is {now[at]} now"
    if len(then) != len(now):
        return f"the number of runs was {len(then)} and is {len(now)} now"
    return "the runs' settings differ"


def _run_names(runs: object) -> list[str]:
    """``open-1 of seed 3``; the file may hold anything."""
    rows = runs if isinstance(runs, list) else []
    return [clipped(f"{row[0]} of seed {row[1]}") for row in rows if isinstance(row, list) and len(row) > 1]


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
