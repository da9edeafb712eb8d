"""``flora-lab dataset``: its options, and what it says."""

from __future__ import annotations

import enum
import json
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec
import typer
from rich.console import Console

from flora_common.counted import counted
from flora_common.errors import BadInput
from flora_lab.dataset.build import Built, build
from flora_lab.dataset.recipe import (
    PAPER_VECTORS,
    STEPS,
    TRACKS,
    GenericSettings,
    NoiseSettings,
    Recipe,
    SparseSettings,
    steps_named,
)
from flora_lab.dataset.store import Dataset, check_output, write_dataset
from flora_lab.option_values import refusal
from flora_lab.run_tracks import load_runs

_R, _S, _N, _G = Recipe(), SparseSettings(), NoiseSettings(), GenericSettings()
_NUMBERS = "Numbers of the steps"
_OPTIONS: Final = {
    "interval_s": "--interval-s",
    "unit_cm": "--unit-cm",
    "duplicate_cm": "--duplicate-cm",
    "jump_times": "--jump-times",
    "sparse.cell_cm": "--cell-cm",
    "sparse.min_runs": "--min-runs",
    "sparse.min_tips": "--min-tips",
    "noise.theta_3": "--theta-3",
    "noise.omega": "--omega",
    "noise.sequences": "--noise-sequences",
    "generic.share": "--generic-share",
    "generic.window_h": "--generic-hours",
}
"""By the place in the recipe."""


class NoiseMeanName(enum.StrEnum):
    """How eq. 12 is read; see :mod:`flora_lab.dataset.noise`."""

    OFFSET = "offset"
    ZERO = "zero"
    PRINTED = "printed"


def register(app: typer.Typer) -> None:
    """Add the subcommand to ``flora-lab``."""
    app.command("dataset")(dataset)


