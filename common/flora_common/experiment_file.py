"""``outcome.json``: what one experiment with one plant came to; `flora-twin experiment` writes it, the lab reads it.

Fitness, end and distances follow from ``track.csv`` alone, as `flora-lab report` works them out for any run; what only
a virtual grow box can know stands apart, under ``true``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from flora_common.errors import BadInput
from flora_common.files import write_bytes
from flora_common.runs import ObstacleSection, PositiveCm, TargetSection

NAME: Final = "outcome.json"
FORMAT: Final = "flora-experiment-1"

Ended = Literal["collision", "height", "time"]
"""Why a run was over: the stem touched the obstacle, the tip was high enough, or neither within its time."""

Fitness = Annotated[float, msgspec.Meta(ge=-1e6, le=1.0)]
Hours = Annotated[float, msgspec.Meta(ge=0.0, le=1e5)]
Distance = Annotated[float, msgspec.Meta(ge=0.0, le=1e4)]
Count = Annotated[int, msgspec.Meta(ge=0)]


class Controller(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Who steered: the file's name, or a built-in rule's; ``sha256`` of the file is empty for a rule."""

    name: Annotated[str, msgspec.Meta(min_length=1)]
    sha256: Annotated[str, msgspec.Meta(pattern=r"^([0-9a-f]{64})?$(?!\n)")] = ""


class Measured(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the rig measured, up to the end of the run.

    Attributes:
        ended: why.
        ended_h: when.
        fitness_at_target: when the tip first lay in the target's circle, which is what the paper tells of its real
            plants; None where it never did.
        target_reached_h: when that was.
        fitness_at_end: of the tip at the end.
        best_fitness: on the way.
        clearance_cm: the least distance of stem and obstacle.
        photographs, stems: how many, and in how many of them a stem was found.
        lamp_changes: how often the light changed sides.
    """

    ended: Ended
    ended_h: Hours
    fitness_at_target: Fitness | None
    target_reached_h: Hours | None
    fitness_at_end: Fitness
    best_fitness: Fitness
    clearance_cm: Distance
    photographs: Count
    stems: Count
    lamp_changes: Count


class Really(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What was really there at the measured stems.

    Attributes:
        clearance_cm: the least distance of the true stem and the obstacle.
        tip_off_median_cm, tip_off_p95_cm: the measured tip from the true one.
    """

    clearance_cm: Distance
    tip_off_median_cm: Distance
    tip_off_p95_cm: Distance


class Pictures(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Photographs that were announced, and what became of them."""

    announced: Count
    missing: Count
    torn: Count
    not_stored: Count


class ExperimentFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole file.

    Attributes:
        format: of the file.
        software: that made it.
        controller: who steered.
        seed: the plant's individual.
        target, obstacle: the task.
        hours: the run would have ended after this time at the latest.
        stop_height_cm: or with the tip as high.
        measured: what it came to.
        true: what was really there; None where nobody knows.
        pictures: whether all photographs are whole.
        restarts: how often each process had to be started again.
        took_s: real seconds.
        run: the run folder, from the file's own folder.
    """

    format: Literal["flora-experiment-1"]
    software: str
    controller: Controller
    seed: Count
    target: TargetSection
    obstacle: ObstacleSection
    hours: Hours
    stop_height_cm: PositiveCm
    measured: Measured
    true: Really | None
    pictures: Pictures
    restarts: dict[str, Count]
    took_s: Annotated[float, msgspec.Meta(ge=0.0)]
    run: str


def write_experiment(folder: Path, outcome: ExperimentFile) -> None:
    """Write ``outcome.json`` into a folder, whole or not at all."""
    write_bytes(folder / NAME, msgspec.json.format(msgspec.json.encode(outcome), indent=1) + b"\n")


def read_experiment(folder: Path) -> ExperimentFile:
    """The ``outcome.json`` of a folder, checked.

    Raises:
        BadInput: it cannot be read or is not one, or its run folder lies elsewhere; one line with the file.
    """
    path = folder / NAME
    try:
        outcome = msgspec.json.decode(path.read_bytes(), type=ExperimentFile)
    except OSError as problem:
        raise BadInput(f"{path}: cannot be read ({problem.strerror})") from problem
    except (ValueError, RecursionError) as problem:
        raise BadInput(f"{path}: not the outcome of an experiment: {problem}") from problem
    inner = Path(outcome.run)
    if inner.is_absolute() or ".." in inner.parts:
        raise BadInput(f"{path}: run `{outcome.run[:60]}` must be a relative path inside the folder")
    return outcome
