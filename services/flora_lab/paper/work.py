"""The order of the paper's work: the folder is held, what is missing is done, and everything is told."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from flora_common import files, lock
from flora_common.errors import BadInput
from flora_common.installed import command
from flora_lab.paper import tables
from flora_lab.paper.children import ChildFailed, run_child
from flora_lab.paper.ledger import check_folder
from flora_lab.paper.page import write_report
from flora_lab.paper.pipeline import steps_of
from flora_lab.paper.results import read_results
from flora_lab.paper.rows import rows
from flora_lab.paper.scales import Asked
from flora_lab.paper.screen import Screen
from flora_lab.paper.steps import Step, do_all
from flora_lab.simulator.store import software

LOCK_FILE: Final = ".lock"


@dataclass(frozen=True, slots=True)
class Told:
    """What a person, a script and a browser get."""

    text: str
    numbers: dict[str, Any]
    report: Path


def do_paper(output: Path, asked: Asked, *, force: bool, is_silent: bool) -> Told:
    """Do all steps that are missing, and write the report.

    Raises:
        BadInput: another process works in the folder, or it holds something else.
        ChildFailed: a step's command failed; what is finished is kept.
        DiskFull: no room.
    """
    with held(output) as descriptor:
        steps = steps_of(asked, is_silent=is_silent)
        count = len(steps) + 1
        screen = Screen(count, is_silent=is_silent)

        def run(step: Step, arguments: Sequence[str]) -> None:
            try:
                run_child(command(step.program), arguments, held=descriptor, is_silent=is_silent)
            except ChildFailed as problem:
                where = f"step {steps.index(step) + 1} of {count}, {step.title}"
                words = f"{where}: {problem}; what is finished is kept, and the same command goes on"
                raise ChildFailed(words, problem.exit_status) from problem

        took_s = do_all(
            steps,
            output,
            software=software(),
            run=run,
            watcher=screen,
            monotonic_s=time.monotonic,
            force=force,
        )
        screen.heading(count, "the report")
        results = read_results(output, asked, took_s)
        compared = rows(results)
        numbers = tables.as_json(results, compared)
        return Told(tables.text(compared), numbers, write_report(output, results, compared, numbers))


@contextlib.contextmanager
def held(output: Path) -> Iterator[int]:
    """The folder, made where it is not there yet, for this process and its commands alone: the lock's descriptor.

    Raises:
        BadInput: another process works in it, or it holds something else.
    """
    files.make_folder(output)
    check_folder(output)
    try:
        descriptor = lock.hold(output / LOCK_FILE)
    except lock.AlreadyHeld as problem:
        raise BadInput(
            f"{output}: process {problem.pid}, or a command that it started, works in it; wait for it, or name another "
            "folder"
        ) from problem
    try:
        yield descriptor
    finally:
        os.close(descriptor)
