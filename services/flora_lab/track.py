"""``flora-lab track``: photographs of a plant in, ``track.csv`` out."""

from __future__ import annotations

import contextlib
import enum
import json
import math
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from flora_common import files
from flora_common.errors import BadInput
from flora_common.runs import CameraSection
from flora_common.vision.paper import PaperSettings
from flora_common.vision.setup import SetupMatrices
from flora_lab import lights, tracking
from flora_lab.overlays import OverlayFolder
from flora_lab.sources import FilmSource, FolderSource, RunSource, open_source

PAPER_SAMPLING_PX = 410
"""Width at which the published method looks at pictures: 1/8 of 3280 px."""
BAD_PICTURES_NAMED = 3


class Method(enum.StrEnum):
    """How the stem is found."""

    PAPER = "paper"


def register(app: typer.Typer) -> None:
    """Add the subcommand to ``flora-lab``."""
    app.command("track")(track)


def track(
    input_path: Annotated[Path, typer.Argument(metavar="INPUT", help="A run folder, a folder of pictures, or a film.")],
    *,
    output: Annotated[Path, typer.Option("-o", "--output", help="The track to write.")] = Path("track.csv"),
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing track.")] = False,
    method: Annotated[Method, typer.Option(help="How the stem is found.")] = Method.PAPER,
    overlays: Annotated[
        Path | None, typer.Option(help="New folder for pictures with the stem drawn over, contact.png, readings.csv.")
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="Overlay of every N-th picture only.")] = 1,
    frames: Annotated[
        str, typer.Option(metavar="A:B", help="Use frames A to B-1 only, from 0; either may be left out.")
    ] = ":",
    anchor: Annotated[
        str | None, typer.Option(metavar="X,Y", help="Where the stem leaves the soil, px. [default: run.toml]")
    ] = None,
    px_per_cm: Annotated[float | None, typer.Option(help="Scale of the full picture. [default: run.toml]")] = None,
    window: Annotated[
        str | None, typer.Option(metavar="X0,Y0,X1,Y1", help="Look inside this part of the picture only, px.")
    ] = None,
    reduction: Annotated[
        int | None, typer.Option(help="Look at 1/N of the size: 1, 2, 4, 8. [default: nearest above 410 px width]")
    ] = None,
    theta_1: Annotated[
        float, typer.Option("--theta-1", help="How far green must leave the setup's range, 0..1.")
    ] = 0.2,
    theta_2_px: Annotated[
        float, typer.Option("--theta-2-px", help="Half height of an averaged band, px of a 3280 px wide picture.")
    ] = 30.0,
    smallest_component: Annotated[int, typer.Option(min=0, help="Drop groups of fewer stem pixels; 0: keep all.")] = 0,
    interval_s: Annotated[float, typer.Option(help="Seconds between frames, where no frames.csv says it.")] = 300.0,
    light_from: Annotated[
        str, typer.Option(metavar="RULE", help="left|right|dark|both, `picture`, or spans as left:0-46,right:47-93.")
    ] = "dark",
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as one JSON object.")] = False,
) -> None:
    """Find the stem in every photograph and write it as a track.

    A run folder brings anchor, scale, times, lamps and background pictures with it. For a folder of pictures or a film
    give --anchor and --px-per-cm; without background pictures the empty setup is learnt from the frames themselves.
    """
    if output.exists() and not force:
        raise BadInput(f"{output}: is there already; name another file with -o, or add --force")
    if output.is_dir():
        raise BadInput(f"{output}: is a folder; name a file with -o")
    if not (math.isfinite(interval_s) and interval_s > 0):
        raise BadInput(f"--interval-s: {interval_s:g} is not a positive number of seconds")
    span = _parse_span(frames)
    rule = lights.parse_rule(light_from)
    source = open_source(input_path)
    count = span.count(source.count)
    if count == 0:
        raise BadInput(f"--frames: no frame between {frames}; {source.name} has {source.count}, counted from 0")
    camera = _camera(source, anchor, px_per_cm)
    settings = _settings(
        source,
        window=window,
        reduction=reduction,
        theta_1=theta_1,
        theta_2_px=theta_2_px,
        smallest_component=smallest_component,
    )
    background = source.folder.background_pictures() if isinstance(source, RunSource) else []
    obstacle, target = (source.obstacle, source.target) if isinstance(source, RunSource) else (None, None)
    light_of = tracking.LightOf(rule)
    summary = tracking.Summary.empty()
    readings: list[tracking.Reading] = []
    folder = (
        OverlayFolder(overlays, camera, settings, frames=count, every=every, obstacle=obstacle, target=target)
        if overlays is not None
        else None
    )
    with folder or contextlib.nullcontext(), _progress(quiet or as_json) as advance:
        learning = advance("empty setup", None if background else count)
        setup = tracking.setup_for(source, background, settings, light_of, span, on_frame=learning)
        reading_done = advance("stems", count)
        for reading, frame in tracking.read_frames(
            source, setup, camera, settings, light_of=light_of, span=span, interval_s=interval_s
        ):
            summary.add(reading)
            readings.append(reading)
            if folder is not None:
                folder.add(reading, frame)
            reading_done()
        if summary.readings == 0:
            first = f"; the first: {summary.bad[0]}" if summary.bad else ""
            raise BadInput(
                f"{source.name}: no stem in any of {summary.frames} frames ({summary.outcome_words()}){first}; "
                "nothing was written; see --anchor, --window and --overlays"
            )
        if folder is not None:
            folder.finish(readings)
    files.write_text(output, tracking.track_text(readings))
    _report(source.name, summary, setup, output, overlays, quiet=quiet, as_json=as_json)


