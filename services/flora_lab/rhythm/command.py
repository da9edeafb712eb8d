"""``flora-lab rhythm``: its options."""

from __future__ import annotations

import enum
import json
from pathlib import Path
from typing import Annotated

import typer

from flora_common.outputs import must_be_new
from flora_lab.late import modules_of
from flora_lab.option_values import LEAST_S, LONGEST_STEP_S, within


class Along(enum.StrEnum):
    """Coordinates of a tip."""

    X = "x"
    Y = "y"


_module = modules_of("flora_lab.rhythm")


def register(app: typer.Typer) -> None:
    """Add the subcommand to ``flora-lab``."""
    app.command("rhythm")(rhythm)


def rhythm(
    tracks: Annotated[
        list[Path], typer.Argument(metavar="TRACKS...", help="Run folders, tracks, or tables of a tip over time.")
    ],
    *,
    step_s: Annotated[
        float | None,
        typer.Option(
            "--step-s", callback=within(LEAST_S, LONGEST_STEP_S), help="Seconds between frames, for tables of frames."
        ),
    ] = None,
    px_per_cm: Annotated[
        float | None, typer.Option("--px-per-cm", callback=within(0.01, 1e5), help="Scale, for tables in px.")
    ] = None,
    along: Annotated[Along, typer.Option(help="The coordinate to search.")] = Along.X,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder to write: rhythm.json and rhythm.png.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Of the noise that is drawn.")] = 1,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as one JSON object.")] = False,
) -> None:
    """Whether the tip of a plant swings, how long its cycles are, and what a tip alone cannot tell.

    A track of the tip is enough: no lamps, no stem, no reference runs. Each track is judged beside noise like its own.
    """
    if output is not None:
        must_be_new(output)
    tip_track = _module("tip_track")
    read = tip_track.told_apart([tip_track.read_tip(path, step_s=step_s, px_per_cm=px_per_cm) for path in tracks])
    judgement, report = _module("judgement"), _module("report")
    judged = [judgement.judge(track, along=along.value, seed=seed) for track in read]
    if output is not None:
        report.write_folder(output, judged)
    if as_json:
        typer.echo(json.dumps(report.as_json(judged)))
    elif not quiet:
        typer.echo(report.text(judged), nl=False)
        if output is not None:
            typer.echo(f"wrote {output}")
