"""The folder of an evaluation: which one it is, the runs that are finished, and the results.

    evaluation.toml    which controllers, task and seed: what makes it this evaluation
    evaluation.json    every figure
    report.html        the same for people
    episodes/*.csv     simulated plants, as tracks
    runs/NAME/         each virtual plant: outcome.json, report.html, strip.jpg, and the rig with the run folder

A run is made under another name and gets its own when it is finished, so that what has its name is whole.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from flora_common import files
from flora_common.errors import BadInput
from flora_common.lock import AlreadyHeld, hold
from flora_common.outputs import is_there
from flora_common.runs import track_text
from flora_common.toml_strict import to_toml
from flora_lab.evaluate.plan import Plan
from flora_lab.evaluate.trial import Trial
from flora_lab.made_folders import read_info
from flora_lab.stopped_work import check_same_work

INFO_FILE: Final = "evaluation.toml"
JSON_FILE: Final = "evaluation.json"
PAGE_FILE: Final = "report.html"
EPISODES: Final = "episodes"
RUNS: Final = "runs"
LOCK_FILE: Final = ".lock"
FORMAT: Final = "flora-evaluation-1"


class EvaluationFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``evaluation.toml``.

    Attributes:
        format: :data:`FORMAT`.
        work: what makes it this evaluation, see :attr:`flora_lab.evaluate.plan.Plan.work`.
    """

    format: str
    work: dict[str, Any]


def check_folder(path: Path, plan: Plan) -> None:
    """Whether results of this evaluation may be written there; changes nothing.

    Raises:
        BadInput: something else is there, or another evaluation.
    """
    if not is_there(path):
        return
    if not path.is_dir():
        raise BadInput(f"{path}: is a file; name a new folder with -o")
    if {entry.name for entry in path.iterdir()} <= {LOCK_FILE}:
        return
    info = path / INFO_FILE
    if not info.is_file():
        raise BadInput(f"{path}: holds other files, and is no evaluation; name a new folder with -o")
    check_same_work(path, read_info(info, EvaluationFile, FORMAT).work, plan.work, "name another folder with -o")


@contextlib.contextmanager
def held(path: Path, plan: Plan) -> Iterator[Path]:
    """The folder, made where it is not there yet, for this process alone; what was checked must still hold.

    Raises:
        BadInput: see :func:`check_folder`; or another process works in it.
    """
    files.make_folder(path)
    check_folder(path, plan)
    try:
        descriptor = hold(path / LOCK_FILE)
    except AlreadyHeld as problem:
        raise BadInput(f"{path}: process {problem.pid} works in it; wait for it, or name another folder") from problem
    try:
        files.write_text(path / INFO_FILE, info_text(plan))
        yield path
    finally:
        os.close(descriptor)


def info_text(plan: Plan) -> str:
    """``evaluation.toml``."""
    return to_toml(EvaluationFile(FORMAT, plan.work))


def write_results(path: Path, plan: Plan, trials: Sequence[Trial], results: Mapping[str, str]) -> None:
    """Write tracks of simulated plants, and the results, in place of older ones; each file whole.

    A folder that is not there yet appears when all of it is there.

    Args:
        path: the folder.
        plan: what was asked.
        trials: those that were simulated are written as tracks.
        results: texts by name of their file.
    """
    whole = contextlib.nullcontext(path) if path.exists() else files.whole_folder(path)
    with whole as folder:
        with files.whole_folder(folder / EPISODES, replace=True) as episodes:
            for name, trial in episode_files(trials):
                text = track_text(trial.time_s, trial.light, trial.stems_cm)
                (episodes / name).write_text(text, encoding="utf-8")
        for name, text in {INFO_FILE: info_text(plan), **results}.items():
            files.write_text(folder / name, text)


def episode_files(trials: Sequence[Trial]) -> list[tuple[str, Trial]]:
    """Simulated trials with names for their files, which say what is in them and differ whatever the names are."""
    simulated = [trial for trial in trials if trial.folder is None]
    return [
        (f"{k:03d}-{plain(t.place)}-{plain(t.controller)}-{plain(t.scenario.name)}-{plain(t.plant)}.csv", t)
        for k, t in enumerate(simulated, start=1)
    ]


def plain(name: str, longest: int = 32) -> str:
    """A name from a file, as a part of a file's name."""
    return re.sub(r"[^A-Za-z0-9._]+", "-", name).strip("-.")[:longest] or "x"
