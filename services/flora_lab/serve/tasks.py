"""What the process that does the mathematics is asked; it alone loads numba and scipy."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flora_common.runs import LampsSection
from flora_lab.serve.heard import Row


@dataclass(frozen=True, slots=True)
class LearnTask:
    """Learn a simulator from a folder of healthy runs, and write it to a folder under a name of its content."""

    reference: Path
    output: Path


@dataclass(frozen=True, slots=True)
class LookTask:
    """Look at a run.

    Attributes:
        run: its name.
        rows: all up to now.
        lamps: where they hang; None where the simulator's own are meant.
        simulator: folder.
        watched: what was found before.
        false_alarms: rate per run.
    """

    run: str
    rows: list[Row]
    lamps: LampsSection | None
    simulator: Path
    watched: dict[str, Any] | None
    false_alarms: float


def work(task: LearnTask | LookTask) -> Any:
    """What the process does: a learned simulator's folder, or a :class:`flora_lab.serve.watching.Looked`."""
    looking = importlib.import_module("flora_lab.serve.looking")
    return looking.learned(task) if isinstance(task, LearnTask) else looking.looked(task)
