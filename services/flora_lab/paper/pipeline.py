"""The steps of the paper's work, from plants to reality, as commands of this project."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from typing import Final, Literal

from flora_lab.evaluate.command import SEED as PLANTS_SEED
from flora_lab.evaluate.command import TWIN
from flora_lab.evaluate.on_twin import TWIN_COMMAND
from flora_lab.evolve.evolution_folder import BEST_FILE
from flora_lab.evolve.task import LEFT, MIDDLE, REALITY, ROUND, Task
from flora_lab.evolve.task_file import task_text
from flora_lab.paper.scales import PIXEL_CM, Asked, Evolving, Scale
from flora_lab.paper.steps import Given, Made, Step, Word

LAB_COMMAND: Final = "flora-lab"
RUNS: Final = "runs"
PIXEL_RUNS: Final = "runs-in-pixels"
DATA: Final = "data"
TASK_FILE: Final = "reality.toml"

Side = Literal["paper", "own"]
SIDES: Final[tuple[Side, Side]] = ("paper", "own")
"""The simulator of the paper's recipe, and that of ours."""
SIMULATORS: Final[Mapping[Side, str]] = {"paper": "paper.simulator", "own": "own.simulator"}
SIDE_WORDS: Final[Mapping[Side, str]] = {"paper": "the paper's recipe", "own": "our recipe"}
TASKS: Final = (LEFT, MIDDLE)
EVOLVED_FOR_REALITY: Final[Mapping[Side, Task]] = {"paper": LEFT, "own": ROUND}
"""What the controllers that meet plants through the whole rig were evolved for: the paper's took one of ``left``."""


def evolution_name(side: Side, task: Task) -> str:
    """Of the evolution's folder."""
    return f"evolved-{task.name}-{side}"


def reality_name(side: Side) -> str:
    """Of the folder in which the best controller from one simulator meets virtual plants."""
    return f"reality-{side}"


def reality_task(scale: Scale) -> Task:
    """The paper's experiment with real plants, at this scale's length; under another name where it is shorter."""
    if scale.reality_hours == REALITY.hours:
        return REALITY
    return replace(REALITY, name=f"reality-{scale.reality_hours:g}h", hours=scale.reality_hours)


def steps_of(asked: Asked, *, is_silent: bool) -> list[Step]:
    """All steps, each after those that it is made from.

    Args:
        asked: for.
        is_silent: commands are to say nothing but errors.
    """
    quiet = ("--quiet",) if is_silent else ()
    return [
        _runs(asked, RUNS, "the dataset experiments, as the plants were", ()),
        _runs(
            asked,
            PIXEL_RUNS,
            "the same plants in whole pixels of the paper's small photographs",
            ("--pixel-cm", f"{PIXEL_CM:g}"),
        ),
        Step(
            DATA,
            "the paper's training set",
            LAB_COMMAND,
            ("dataset", Made(PIXEL_RUNS, "*"), "--seed", str(asked.seed)),
            others=quiet,
        ),
        *_simulators(asked, quiet),
        *(_evolution(asked, side, task, evolving(asked.scale, side), quiet) for side, task in product(SIDES, TASKS)),
        _evolution(asked, "own", ROUND, asked.scale.for_reality, quiet),
        *(_reality(asked, side, quiet) for side in SIDES),
    ]


def _runs(asked: Asked, name: str, title: str, more: tuple[str, ...]) -> Step:
    scale = asked.scale
    words = ("runs", "--seed", str(asked.seed), "--hours", f"{scale.run_hours:g}")
    counts = ("--open-loop", str(scale.open_loop), "--closed-loop", str(scale.closed_loop))
    return Step(name, title, TWIN_COMMAND, (*words, *counts, *more))


def _simulators(asked: Asked, quiet: tuple[str, ...]) -> list[Step]:
    scale, seed = asked.scale, ("--seed", str(asked.seed))
    own_epochs = () if scale.own_epochs is None else ("--epochs", str(scale.own_epochs))
    given: dict[Side, tuple[Word, ...]] = {
        "paper": (Made(DATA), "--recipe", "paper", "--epochs", str(scale.paper_epochs)),
        "own": (Made(RUNS, "*"), "--recipe", scale.own_recipe, *own_epochs),
    }
    return [
        Step(
            SIMULATORS[side],
            f"a simulator by {SIDE_WORDS[side]}",
            LAB_COMMAND,
            ("train", *words, *seed),
            goes_on=("--resume",),
            anew=("--force",),
            others=quiet,
        )
        for side, words in given.items()
    ]


def _evolution(asked: Asked, side: Side, task: Task, size: Evolving, quiet: tuple[str, ...]) -> Step:
    sizes = {
        "--runs": size.runs,
        "--generations": size.generations,
        "--population": size.population,
        "--individuals": size.individuals,
        "--seed": asked.seed,
    }
    words = [text for name, value in sizes.items() for text in (name, str(value))]
    if size.neat is not None:
        words += ["--neat", size.neat]
    return Step(
        evolution_name(side, task),
        f"evolution for the task {task.name} in the simulator of {SIDE_WORDS[side]}",
        LAB_COMMAND,
        ("evolve", Made(SIMULATORS[side]), "--task", task.name, *words),
        goes_on=("--resume",),
        anew=("--force",),
        others=(*_jobs(asked), *quiet),
    )


def _jobs(asked: Asked) -> tuple[str, ...]:
    return () if asked.jobs is None else ("--jobs", str(asked.jobs))


def _reality(asked: Asked, side: Side, quiet: tuple[str, ...]) -> Step:
    """A recipe's best controller on plants that nobody has met."""
    places: list[Word] = [word for simulator in SIMULATORS.values() for word in ("--on", Made(simulator))]
    plants = ("--repeat", str(asked.scale.plants), "--seed", str(PLANTS_SEED))
    task = reality_task(asked.scale)
    named: Word = task.name if task is REALITY else Given(TASK_FILE, task_text(task))
    evolved_for = EVOLVED_FOR_REALITY[side]
    controller = Made(evolution_name(side, evolved_for), BEST_FILE)
    return Step(
        reality_name(side),
        f"the best {evolved_for.name} controller of {SIDE_WORDS[side]} on virtual plants, through the whole rig",
        LAB_COMMAND,
        ("evaluate", controller, *places, "--on", TWIN, "--task", named, *plants),
        others=(*_jobs(asked), *quiet),
        is_whole=False,
    )


def evolving(scale: Scale, side: Side) -> Evolving:
    """The size of an evolution."""
    return scale.in_paper if side == "paper" else scale.in_own
