"""``flora-lab evaluate``: its options, and what it says."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

from flora_common.errors import BadInput, FloraError
from flora_lab.bars import Bars
from flora_lab.late import modules_of
from flora_lab.option_values import must_not
from flora_lab.stopped_work import kept_told, sigterm_ends

TWIN: Final = "twin"
TASK: Final = "reality"
REPEAT: Final = 3
"""The paper's experiment with real plants, and how often it was done."""
SEED: Final = 20_001
"""Individuals that neither simulators nor controllers have met: data sets begin at 1, judging at 9001."""
MOST_PLANTS: Final = 1000


class RunsFailed(FloraError):
    """Some runs on the virtual rig did not come to their end; all others are told and kept."""


_module = modules_of("flora_lab.evaluate")


def register(app: typer.Typer) -> None:
    """Add the subcommand to ``flora-lab``."""
    app.command("evaluate")(evaluate)


def evaluate(
    controllers: Annotated[list[Path], typer.Argument(metavar="CONTROLLER...", help="Controller files.")],
    *,
    on: Annotated[
        list[str], typer.Option(metavar="SIM|twin", help="A simulator folder, or the virtual rig; repeatable.")
    ],
    task: Annotated[str, typer.Option(help="left, middle, reality, round, or a task file.")] = TASK,
    scenario: Annotated[str | None, typer.Option(help="Only this one of the task.")] = None,
    repeat: Annotated[
        int, typer.Option(min=0, max=MOST_PLANTS, help="Plants per controller and scenario, at each place.")
    ] = REPEAT,
    seed: Annotated[int, typer.Option(min=0, max=2**31, help="Which plants.")] = SEED,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for figures, page and runs; finished runs in it stay.")
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=100,
            help="Runs on the virtual rig at a time.",
            show_default="one per core, and one more",
        ),
    ] = None,
    keep_photographs: Annotated[
        bool, typer.Option("--keep-photographs", help="In the run folders of virtual plants, some 130 MB each.")
    ] = False,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as one JSON object.")] = False,
) -> None:
    """Try controllers in simulators, and on virtual plants that they never met; tell the reality gap.

    `--on twin` sends each controller through the whole rig: photographs, vision, network and lamps. A run of 72 hours
    takes some 90 seconds of processor time; several go on side by side. Stopped with Ctrl-C, the same command with the
    same -o goes on.
    """
    _check_places(on, repeat)
    if TWIN not in on:
        for option, value in (("--jobs", jobs), ("--keep-photographs", keep_photographs)):
            must_not(option, value, "it is of runs --on twin")
    if output is None:
        must_not("--keep-photographs", keep_photographs, "runs are kept with -o only")
    work, plans, folders = _module("work"), _module("plan"), _module("folder")
    whole_task = modules_of("flora_lab.evolve")("task_file").task_named(task)
    plan = plans.Plan(plans.load_controllers(controllers), plans.only(whole_task, scenario), repeat, seed)
    if output is not None:
        folders.check_folder(output, plan)
    simulators = work.load_all([Path(place) for place in on if place != TWIN])
    silent = quiet or as_json
    with _bar("simulated plants", work.episodes(plan, simulators), silent) as done:
        evaluation = work.simulate(plan, simulators, done)
    if TWIN in on:
        told = kept_told(is_silent=silent or output is None)
        with sigterm_ends(), told, work.run_folder(output, plan) as folder:
            say, screen = (_nothing, None) if silent else (_say, sys.stderr if sys.stderr.isatty() else None)
            evaluation = work.on_twin(
                evaluation, folder, jobs=jobs, say=say, screen=screen, keep_photographs=keep_photographs
            )
            if output is not None:
                work.write(output, evaluation)
    elif output is not None:
        work.write(output, evaluation)
    if as_json:
        typer.echo(json.dumps(_module("as_json").as_json(evaluation)))
    elif not quiet:
        typer.echo(_module("tables").text(evaluation), nl=False)
        if output is not None:
            typer.echo(f"wrote {output}")
    if evaluation.failed:
        raise RunsFailed(work.failure_words(evaluation))


def _check_places(on: list[str], repeat: int) -> None:
    """Where to try controllers.

    Raises:
        BadInput: a place twice, or no plant for the virtual rig.
    """
    for place in on:
        if on.count(place) > 1:
            raise BadInput(f"--on {place}: is given twice")
    if TWIN in on and repeat == 0:
        raise BadInput("--repeat 0: the virtual rig knows no typical plant; ask for one or more")


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _nothing(_text: str) -> None:
    return


@contextlib.contextmanager
def _bar(name: str, total: int, silent: bool) -> Iterator[Callable[[], None]]:
    """A bar on a terminal; nothing elsewhere."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    is_hidden = silent or not console.is_terminal or total == 0
    with Bars(*columns, console=console, disable=is_hidden, transient=True) as bars:
        task = bars.add_task(name, total=total)
        yield lambda: bars.advance(task)
