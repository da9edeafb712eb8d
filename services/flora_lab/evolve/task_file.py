"""Tasks as TOML files, and what a task must hold so that a plant can be set it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import msgspec
import numpy as np

from flora_common.controller_file import Label
from flora_common.errors import BadInput
from flora_common.geometry import collides
from flora_common.paper_experiment import RUN_HOURS, STOP_HEIGHT_CM
from flora_common.runs import Cm, ObstacleSection, PositiveCm, TargetSection
from flora_common.shapes import STEM_POINTS, Obstacle, Target
from flora_common.suggest import did_you_mean
from flora_common.task_places import check_places
from flora_common.toml_strict import convert, read_toml, to_toml
from flora_lab.evolve.task import BUILT_IN, START_CM, Scenario, Stem, Task, straight_stem
from flora_lab.simulator.measured import STEP_S

MOST_SCENARIOS: Final = 100
"""As many obstacles as a controller file can name."""


class StartSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[start]``: a straight stem by its tip, or a whole one by its points."""

    height_cm: PositiveCm | None = None
    tip_x_cm: Cm | None = None
    points_cm: Annotated[list[tuple[Cm, Cm]], msgspec.Meta(min_length=STEM_POINTS, max_length=STEM_POINTS)] | None = (
        None
    )


class ScenarioSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[[scenario]]``; target and obstacle are those of the task where it has none of its own."""

    name: Label | None = None
    possible: bool = True
    target: TargetSection | None = None
    obstacle: ObstacleSection | None = None


class TaskFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A task as a file; see docs/reference/task-file.md."""

    name: Label
    hours: Annotated[float, msgspec.Meta(ge=STEP_S / 3600.0, le=1000.0)] = RUN_HOURS
    stop_height_cm: PositiveCm = STOP_HEIGHT_CM
    collision_at_most: Annotated[float, msgspec.Meta(ge=-10.0, le=1.0)] | None = None
    start: StartSection = StartSection()
    target: TargetSection | None = None
    obstacle: ObstacleSection | None = None
    scenario: Annotated[list[ScenarioSection], msgspec.Meta(max_length=MOST_SCENARIOS)] = []


def task_named(text: str, option: str = "--task") -> Task:
    """What ``--task`` means: the name of a built-in task, or the path of a file.

    Args:
        text: as it was given.
        option: that it was given with, for errors.

    Raises:
        BadInput: neither, or a file that is no task; one line that says what and where.
    """
    if text in BUILT_IN:
        return BUILT_IN[text]
    path = Path(text)
    if path.suffix != ".toml" and not path.is_file():
        names = ", ".join(BUILT_IN)
        raise BadInput(f"{option} {text[:80]}: neither a built-in task ({names}) nor a file{_near(text)}")
    return read_task(path)


def read_task(path: Path) -> Task:
    """A task file, checked.

    Raises:
        BadInput: it cannot be read, is not TOML, or see :func:`check_task`.
    """
    file = convert(read_toml(path, BadInput), TaskFile, where=str(path), error=BadInput)
    scenarios = tuple(_scenario(file, k, str(path)) for k in range(len(file.scenario)))
    start = _start(file.start, str(path))
    task = Task(file.name, scenarios, start, file.stop_height_cm, file.hours, file.collision_at_most)
    check_task(task, str(path))
    return task


def task_text(task: Task) -> str:
    """A task as TOML; reading it back gives an equal one."""
    scenarios = [
        ScenarioSection(
            scenario.name,
            scenario.is_possible,
            TargetSection(scenario.target.x_cm, scenario.target.y_cm, scenario.target.radius_cm),
            ObstacleSection(
                scenario.obstacle.x_cm, scenario.obstacle.y_cm, scenario.obstacle.width_cm, scenario.obstacle.height_cm
            ),
        )
        for scenario in task.scenarios
    ]
    start = StartSection(points_cm=[(x, y) for x, y in task.start_cm])
    most = task.collision_at_most
    return to_toml(TaskFile(task.name, task.hours, task.stop_height_cm, most, start, scenario=scenarios))


def check_task(task: Task, where: str) -> None:
    """Whether a plant can be set this task at all.

    Args:
        task: any.
        where: it is from; the error begins with it.

    Raises:
        BadInput: the first thing that does not hold, in one line.
    """
    if not task.scenarios:
        raise BadInput(f"{where}: a task without scenarios; add at least one [[scenario]] with an obstacle")
    if task.name in BUILT_IN and task != BUILT_IN[task.name]:
        raise BadInput(f"{where}: `{task.name}` is the name of the paper's task; give this one a name of its own")
    _check_start(task, where)
    names: set[str] = set()
    for scenario in task.scenarios:
        if scenario.name in names:
            raise BadInput(f"{where}: two scenarios are called `{scenario.name}`; give each a name of its own")
        names.add(scenario.name)
        _check_scenario(task, scenario, f"{where} [[scenario]] {scenario.name}")
    if not task.is_possible.any():
        raise BadInput(f"{where}: no scenario is possible; leave `possible = false` out of at least one")


def _check_start(task: Task, where: str) -> None:
    stem = task.start_stem_cm
    if not np.isfinite(stem).all():
        raise BadInput(f"{where} [start]: holds a number that is not finite")
    if stem[0].any():
        raise BadInput(f"{where} [start]: the first point is the anchor; it must be [0.0, 0.0]")
    tip_cm = float(stem[-1, 1])
    if not 0.0 < tip_cm < task.stop_height_cm:
        raise BadInput(
            f"{where} [start]: the tip is {tip_cm:g} cm high; it must be above 0 cm and below stop_height_cm, "
            f"{task.stop_height_cm:g} cm"
        )


def _check_scenario(task: Task, scenario: Scenario, where: str) -> None:
    check_places(scenario.target, scenario.obstacle, stop_height_cm=task.stop_height_cm, where=where)
    if collides(task.start_stem_cm, scenario.obstacle):
        raise BadInput(f"{where}: the obstacle touches the stem that runs start from")


def _scenario(file: TaskFile, place: int, where: str) -> Scenario:
    section = file.scenario[place]
    name = section.name or str(place + 1)
    target, obstacle = section.target or file.target, section.obstacle or file.obstacle
    if target is None or obstacle is None:
        kind = "target" if target is None else "obstacle"
        raise BadInput(f"{where} [[scenario]] {name}: has no {kind}; add [scenario.{kind}], or [{kind}] for all")
    return Scenario(
        name,
        Target(target.x_cm, target.y_cm, target.radius_cm),
        Obstacle(obstacle.x_cm, obstacle.y_cm, obstacle.width_cm, obstacle.height_cm),
        section.possible,
    )


def _start(section: StartSection, where: str) -> Stem:
    if section.points_cm is None:
        return straight_stem(
            START_CM if section.height_cm is None else section.height_cm,
            0.0 if section.tip_x_cm is None else section.tip_x_cm,
        )
    if section.height_cm is not None or section.tip_x_cm is not None:
        raise BadInput(f"{where} [start]: give points_cm, or height_cm and tip_x_cm, not both")
    return tuple(section.points_cm)


def _near(text: str) -> str:
    hint = did_you_mean(text, BUILT_IN)
    return hint if "did you mean" in hint else ""
