"""``flora-lab rollout``: its options, and what it says."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

from flora_common.errors import BadInput
from flora_common.outputs import must_be_new
from flora_lab.bars import Bars
from flora_lab.late import modules_of
from flora_lab.option_values import within
from flora_lab.run_tracks import load_runs

EVERY_H: Final = 6.0
"""Between starts with a watched past: the paper's lamps switch every six hours."""
LONGEST_H: Final = 10_000.0

_module = modules_of("flora_lab.rollout")


def register(app: typer.Typer) -> None:
    """Add the subcommand to ``flora-lab``."""
    app.command("rollout")(rollout)


def rollout(
    simulator: Annotated[Path, typer.Argument(metavar="SIM", help="A simulator folder.")],
    runs: Annotated[list[Path], typer.Argument(metavar="RUNS...", help="Run folders with a track.csv, or tracks.")],
    *,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder to write: rollout.json and pictures.")
    ] = None,
    against: Annotated[
        list[Path] | None, typer.Option(metavar="SIM", help="Another simulator to compare with; repeatable.")
    ] = None,
    watch_h: Annotated[
        float, typer.Option(callback=within(0.01, LONGEST_H), help="Hours of each run that simulators may watch first.")
    ] = 12.0,
    horizons: Annotated[str, typer.Option(help="Hours after which errors are told.")] = "1,6,24",
    time_scale: Annotated[
        bool, typer.Option("--time-scale", help="Also find how many times too fast each simulator is.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Of the intervals.")] = 1,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as one JSON object.")] = False,
) -> None:
    """How far simulated plants are from measured ones: one step ahead, and running free.

    Beside them stand two that anybody could make up: nothing moves, and the stem goes on as before.

    Judge by runs that the simulator was not made from.
    """
    if output is not None:
        must_be_new(output)
    horizons_h = _hours_list(horizons)
    tracks = load_runs(runs)
    work, report = _module("work"), _module("report")
    simulators = work.load_all([simulator, *(against or [])])
    with _progress(quiet or as_json) as stage:
        entries, summary = work.judge_all(
            simulators,
            tracks,
            watch_h=watch_h,
            every_h=EVERY_H,
            horizons_h=horizons_h,
            time_scale=time_scale,
            seed=seed,
            stage=stage,
        )
        if output is not None:
            _module("folder").write_folder(output, entries, summary, stage)
    if as_json:
        typer.echo(json.dumps(report.as_json(summary)))
    elif not quiet:
        typer.echo(report.text(summary), nl=False)
        if output is not None:
            typer.echo(f"wrote {output}")


def _hours_list(text: str) -> list[float]:
    hours = []
    for part in text.split(","):
        try:
            value = float(part)
        except ValueError:
            raise BadInput(f"--horizons: `{part.strip()[:20]}` is not a number of hours; write 1,6,24") from None
        if not (math.isfinite(value) and 0.0 < value <= LONGEST_H):
            raise BadInput(f"--horizons: {value:g} h does not lie in (0, {LONGEST_H:g}]")
        hours.append(value)
    return sorted(set(hours))


@contextlib.contextmanager
def _progress(silent: bool) -> Iterator[Callable[[str, int], Callable[[], None]]]:
    """A bar for each stage on a terminal; nothing elsewhere."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Bars(*columns, console=console, disable=silent or not console.is_terminal, transient=True) as bars:

        def stage(name: str, total: int) -> Callable[[], None]:
            task = bars.add_task(name, total=total)
            return lambda: bars.advance(task)

        yield stage