def _report(
    name: str,
    summary: tracking.Summary,
    setup: object,
    output: Path,
    overlays: Path | None,
    *,
    quiet: bool,
    as_json: bool,
) -> None:
    learnt = not isinstance(setup, SetupMatrices)
    if as_json:
        fields = {
            "input": name,
            "method": Method.PAPER.value,
            "setup": "frames" if learnt else "background",
            "frames": summary.frames,
            "readings": summary.readings,
            "outcomes": dict(summary.outcomes),
            "lights": dict(summary.lights),
            "mean_quality": round(summary.mean_quality, 4),
            "bad_pictures": summary.bad,
            "track": str(output),
            "overlays": str(overlays) if overlays else None,
        }
        print(json.dumps(fields))
        return
    if quiet:
        return
    for reason in summary.bad[:BAD_PICTURES_NAMED]:
        print(f"left out: {reason}", file=sys.stderr)
    if len(summary.bad) > BAD_PICTURES_NAMED:
        print(f"left out: {len(summary.bad) - BAD_PICTURES_NAMED} more bad pictures", file=sys.stderr)
    print(f"{summary.frames} frames, {summary.readings} readings: {summary.outcome_words()}")
    print(f"mean quality {summary.mean_quality:.2f}; light {', '.join(f'{k} {n}' for k, n in summary.lights.items())}")
    print(
        "empty setup: " + ("learnt from the frames, for there are no background pictures" if learnt else "background")
    )
    print(f"wrote {output}" + (f" and {overlays}" if overlays else ""))


def _camera(
    source: RunSource | FolderSource | FilmSource, anchor: str | None, px_per_cm: float | None
) -> CameraSection:
    """Anchor and scale from the options, else from ``run.toml``."""
    known = source.run.camera if isinstance(source, RunSource) else None
    if known is None and (anchor is None or px_per_cm is None):
        raise BadInput(
            f"{source.name}: has no run.toml; say where the stem leaves the soil (--anchor X,Y) and the scale "
            "(--px-per-cm N)"
        )
    place = _numbers(anchor, 2, "--anchor") if anchor is not None else known.anchor_px if known else None
    scale = px_per_cm if px_per_cm is not None else known.px_per_cm if known else None
    width, height = source.size_px
    try:
        return msgspec.convert(
            {"anchor_px": place, "px_per_cm": scale, "width_px": width, "height_px": height}, CameraSection
        )
    except msgspec.ValidationError as problem:
        raise BadInput(f"--anchor or --px-per-cm: {problem}") from problem


def _settings(
    source: RunSource | FolderSource | FilmSource,
    *,
    window: str | None,
    reduction: int | None,
    theta_1: float,
    theta_2_px: float,
    smallest_component: int,
) -> PaperSettings:
    if reduction is None:
        reduction = max((r for r in (1, 2, 4, 8) if source.size_px[0] / r >= PAPER_SAMPLING_PX), default=1)
    try:
        return msgspec.convert(
            {
                "theta_1": theta_1,
                "theta_2_px": theta_2_px,
                "reduction": reduction,
                "window_px": _numbers(window, 4, "--window") if window is not None else None,
                "smallest_component_px": smallest_component,
            },
            PaperSettings,
        )
    except msgspec.ValidationError as problem:
        raise BadInput(f"settings: {str(problem).replace('$.', '')}") from problem


def _numbers(text: str, count: int, option: str) -> list[float]:
    parts = text.split(",")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(math.isfinite(n) for n in numbers):
        raise BadInput(f"{option}: `{text[:60]}` is not {count} numbers in px with commas between them")
    return numbers


def _parse_span(text: str) -> tracking.Span:
    found = re.fullmatch(r"(\d{0,9}):(\d{0,9})", text)
    if not found:
        raise BadInput(f"--frames: `{text[:40]}` is not A:B, such as 0:83 or 10:")
    return tracking.Span(int(found[1] or 0), int(found[2]) if found[2] else None)


@contextlib.contextmanager
def _progress(silent: bool) -> Iterator[Callable[[str, int | None], Callable[[], None]]]:
    """A bar per stage on a terminal, nothing elsewhere. Yields: stage name and length to a step function."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=silent or not console.is_terminal, transient=True) as progress:

        def stage(name: str, total: int | None) -> Callable[[], None]:
            task = progress.add_task(name, total=total)
            return lambda: progress.advance(task)

        yield stage
