"""``flora-lab train``: its options, and what it says."""

from __future__ import annotations

import enum
import json
from pathlib import Path
from typing import Annotated, Any

import typer

from flora_common.errors import BadInput
from flora_common.suggest import did_you_mean
from flora_lab.dataset.store import INFO_FILE as DATASET_INFO_FILE
from flora_lab.option_values import must_not
from flora_lab.run_tracks import load_runs
from flora_lab.simulator.store import SimulatorFile, check_output, write_simulator
from flora_lab.stopped_work import going_on, sigterm_ends, unfinished
from flora_lab.train.checkpoint import checkpoint_path
from flora_lab.train.progress import shown
from flora_lab.train.recipes import DEFAULT_RECIPE, RECIPES, Progress, Trained, TrainOptions


class SplitBy(enum.StrEnum):
    """See :mod:`flora_lab.train.split`."""

    ROWS = "rows"
    PLANT = "plant"


def register(app: typer.Typer) -> None:
    """Add the subcommand to ``flora-lab``."""
    app.command("train")(train)


def train(
    inputs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="INPUTS...", help="Run folders with a track.csv, or tracks; or one training set."),
    ] = None,
    *,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="The simulator folder to write.")] = None,
    recipe: Annotated[str, typer.Option(help=f"How to learn: {', '.join(RECIPES)}.")] = DEFAULT_RECIPE,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Of everything that is drawn.")] = 1,
    epochs: Annotated[int | None, typer.Option(min=1, max=1_000_000, help="At most.")] = None,
    patience: Annotated[
        int | None, typer.Option(min=1, max=1_000_000, help="Epochs without a better validation loss.")
    ] = None,
    batch: Annotated[int | None, typer.Option(min=1, max=100_000, help="Rows per step.")] = None,
    split: Annotated[
        SplitBy | None, typer.Option(help="Hold whole plants out, or shuffle rows as the paper did.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where the same command was stopped.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace what is there, unfinished or not.")] = False,
    tensorboard: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Also write TensorBoard's event files.")
    ] = None,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the errors as one JSON object.")] = False,
) -> None:
    """Learn a simulator from tracks.

    Where an option is not given the recipe decides; `paper` does as Wahby et al. 2018.

    Who stops it with Ctrl-C, or loses power, goes on with --resume and comes to the same simulator.
    """
    if not inputs:
        raise BadInput("no INPUTS given: name run folders, tracks, or a training set (see flora-lab train --help)")
    if output is None:
        raise BadInput("-o is missing: name the folder to write")
    if recipe not in RECIPES:
        raise BadInput(f"--recipe: no recipe `{recipe[:40]}`{did_you_mean(recipe, RECIPES)}")
    check_output(output, force=force)
    checkpoint = checkpoint_path(output)
    if checkpoint.exists() and not (resume or force):
        raise unfinished(checkpoint, "training")
    options = TrainOptions(
        seed=seed,
        checkpoint=checkpoint,
        resume=resume,
        epochs=epochs,
        patience=patience,
        batch=batch,
        split=split.value if split else None,
    )
    for name in RECIPES[recipe].without:
        must_not(f"--{name}", getattr(options, name), f"--recipe {recipe} has no use for it")
    silent = quiet or as_json
    with sigterm_ends(), shown(silent=silent, quiet=silent, tensorboard=tensorboard) as progress:
        try:
            trained = _learn(recipe, inputs, options, progress)
        except (KeyboardInterrupt, SystemExit):
            if checkpoint.exists():
                progress.note(f"what was learned is kept in {checkpoint}; {going_on()}")
            raise
        progress.stage("writing")
        info = write_simulator(
            output,
            kind=trained.kind,
            step_s=trained.step_s,
            weights=trained.weights,
            scales=trained.scales,
            provenance=trained.provenance,
            figures=trained.figures,
            force=force,
        )
        checkpoint.unlink(missing_ok=True)
    if as_json:
        typer.echo(json.dumps(numbers(info, output)))
    elif not quiet:
        typer.echo("\n".join([*trained.table, f"wrote {output}"]))


def numbers(info: SimulatorFile, output: Path) -> dict[str, Any]:
    """The figures that scripts want."""
    return {
        "output": str(output),
        "recipe": info.provenance.recipe,
        "kind": info.kind,
        "step_s": info.step_s,
        "weights_sha256": info.weights_sha256,
        "dataset_sha256": info.provenance.dataset_sha256,
        "seed": info.provenance.seed,
        "split": info.provenance.split,
        "results": info.provenance.results,
    }


def _learn(recipe: str, inputs: list[Path], options: TrainOptions, progress: Progress) -> Trained:
    entry = RECIPES[recipe]
    data = [path for path in inputs if (path / DATASET_INFO_FILE).is_file()]
    if not data:
        runs = load_runs(inputs)
        return entry.from_runs()(runs, options, progress)
    if not entry.takes_data:
        raise BadInput(f"{data[0]}: is a training set; --recipe {recipe} learns from runs, name those")
    if len(inputs) > 1:
        raise BadInput(f"{data[0]}: is a training set; name it alone, or runs only")
    return entry.from_data()(data[0], options, progress)
