"""Light schedules that a rig can run, to choose the next experiment from.

Each is written as a light plan, by which ``flora-controller`` steers; ``flora-twin grow`` reads the same text.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_common.light_plan import LightPlan, write_light_plan
from flora_common.open_loop import OTHER, Side
from flora_common.runs import LEVELS, Light

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
    def words(self) -> str:
        """In a sentence."""
        return self.name if self.turns_h is None else f"turns of {self.name}"

    def text_of(self, hours: float) -> str:
        """What a light plan says of a run of so many hours, the last light stays on; see
        :func:`flora_common.light_schedule.parse_schedule`."""
        if self.turns_h is not None:
            return f"{self.turns_h:g}h"
        begins = np.cumsum([0.0, *(length for _, length in self.phases)])
        *before, last = self.phases[: int(np.searchsorted(begins, hours))]
        return ", ".join([*(f"{light} {length:g}h" for light, length in before), last[0]])

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


USUAL: Final = turns(6.0)
"""What runs have as long as nobody asks for another one."""
CHOICE: Final = (USUAL, turns(1.5), turns(24.0), turns(36.0), _random_turns(), _with_dark(6.0))
"""Schedules that are compared; the first is what runs have by default."""


def write_experiment(path: Path, schedule: str, *, hours: float, why: str) -> None:
    """Write an experiment as a light plan, and why.

    Args:
        path: of the file, written whole or not at all.
        schedule: of the lamps, as a light plan says it.
        hours: how long the run is to last.
        why: sentences, written above as remarks.
    """
    remarks = [
        *why.splitlines(),
        "On a rig: copy this file to it, put its path into flora.toml as `use` of [controller], and start a new run.",
        f'With a virtual plant: flora-twin grow --schedule "{schedule}" --hours {hours:g}',
    ]
    write_light_plan(path, LightPlan(schedule, hours), remarks)