def dataset(
    runs: Annotated[
        list[Path] | None, typer.Argument(metavar="RUNS...", help="Run folders with a track.csv, or tracks.")
    ] = None,
    *,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="The folder to write.")] = None,
    without: Annotated[list[str] | None, typer.Option(metavar="STEP", help="Leave a step out; repeatable.")] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Of the noise.")] = _R.seed,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing training set.")] = False,
    list_steps: Annotated[bool, typer.Option("--list-steps", help="Print the steps and end.")] = False,
    skip_other_lights: Annotated[
        bool, typer.Option("--skip-other-lights", help="Leave out rows under `dark` or `both`.")
    ] = False,
    interval_s: Annotated[float, typer.Option(help="Seconds from one row to the next.")] = _R.interval_s,
    unit_cm: Annotated[float, typer.Option(help="The normalised unit, in cm.")] = _R.unit_cm,
    cell_cm: Annotated[float, typer.Option(help="Side of an area.", rich_help_panel=_NUMBERS)] = _S.cell_cm,
    min_runs: Annotated[
        int, typer.Option(help="Runs that must have come to an area.", rich_help_panel=_NUMBERS)
    ] = _S.min_runs,
    min_tips: Annotated[
        int, typer.Option(help="Tips that must be in an area.", rich_help_panel=_NUMBERS)
    ] = _S.min_tips,
    theta_3: Annotated[
        int, typer.Option(help="Nearest tips that noise is from.", rich_help_panel=_NUMBERS)
    ] = _N.theta_3,
    omega: Annotated[float, typer.Option(help="Scale of the noise.", rich_help_panel=_NUMBERS)] = _N.omega,
    noise_sequences: Annotated[int, typer.Option(help="Noisy copies.", rich_help_panel=_NUMBERS)] = _N.sequences,
    noise_mean: Annotated[
        NoiseMeanName, typer.Option(help="How eq. 12 is read.", rich_help_panel=_NUMBERS)
    ] = NoiseMeanName.OFFSET,
    generic_share: Annotated[
        float, typer.Option(help="Share of stems in the smoothest movements.", rich_help_panel=_NUMBERS)
    ] = _G.share,
    generic_hours: Annotated[float, typer.Option(help="Length of a movement.", rich_help_panel=_NUMBERS)] = _G.window_h,
    duplicate_cm: Annotated[
        float, typer.Option(help="Stems are equal if nothing moved by more.", rich_help_panel=_NUMBERS)
    ] = _R.duplicate_cm,
    jump_times: Annotated[
        float, typer.Option(help="A jump is this many times the mean.", rich_help_panel=_NUMBERS)
    ] = _R.jump_times,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the counts as one JSON object.")] = False,
) -> None:
    """Make a training set from tracks, as in Wahby et al. 2018.

    Each vector holds nine points of a stem and the lamp (19 numbers), and the points five minutes later (18).

    --list-steps names the steps that --without takes.
    """
    if list_steps:
        typer.echo(_steps_text(as_json=as_json), nl=False)
        return
    if not runs:
        raise BadInput("no RUNS given: name run folders or tracks (see flora-lab dataset --help)")
    if output is None:
        raise BadInput("-o is missing: name the folder to write")
    recipe = _recipe(
        without=steps_named(without or []),
        seed=seed,
        unit_cm=unit_cm,
        interval_s=interval_s,
        skip_other_lights=skip_other_lights,
        duplicate_cm=duplicate_cm,
        jump_times=jump_times,
        sparse={"cell_cm": cell_cm, "min_runs": min_runs, "min_tips": min_tips},
        noise={"sequences": noise_sequences, "theta_3": theta_3, "omega": omega, "mean": noise_mean.value},
        generic={"share": generic_share, "window_h": generic_hours},
    )
    check_output(output, force=force)
    console = Console(stderr=True)
    silent = quiet or as_json or not console.is_terminal
    with console.status("reading tracks") as status:
        if silent:
            status.stop()
        tracks = load_runs(runs)
        built = build(tracks, recipe, on_step=status.update)
        status.update("writing")
        made = write_dataset(output, built, tracks, recipe, force=force)
    if as_json:
        typer.echo(json.dumps(numbers(made, output)))
    elif not quiet:
        typer.echo(counts_text(built), nl=False)
        typer.echo(f"wrote {output}: {counted(len(built.pairs), 'vector')} of {counted(len(tracks), 'run')}")


def numbers(made: Dataset, output: Path) -> dict[str, Any]:
    """The figures that scripts want."""
    return {
        "output": str(output),
        "vectors": made.info.vectors,
        "paper_vectors": PAPER_VECTORS,
        "data_sha256": made.info.data_sha256,
        "counts": msgspec.to_builtins(made.info.count),
        "runs": [run.name for run in made.info.run],
        "recipe": msgspec.to_builtins(made.info.recipe),
    }


def counts_text(built: Built) -> str:
    """The table of counts beside the paper's only one."""
    lines = [f"{'after':<16}{'stems':>9}{'vectors':>10}{'paper':>10}"]
    for place, count in enumerate(built.counts):
        paper = f"{PAPER_VECTORS}" if place == len(built.counts) - 1 else "-"
        lines.append(f"{count.step:<16}{count.stems:>9}{count.vectors:>10}{paper:>10}")
    return "\n".join(lines) + "\n"


def _recipe(**values: Any) -> Recipe:
    """The options as a recipe."""
    try:
        return msgspec.convert(values, Recipe)
    except msgspec.ValidationError as problem:
        raise refusal(problem, values, _OPTIONS, "recipe") from problem


def _steps_text(*, as_json: bool) -> str:
    if as_json:
        return json.dumps([{"step": s.name, "source": s.source, "does": s.does} for s in STEPS]) + "\n"
    first = f"{TRACKS:<16}{'':<22}the stems as they were measured"
    return "\n".join([first, *(f"{s.name:<16}{s.source:<22}{s.does}" for s in STEPS)]) + "\n"
