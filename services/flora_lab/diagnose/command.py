"""``flora-lab diagnose``: its options, and what it says."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn

from flora_common.errors import BadInput
from flora_common.outputs import must_be_new
from flora_lab.bars import Bars
from flora_lab.late import modules_of

_module = modules_of("flora_lab.diagnose")


def register(app: typer.Typer) -> None:
    """Add the subcommand to ``flora-lab``."""
    app.command("diagnose")(diagnose)


def diagnose(
    runs: Annotated[list[Path], typer.Argument(metavar="RUNS...", help="Run folders with a track.csv, or tracks.")],
    *,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder to write: diagnosis.json, report.html, ...")],
    simulator: Annotated[
        Path | None, typer.Option(metavar="SIM", help="The simulator that the runs are compared with.")
    ] = None,
    reference: Annotated[
        Path | None, typer.Option(metavar="RUNS_DIR", help="Learn the simulator from the runs in this folder first.")
    ] = None,
    holdout: Annotated[
        list[Path] | None, typer.Option(metavar="RUN", help="A run to measure the gain on; repeatable.")
    ] = None,
    controllers: Annotated[
        str | None,
        typer.Option(
            metavar="TASK",
            help="Evolve controllers for this task (left, middle, reality, round, or a task file) in the simulator as "
            "it is and as it is extended, and compare them on plants with what was found (minutes).",
        ),
    ] = None,
    report: Annotated[bool, typer.Option("--report/--no-report", help="Write report.html and pictures.")] = True,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print diagnosis.json.")] = False,
) -> None:
    """What the simulation gets wrong about measured runs: shown, named, mended, and the gain measured.

    What is learned from --reference is kept as base.simulator in the folder, and can be given as --simulator the next
    time. A simulator that was learned as a black box has no parts with names: it is judged as a whole, and given
    --reference too, what is found by the mechanistic one beside it corrects it.
    """
    if simulator is None and reference is None:
        raise BadInput("give --simulator SIM or --reference RUNS_DIR: what the runs are to be compared with")
    must_be_new(output)
    task = None if controllers is None else _task(controllers)
    folder = _module("folder")
    with _progress(quiet or as_json) as (stage, note):
        result = _module("work").diagnose(
            runs, simulator=simulator, reference=reference, holdout=holdout or [], stage=stage, note=note
        )
        if task is not None:
            result = _module("controllers").compared(result, task, stage, note)
        written = stage("drawing" if report else "writing", 1)
        write = folder.write if report else folder.write_without_report
        write(output, result)
        written()
    if as_json:
        typer.echo(folder.as_json(result).decode(), nl=False)
    elif not quiet:
        typer.echo(_module("table").text(result), nl=False)
        typer.echo(f"wrote {output}")


def _task(text: str) -> Any:
    return modules_of("flora_lab.evolve")("task_file").task_named(text, "--controllers")


@contextlib.contextmanager
def _progress(silent: bool) -> Iterator[tuple[Callable[[str, int], Callable[[], None]], Callable[[str], None]]]:
    """A bar for each stage on a terminal, for one that begins anew the same; nothing elsewhere. Notes go to stderr."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Bars(*columns, console=console, disable=silent or not console.is_terminal, transient=True) as bars:
        tasks: dict[str, TaskID] = {}

        def stage(name: str, total: int) -> Callable[[], None]:
            if name in tasks:
                bars.reset(tasks[name], total=total)
            else:
                tasks[name] = bars.add_task(name, total=total)
            return lambda: bars.advance(tasks[name])

        def note(text: str) -> None:
            console.print(f"note: {text}", markup=False, soft_wrap=True)

        yield stage, (lambda _: None) if silent else note
