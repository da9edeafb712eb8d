"""``flora-lab evolve``: its options, and what it says."""

from __future__ import annotations

import enum
import json
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from flora_common.errors import BadInput
from flora_lab.late import modules_of
from flora_lab.option_values import must_not
from flora_lab.stopped_work import going_on, nothing_kept, sigterm_ends

RUNS, GENERATIONS, POPULATION = 20, 1000, 150
"""Wahby et al. 2018: 20 runs of 1000 generations."""
MOST_RUNS = 10_000
MOST_GENERATIONS = 1_000_000
MOST_INDIVIDUALS = 1000


class JudgeBy(enum.StrEnum):
    """See :data:`flora_lab.evolve.individuals.Judge`."""

    MEAN = "mean"
    WORST = "worst"


_module = modules_of("flora_lab.evolve")


def register(app: typer.Typer) -> None:
    """Add the subcommand to ``flora-lab``."""
    app.command("evolve")(evolve)


def evolve(
    simulator: Annotated[Path, typer.Argument(metavar="SIM", help="The simulator folder to evolve in.")],
    *,
    task: Annotated[str, typer.Option(help="left, middle, reality, round, or a task file.")],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="The folder to write.")] = None,
    runs: Annotated[int, typer.Option(min=1, max=MOST_RUNS, help="Independent runs.")] = RUNS,
    generations: Annotated[int, typer.Option(min=1, max=MOST_GENERATIONS, help="Of each run.")] = GENERATIONS,
    population: Annotated[
        int | None, typer.Option(help="Controllers in a generation.", show_default=str(POPULATION))
    ] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Of all runs.")] = 1,
    individuals: Annotated[
        int, typer.Option(min=0, max=MOST_INDIVIDUALS, help="Drawn plants that each is tried on; 0: the typical one.")
    ] = 0,
    individuals_seed: Annotated[
        int | None, typer.Option(min=0, max=2**32 - 1, help="Which plants are drawn.", show_default="1")
    ] = None,
    judge: Annotated[
        JudgeBy | None, typer.Option(help="What counts over drawn plants.", show_default=JudgeBy.MEAN.value)
    ] = None,
    neat: Annotated[
        str | None,
        typer.Option(metavar="CFG", help="Settings of NEAT: sparse, or a file that names only what it changes."),
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, max=1000, help="Processes.", show_default="one per core")] = None,
    cluster: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Work on a Ray cluster: auto, HOST:PORT, ray://HOST:10001, local."),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where the same command was stopped.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace what is there, unfinished or not.")] = False,
    report: Annotated[bool, typer.Option("--report/--no-report", help="Write report.html and pictures.")] = True,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")] = False,
) -> None:
    """Evolve controllers by NEAT in a simulator.

    Who stops it with Ctrl-C, or loses power, goes on with --resume and comes to the same controllers.
    """
    if output is None:
        raise BadInput("-o is missing: name the folder to write")
    if jobs is not None and cluster is not None:
        raise BadInput("--jobs and --cluster: the cluster decides how many there are; leave one of them out")
    if individuals == 0:
        for option, value in (("--individuals-seed", individuals_seed), ("--judge", judge)):
            must_not(option, value, "no plants are drawn without --individuals")
    folder = _module("evolution_folder")
    folder.check_output(output, force=force)
    plan = _module("plan").Plan(
        parcel=_module("plan").parcel_of(simulator),
        task=_module("task_file").task_named(task),
        settings=_module("neat_settings").settings_named(neat, population=population),
        individuals=_module("individuals").Individuals(
            individuals, 1 if individuals_seed is None else individuals_seed, (judge or JudgeBy.MEAN).value
        ),
        runs=runs,
        generations=generations,
        seed=seed,
    )
    _module("reach").check_stems(plan.parcel.simulator, plan.task)
    illustrate = modules_of("flora_lab.evolve_report")("page").write_report if report else None
    with _module("kept_runs").KeptRuns(_module("kept_runs").kept_path(output), plan.work) as kept:
        try:
            with sigterm_ends(), _module("screen").shown(plan, is_silent=quiet or as_json) as screen:
                with _crew(plan, jobs, cluster) as crew:
                    if not kept.begin(resume=resume, force=force) and resume and not quiet:
                        print(nothing_kept(kept.path), file=sys.stderr)
                    states = _module("evolution").evolve(plan, kept, crew, screen)
                screen.stage("writing")
                worked = kept.worked
                info = _module("evolution_writing").write_evolution(
                    output,
                    plan,
                    states,
                    wall_s=worked.wall_s,
                    commands=worked.commands,
                    force=force,
                    illustrate=illustrate,
                )
        except (KeyboardInterrupt, SystemExit):
            if kept.path.exists() and not quiet:
                print(f"the runs are kept in {kept.path}; {going_on()}", file=sys.stderr)
            raise
        kept.remove()
    if as_json:
        typer.echo(json.dumps(_module("summary").as_json(info, output)))
    elif not quiet:
        typer.echo(_module("summary").text(info, output), nl=False)


def _crew(plan: Any, jobs: int | None, cluster: str | None) -> Any:
    crew = _module("crew")
    if cluster is not None:
        return _module("ray_crew").RayCrew(cluster, crew.SliceWork(plan))
    count = jobs if jobs is not None else len(os.sched_getaffinity(0))
    return crew.LocalCrew(min(count, plan.runs), crew.SliceWork(plan))
