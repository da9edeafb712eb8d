"""``flora-lab report RUN_DIR -o report.html``."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from flora_common import outputs
from flora_common.errors import BadInput
from flora_common.files import write_bytes, write_text
from flora_common.paper_experiment import STOP_HEIGHT_CM
from flora_common.runs import RunFolder
from flora_lab.report import strip
from flora_lab.report.page import is_page, page
from flora_lab.report.summary import RunSummary, summarise

STRIP_SUFFIX: Final = ".png"


def register(app: typer.Typer) -> None:
    """Add the subcommand to ``flora-lab``."""
    app.command("report")(report)


def report(
    run: Annotated[Path, typer.Argument(metavar="RUN_DIR", help="A run folder with frames.csv and track.csv.")],
    *,
    output: Annotated[Path, typer.Option("-o", "--output", help="The page to write.")] = Path("report.html"),
    strip_png: Annotated[
        Path | None, typer.Option("--strip", metavar="FILE.png", help="Also write the picture strip, as PNG.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing page and strip.")] = False,
    title: Annotated[str, typer.Option(help="Heading of the page.")] = "",
    stop_height_cm: Annotated[
        float, typer.Option("--stop-height", min=0.1, max=500.0, help="The run was over with the tip this high, in cm.")
    ] = STOP_HEIGHT_CM,
    longest_h: Annotated[
        float, typer.Option("--hours", min=0.1, help="The run was over after so many hours at the latest.")
    ] = math.inf,
    note: Annotated[list[str] | None, typer.Option(metavar="NAME=VALUE", help="A further row of the table.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as one JSON object.")] = False,
) -> None:
    """One self-contained page about a run: pictures, curves, the paper's fitness, collisions."""
    # matplotlib takes a third of a second to import, which the other subcommands shall not pay
    from flora_lab.report import figures  # noqa: PLC0415

    _check_outputs(output, strip_png, force=force)
    folder = RunFolder(run)
    notes = [_note(text) for text in note or []]
    summary = summarise(folder, stop_height_cm=stop_height_cm, longest_h=longest_h)
    written = [output] if strip_png is None else [output, strip_png]
    outputs.check_apart(written, lambda: _files_of(folder, summary))
    panels = strip.strip(folder, summary)
    for remark in panels.remarks:
        typer.echo(remark, err=True)
    drawn = {
        "shapes": figures.shapes(summary),
        "tip": figures.tip_and_lamps(summary),
        "fitness": figures.fitness_curve(summary),
    }
    heading = title or f"Run {run.resolve().name}"
    write_text(
        output, page(summary, title=heading, strip_jpeg=strip.encode_jpeg(panels.picture), figures=drawn, notes=notes)
    )
    if strip_png is not None:
        write_bytes(strip_png, strip.encode_png(panels.picture))
    if as_json:
        typer.echo(json.dumps(numbers(summary)))
    else:
        typer.echo(f"wrote {output}")


def numbers(summary: RunSummary) -> dict[str, Any]:
    """The figures that scripts want."""
    return {
        "fitness_at_target": summary.fitness_at_target,
        "fitness_at_stop": summary.fitness_at_stop,
        "best_fitness": summary.best_fitness,
        "ended": summary.ended,
        "stop_reason": summary.stop_reason,
        "stop_h": float(summary.track.time_s[summary.stop_row] / 3600),
        "target_reached_h": summary.reached_h,
        "collided_h": summary.collided_h,
        "clearance_cm": summary.clearance_cm,
        "tip_cm": [round(float(v), 3) for v in summary.track.points_cm[summary.stop_row, -1]],
        "frames": len(summary.frames),
        "readings": summary.readings,
        "hours": summary.hours,
        "lamp_changes": summary.switches,
    }


def _check_outputs(page_html: Path, strip_png: Path | None, *, force: bool) -> None:
    outputs.check_file(page_html, force=force, is_ours=is_page, what="the page of a run")
    if strip_png is None:
        return
    if strip_png.suffix.lower() != STRIP_SUFFIX:
        raise BadInput(f"--strip {strip_png}: the strip is written as PNG; name a file that ends in {STRIP_SUFFIX}")
    if strip_png.absolute() == page_html.absolute():
        raise BadInput("-o and --strip must name different files")
    outputs.check_file(strip_png, force=force, is_ours=outputs.is_png, what="a PNG picture", option="--strip")


def _files_of(run: RunFolder, summary: RunSummary) -> list[Path]:
    """What a run is made of: its tables, its photographs, and everything in the folders of photographs and records.

    A page or strip that an earlier report wrote beside the tables is not of the run.
    """
    tables = [run.run_toml, run.frames_csv, run.frames_log, run.track_csv]
    inside = [file for folder in (run.background, run.frames, run.bus) for file in folder.rglob("*")]
    named = [run.path / row.file for row in summary.frames]
    return [*tables, *inside, *named]


def _note(text: str) -> tuple[str, str]:
    name, sign, value = text.partition("=")
    if not sign or not name.strip():
        raise BadInput(f"--note `{text}`: write NAME=VALUE")
    return name.strip(), value.strip()
