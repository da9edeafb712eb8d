"""Light schedules that a rig can run, to choose the next experiment from.

Turns of equal length are what ``flora-controller`` shines by in its open loop; its configuration is written here. Lists
of lamps and hours are read by ``flora-twin``; a rig needs a hand, or a timer, for them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from flora_common.arrays import Array
from flora_common.files import write_bytes
from flora_common.open_loop import OTHER, OpenLoopSection, Side
from flora_common.runs import LEVELS, Light
from flora_common.toml_strict import to_toml

DEFAULT: Final = "6 h"
"""What runs have as long as nobody asks for another one."""
_RANDOM_SEED: Final = 1
_DWELL_H: Final = (0.5, 10.0)
"""Of random turns; their logarithm is drawn evenly."""
_LONGEST_H: Final = 120.0


@dataclass(frozen=True, slots=True)
class Schedule:
    """A light schedule.

    Attributes:
        name: for people.
        phases: lamp and hours, one after another.
        turns_h: hours of each turn, where the lamps take equal turns for ever, left first; None where they do not.
    """

    name: str
    phases: tuple[tuple[Light, float], ...]
    turns_h: float | None = None

    @property
    def text(self) -> str:
        """As ``flora-twin`` reads it; see :func:`flora_twin.grow.parse_schedule`."""
        if self.turns_h is not None:
            return f"{self.turns_h:g}h"
        return ", ".join(f"{light} {hours:g}h" for light, hours in self.phases)

    def levels(self, steps: int, step_h: float) -> Array:
        """Levels of the left and right lamp in each step, shape (steps, 2)."""
        ends = np.cumsum([hours for _, hours in self.phases])
        at = (np.arange(steps) + 0.5) * step_h
        if self.turns_h is not None:
            at = at % ends[-1]
        phase = np.minimum(np.searchsorted(ends, at, side="right"), len(ends) - 1)
        return np.array([LEVELS[light] for light, _ in self.phases])[phase]


def turns(hours: float) -> Schedule:
    """Left and right in turn."""
    return Schedule(f"{hours:g} h", (("left", hours), ("right", hours)), hours)


def _random_turns() -> Schedule:
    """The same list for everyone, and longer than any run."""
    draw = np.random.default_rng(_RANDOM_SEED)
    side: Side = "left"
    phases: list[tuple[Light, float]] = []
    while sum(hours for _, hours in phases) < _LONGEST_H:
        hours = round(12.0 * float(np.exp(draw.uniform(*np.log(_DWELL_H))))) / 12.0
        phases.append((side, round(hours, 4)))
        side = OTHER[side]
    return Schedule("random turns", tuple(phases))


def _with_dark(hours: float) -> Schedule:
    """A dark phase after each lamp."""
    round_: tuple[tuple[Light, float], ...] = (("left", hours), ("dark", hours), ("right", hours), ("dark", hours))
    return Schedule("dark after each lamp", round_ * int(np.ceil(_LONGEST_H / (4.0 * hours))))


CHOICE: Final = (turns(6.0), turns(1.5), turns(24.0), turns(36.0), _random_turns(), _with_dark(6.0))
"""Schedules that are compared; the first is what runs have by default."""


class _Controller(msgspec.Struct, frozen=True):
    use: str
    open_loop: OpenLoopSection


class _Config(msgspec.Struct, frozen=True):
    controller: _Controller


def controller_config(schedule: Schedule) -> str:
    """The part of ``flora.toml`` that lets ``flora-controller`` shine by a schedule.

    Raises:
        ValueError: no equal turns.
    """
    if schedule.turns_h is None:
        raise ValueError(f"`{schedule.name}` is no schedule of equal turns")
    return to_toml(_Config(_Controller("open-loop", OpenLoopSection(schedule.turns_h, "left"))))


def write_experiment(path: Path, schedule: Schedule, *, hours: float, why: str) -> None:
    """Write an experiment as a file: what to put into a rig's ``flora.toml``, and why.

    Args:
        path: of the file, written whole or not at all.
        schedule: of equal turns.
        hours: how long the run is to last.
        why: sentences, written above as remarks.
    """
    remarks = [
        *why.splitlines(),
        f"A run of {hours:g} h. Put this into the rig's flora.toml in place of its [controller], and start a new run.",
        f'With a virtual plant: flora-twin grow --schedule "{schedule.text}" --hours {hours:g}',
    ]
    text = "".join(f"# {line}\n" for line in remarks) + "\n" + controller_config(schedule)
    write_bytes(path, text.encode())
