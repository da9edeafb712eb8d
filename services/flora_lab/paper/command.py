"""``flora-lab paper``: its options, and what it says."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import Annotated, Final

import typer

from flora_common.errors import BadInput
from flora_common.suggest import did_you_mean
from flora_lab.paper.ledger import check_folder
from flora_lab.paper.scales import SCALES, Asked
from flora_lab.stopped_work import kept_told, sigterm_ends

DEFAULT_SCALE: Final = "small"


def register(app: typer.Typer) -> None:
    """Add the subcommand to ``flora-lab``."""
    app.command("paper")(paper)


def paper(
    *,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for everything; what is finished in it stays.")
    ] = None,
    scale: Annotated[
        str, typer.Option(help="smoke (a minute or two), small (four to ten) or full (twenty).")
    ] = DEFAULT_SCALE,
    seed: Annotated[int, typer.Option(min=0, max=2**31, help="Of plants, training and evolution.")] = 1,
    jobs: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=1000,
            help="Processes of evolution, and rigs at a time.",
            show_default="one per core, and one rig more",
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Do all steps anew.")] = False,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print all numbers as one JSON object.")] = False,
) -> None:
    """Do the whole of Wahby et al. 2018, and tell every figure and number of it beside ours.

    Stopped with Ctrl-C, the same command goes on; a step whose settings are others now is done anew.
    """
    if output is None:
        raise BadInput("-o is missing: name the folder to write")
    if scale not in SCALES:
        raise BadInput(f"--scale: no scale `{scale[:40]}`{did_you_mean(scale, SCALES)}")
    check_folder(output)
    asked = Asked(SCALES[scale], seed, jobs)
    is_silent = quiet or as_json
    with sigterm_ends(), kept_told(is_silent=is_silent):
        told = importlib.import_module("flora_lab.paper.work").do_paper(output, asked, force=force, is_silent=is_silent)
    if as_json:
        typer.echo(json.dumps(told.numbers))
    elif not quiet:
        typer.echo(f"{told.text}\nwrote {told.report}")
