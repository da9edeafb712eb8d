"""``flora-twin experiment``: one controller, one individual, one target and obstacle; ends where the run is over."""

from __future__ import annotations

import importlib.metadata
import math
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.console import Console

from flora_common import experiment_file
from flora_common.controller_file import LoadedController, load_controller
from flora_common.errors import BadInput
from flora_common.experiment_file import ExperimentFile, Measured, Pictures, Really, write_experiment
from flora_common.paper_experiment import REALITY_OBSTACLE, REALITY_TARGET, RUN_HOURS, STOP_HEIGHT_CM
from flora_common.runs import ObstacleSection, TargetSection
from flora_common.shapes import Obstacle, Target
from flora_common.task_places import check_places
from flora_common.toml_strict import convert
from flora_twin.rig.experiment import Experiment, check_photographs, parse_speed, run_experiment
from flora_twin.rig.layout import RIG_FOLDER
from flora_twin.rig.outcome import Outcome, tell
from flora_twin.seeds import Seed

TARGET_KEYS: Final = ("x_cm", "y_cm", "radius_cm")
OBSTACLE_KEYS: Final = ("x_cm", "y_cm", "width_cm", "height_cm")


def register(app: typer.Typer) -> None:
    """Add the subcommand to ``flora-twin``."""
    app.command("experiment")(experiment)


def experiment(
    *,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for outcome.json, report and run folder.")],
    controller: Annotated[str, typer.Option(help="Built-in controller, or a controller file.")] = "waypoint",
    target: Annotated[
        str, typer.Option(metavar="X,Y[,RADIUS]", help="In cm from the anchor; the paper's where missing.")
    ] = "",
    obstacle: Annotated[
        str, typer.Option(metavar="X,Y[,WIDTH,HEIGHT]", help="Centre and size in cm; the paper's where missing.")
    ] = "",
    seed: Seed = 1,
    hours: Annotated[float, typer.Option(min=0.1, max=2000.0, help="Longest run.")] = RUN_HOURS,
    stop_height_cm: Annotated[
        float, typer.Option("--stop-height", min=0.1, max=500.0, help="The run is over with the tip this high, in cm.")
    ] = STOP_HEIGHT_CM,
    speed: Annotated[
        str, typer.Option(help="lockstep (as fast as the services answer), realtime, or N times.")
    ] = "lockstep",
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Let a controller steer one virtual plant through the whole rig, and write down what it came to.

    The run ends as the paper's do: with the tip 21 cm high, when the stem touches the obstacle, or after 72 hours.
    """
    asked = Experiment(
        out=output,
        made_by="flora-twin experiment",
        start=datetime.now(UTC).replace(microsecond=0),
        seed=seed,
        rate=parse_speed(speed),
        hours=hours,
        controller=load_controller(Path(controller)) if controller.endswith(".json") else controller,
        target=_target(target),
        obstacle=_obstacle(obstacle),
        stop_height_cm=stop_height_cm,
        quiet=quiet,
    )
    check_places(
        asked.target,
        asked.obstacle,
        stop_height_cm=stop_height_cm,
        where="--target and --obstacle",
        stop_height="--stop-height",
    )
    console = Console(stderr=False)
    figures, outcome = run_experiment(asked, console)
    check_photographs(outcome)
    write_experiment(output, as_file(asked, figures, outcome))
    if not quiet:
        tell(console, output, figures, outcome)


def as_file(asked: Experiment, figures: dict[str, Any], outcome: Outcome) -> ExperimentFile:
    """What ``outcome.json`` says.

    Args:
        asked: the experiment.
        figures: of `flora-lab report`.
        outcome: what else happened.
    """
    sha256 = asked.controller.sha256 if isinstance(asked.controller, LoadedController) else ""
    truth = outcome.truth
    really = None
    if truth is not None and truth.clearance_cm is not None:
        really = Really(truth.clearance_cm, truth.tip_median_cm, truth.tip_p95_cm)
    target, obstacle = asked.target, asked.obstacle
    return ExperimentFile(
        format=experiment_file.FORMAT,
        software=f"flora {importlib.metadata.version('flora')}",
        controller=experiment_file.Controller(asked.controller_name, sha256),
        seed=asked.seed,
        target=TargetSection(target.x_cm, target.y_cm, target.radius_cm),
        obstacle=ObstacleSection(obstacle.x_cm, obstacle.y_cm, obstacle.width_cm, obstacle.height_cm),
        hours=asked.hours,
        stop_height_cm=asked.stop_height_cm,
        measured=Measured(
            ended=figures["ended"],
            ended_h=figures["stop_h"],
            fitness_at_target=figures["fitness_at_target"],
            target_reached_h=figures["target_reached_h"],
            fitness_at_end=figures["fitness_at_stop"],
            best_fitness=figures["best_fitness"],
            clearance_cm=figures["clearance_cm"],
            photographs=figures["frames"],
            stems=figures["readings"],
            lamp_changes=figures["lamp_changes"],
        ),
        true=really,
        pictures=Pictures(**asdict(outcome.integrity)),
        restarts=outcome.restarts,
        took_s=outcome.took_s,
        run=f"{RIG_FOLDER}/runs/bean",
    )


def _target(text: str) -> Target:
    if not text:
        return REALITY_TARGET
    table = _numbers(text, "--target", TARGET_KEYS, (2, 3), "X,Y or X,Y,RADIUS")
    section = convert(table, TargetSection, where="--target", error=BadInput)
    return Target(section.x_cm, section.y_cm, section.radius_cm)


def _obstacle(text: str) -> Obstacle:
    if not text:
        return REALITY_OBSTACLE
    table = _numbers(text, "--obstacle", OBSTACLE_KEYS, (2, 4), "X,Y or X,Y,WIDTH,HEIGHT")
    section = convert(table, ObstacleSection, where="--obstacle", error=BadInput)
    return Obstacle(section.x_cm, section.y_cm, section.width_cm, section.height_cm)


def _numbers(text: str, option: str, keys: tuple[str, ...], counts: tuple[int, int], form: str) -> dict[str, float]:
    """Numbers with commas between them, by their names.

    Raises:
        BadInput: anything else.
    """
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in counts or not all(math.isfinite(value) for value in values):
        raise BadInput(f"{option} `{text[:60]}`: write {form}, in cm, such as -6.3,12.5")
    return dict(zip(keys, values, strict=False))
