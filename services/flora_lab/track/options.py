"""The options of ``flora-lab track``: how they are declared, which belong to which method, and what they mean."""

from __future__ import annotations

import enum
import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec
import typer

from flora_common.errors import BadInput
from flora_common.runs import CameraSection
from flora_common.vision.paper import PaperSettings
from flora_common.vision.path.reduced import WIDEST_STEM_PX
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.picture import REDUCTIONS, Reduction
from flora_lab.option_values import LEAST_S, LONGEST_STEP_S, refusal, within
from flora_lab.sources import FilmSource, FolderSource, RunSource, Source
from flora_lab.track.readings import Span

INTERVAL_S: Final = 300.0
LIGHT_RULE: Final = "auto"
PAPER_SAMPLING_PX: Final = 410
"""Width at which the published method looks at pictures: 1/8 of 3280 px."""


class MethodName(enum.StrEnum):
    """How the stem is found."""

    PATH = "path"
    PAPER = "paper"


class PointsName(enum.StrEnum):
    """How the ten points are spaced."""

    Y = "y"
    ARC = "arc"


_PATH, _PAPER = PathSettings(), PaperSettings()
_PATH_PANEL: Final = "Only with --method path"
_PAPER_PANEL: Final = "Only with --method paper"
_PICTURES_PANEL: Final = "Pictures to look at"

InputArgument = Annotated[Path, typer.Argument(metavar="INPUT", help="A run folder, a folder of pictures, or a film.")]
OutputOption = Annotated[Path, typer.Option("-o", "--output", help="The track to write.")]
ForceOption = Annotated[bool, typer.Option("--force", help="Overwrite an existing track, contact sheet or film.")]
MethodOption = Annotated[MethodName, typer.Option(help="How the stem is found: our own way, or as published.")]
JobsOption = Annotated[
    int | None, typer.Option(min=1, max=256, help="Threads that look at pictures.", show_default="one per core")
]
ResumeOption = Annotated[
    bool, typer.Option("--resume/--no-resume", help="Go on where the same command was killed, or begin anew.")
]
FramesOption = Annotated[
    str, typer.Option(metavar="A:B", help="Use frames A to B-1 only, from 0; either may be left out.")
]
AnchorOption = Annotated[
    str | None, typer.Option(metavar="X,Y", help="Where the stem leaves the soil, px.", show_default="run.toml")
]
ScaleOption = Annotated[float | None, typer.Option(help="Scale of the full picture.", show_default="run.toml")]
WindowOption = Annotated[
    str | None, typer.Option(metavar="X0,Y0,X1,Y1", help="Look inside this part of the picture only, px.")
]
ReductionOption = Annotated[
    int | None,
    typer.Option(
        help="Look at 1/N of the size: 1, 2, 4, 8.",
        show_default=f"path: as leaves the widest stem {WIDEST_STEM_PX:g} px; paper: nearest above 410 px width",
    ),
]
IntervalOption = Annotated[
    float | None,
    typer.Option(
        callback=within(LEAST_S, LONGEST_STEP_S),
        help="Seconds between frames, where no frames.csv says it.",
        show_default=f"{INTERVAL_S:g}",
    ),
]
LightOption = Annotated[
    str | None,
    typer.Option(
        metavar="RULE",
        help="Lamps, where no frames.csv says it: auto|picture|left|right|dark|both or left:0-46,right:47-93.",
        show_default=LIGHT_RULE,
    ),
]
QuietOption = Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the summary as one JSON object.")]

WidestOption = Annotated[
    float | None,
    typer.Option(
        help="What is thicker is leaf.", show_default=f"{_PATH.widest_stem_cm:g}", rich_help_panel=_PATH_PANEL
    ),
]
HiddenBaseOption = Annotated[
    float | None,
    typer.Option(
        help="Lowest part that may be hidden behind a rim.",
        show_default=f"{_PATH.hidden_base_cm:g}",
        rich_help_panel=_PATH_PANEL,
    ),
]
BelowAnchorOption = Annotated[
    float | None,
    typer.Option(
        help="How far below the anchor a stem may hang.",
        show_default=f"{_PATH.below_anchor_cm:g}",
        rich_help_panel=_PATH_PANEL,
    ),
]
PointsOption = Annotated[
    PointsName | None,
    typer.Option(
        help="Ten points even in height or along the stem.", show_default=_PATH.points, rich_help_panel=_PATH_PANEL
    ),
]

Theta1Option = Annotated[
    float | None,
    typer.Option(
        "--theta-1",
        help="How far green must leave the setup's range, 0..1.",
        show_default=f"{_PAPER.theta_1:g}",
        rich_help_panel=_PAPER_PANEL,
    ),
]
Theta2Option = Annotated[
    float | None,
    typer.Option(
        "--theta-2-px",
        help="Half height of an averaged band, px of a 3280 px wide picture.",
        show_default=f"{_PAPER.theta_2_px:g}",
        rich_help_panel=_PAPER_PANEL,
    ),
]
SmallestOption = Annotated[
    int | None,
    typer.Option(
        min=0, help="Drop groups of fewer stem pixels.", show_default="0, keep all", rich_help_panel=_PAPER_PANEL
    ),
]

