"""``*.lights.toml``: light by the run's time alone, decided before a run, and how long that run is to last.

`flora-lab diagnose` writes one for the experiment that would tell two causes apart; flora-controller steers by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import msgspec

from flora_common.errors import BadInput
from flora_common.files import sha256_of_file, write_bytes
from flora_common.light_schedule import LightSchedule, parse_schedule
from flora_common.toml_strict import convert, read_toml, to_toml

SUFFIX: Final = ".lights.toml"


class LightPlan(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A plan as it stands in its file."""

    schedule: Annotated[str, msgspec.Meta(min_length=1, max_length=16384)]
    """As :func:`flora_common.light_schedule.parse_schedule` reads it; ``left 6h, dark 6h, right 6h, dark``."""

    hours: Annotated[float, msgspec.Meta(gt=0.0, le=10_000.0)]
    """After which the run is over; the schedule goes on until somebody ends it."""


@dataclass(frozen=True, slots=True)
class ReadPlan:
    """A plan that was read and checked.

    Attributes:
        name: of the file.
        sha256: of the file.
        plan: what stands in it.
        light_at: what shines from a time of the run on, in seconds.
    """

    name: str
    sha256: str
    plan: LightPlan
    light_at: LightSchedule


def read_light_plan(path: Path) -> ReadPlan:
    """Read and check a light plan.

    Raises:
        BadInput: it cannot be read, is no plan, or no light shines so; the message names the file.
    """
    plan = convert(read_toml(path, BadInput), LightPlan, where=str(path), error=BadInput)
    try:
        light_at = parse_schedule(plan.schedule)
    except BadInput as problem:
        raise BadInput(f"{path}: {problem}") from problem
    return ReadPlan(path.name, sha256_of_file(path), plan, light_at)


def write_light_plan(path: Path, plan: LightPlan, remarks: Sequence[str] = ()) -> None:
    """Write a plan, whole or not at all, remarks above it."""
    text = "".join(f"# {line}\n" for line in remarks) + "\n" + to_toml(plan)
    write_bytes(path, text.encode())