OverlaysOption = Annotated[
    Path | None,
    typer.Option(
        help="A new folder for pictures with the stem drawn over, contact.png, readings.csv.",
        rich_help_panel=_PICTURES_PANEL,
    ),
]
ContactOption = Annotated[
    Path | None,
    typer.Option(metavar="FILE.png", help="The contact sheet alone.", rich_help_panel=_PICTURES_PANEL),
]
FilmOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.mp4", help="A film of the plant with the stem drawn over.", rich_help_panel=_PICTURES_PANEL
    ),
]
EveryOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Draw every N-th frame only.",
        show_default="1; on the contact sheet 20, evenly spread",
        rich_help_panel=_PICTURES_PANEL,
    ),
]


def settings_of(
    method: MethodName,
    source: Source,
    *,
    window: str | None,
    reduction: int | None,
    path: Mapping[str, Any],
    paper: Mapping[str, Any],
) -> PathSettings | PaperSettings:
    """The settings of a method.

    Args:
        method: which.
        source: pictures.
        window, reduction: as given, or None.
        path, paper: the options of each method by name, None where not given.

    Raises:
        BadInput: an option of the other method, or a number out of range.
    """
    own, foreign = (path, paper) if method is MethodName.PATH else (paper, path)
    other = MethodName.PAPER if method is MethodName.PATH else MethodName.PATH
    for name, value in foreign.items():
        if value is not None:
            raise BadInput(f"{OPTION_NAMES[name]}: is an option of --method {other}, not of --method {method}")
    values = {name: value for name, value in own.items() if value is not None}
    if window is not None:
        values["window_px"] = numbers(window, 4, "--window")
    if reduction is not None:
        if reduction not in REDUCTIONS:
            raise BadInput(f"--reduction: {reduction} is none of {', '.join(map(str, REDUCTIONS))}")
        values["reduction"] = reduction
    made: PathSettings | PaperSettings
    if method is MethodName.PATH:
        made = _converted(values, PathSettings)
        return made
    made = _converted({"reduction": paper_reduction(source.size_px[0]), **values}, PaperSettings)
    return made


def paper_reduction(width_px: int) -> Reduction:
    """The largest one that leaves a picture of that width its published sampling."""
    fitting = [r for r in REDUCTIONS if width_px / r >= PAPER_SAMPLING_PX]
    return max(fitting, default=1)


OPTION_NAMES: Final = {
    "widest_stem_cm": "--widest-stem-cm",
    "hidden_base_cm": "--hidden-base-cm",
    "below_anchor_cm": "--below-anchor-cm",
    "points": "--points",
    "reduction": "--reduction",
    "theta_1": "--theta-1",
    "theta_2_px": "--theta-2-px",
    "smallest_component_px": "--smallest-component",
    "window_px": "--window",
    "anchor_px": "--anchor",
    "px_per_cm": "--px-per-cm",
}
"""By the name of the setting."""


def camera_of(
    source: RunSource | FolderSource | FilmSource, anchor: str | None, px_per_cm: float | None
) -> CameraSection:
    """Anchor and scale from the options, else from ``run.toml``.

    Raises:
        BadInput: neither says it, or not as numbers that can be.
    """
    known = source.run.camera if isinstance(source, RunSource) else None
    if known is None and (anchor is None or px_per_cm is None):
        raise BadInput(
            f"{source.name}: has no run.toml; say where the stem leaves the soil (--anchor X,Y) and the scale "
            "(--px-per-cm N)"
        )
    width, height = source.size_px
    place = numbers(anchor, 2, "--anchor") if anchor is not None else known.anchor_px if known else None
    if anchor is not None and place is not None and not (0 <= place[0] <= width and 0 <= place[1] <= height):
        raise BadInput(f"--anchor: {anchor} lies outside of the picture of {width}x{height} px")
    scale = px_per_cm if px_per_cm is not None else known.px_per_cm if known else None
    values = {"anchor_px": place, "px_per_cm": scale, "width_px": width, "height_px": height}
    try:
        return msgspec.convert(values, CameraSection)
    except msgspec.ValidationError as problem:
        raise refusal(problem, values, OPTION_NAMES, f"{source.name}: the pictures' size") from problem


def span_of(text: str) -> Span:
    """``A:B``; raises BadInput."""
    found = re.fullmatch(r"(\d{0,9}):(\d{0,9})", text)
    if not found:
        raise BadInput(f"--frames: `{text[:40]}` is not A:B, such as 0:83 or 10:")
    return Span(int(found[1] or 0), int(found[2]) if found[2] else None)


def jobs_of(given: int | None, frames: int) -> int:
    """How many threads: as given; else one per core, as far as there are frames for them."""
    return given if given is not None else min(len(os.sched_getaffinity(0)), frames)


def numbers(text: str, count: int, option: str) -> list[float]:
    """Numbers with commas between them; raises BadInput."""
    parts = text.split(",")
    try:
        found = [float(part) for part in parts]
    except ValueError:
        found = []
    if len(found) != count or not all(math.isfinite(n) for n in found):
        raise BadInput(f"{option}: `{text[:60]}` is not {count} numbers in px with commas between them")
    return found


def _converted(values: dict[str, Any], kind: type[Any]) -> Any:
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as problem:
        raise refusal(problem, values, OPTION_NAMES, "--window") from problem
