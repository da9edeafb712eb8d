"""The course of a run, a row per measured stem: what the charts are drawn from."""

from __future__ import annotations

from typing import Final

import msgspec

from flora_common import files
from flora_common.messages import Stem
from flora_common.runs import TRACK_HEADER, Light, RunFolder, known_light
from flora_common.shapes import Target
from flora_common.tables import finite_number, read_csv

MOST_ROWS: Final = 20_000
"""Ten weeks of a photograph every five minutes; then the oldest go."""


class Row(msgspec.Struct, frozen=True, array_like=True):
    """One photograph.

    Attributes:
        time_s: since the run's start.
        light: lamp that shone before it was taken.
        outcome: of the measurement.
        x_cm, y_cm: the tip, from the anchor, x right, y up; None where no stem was found.
        fitness: the paper's F of that tip; None without tip or target.
    """

    time_s: float
    light: Light
    outcome: str
    x_cm: float | None = None
    y_cm: float | None = None
    fitness: float | None = None


class Rows(msgspec.Struct, frozen=True):
    """Some rows, and the number of the first."""

    begin: int
    rows: list[Row]


class History:
    """Rows in the order of their times. One thread adds to it, others may read.

    Args:
        target: of the run.
        most: rows that are kept.
    """

    def __init__(self, target: Target | None, *, most: int = MOST_ROWS) -> None:
        # F has no meaning for a target at the anchor.
        self._target = target if target is not None and (target.x_cm or target.y_cm) else None
        self._most = most
        # Replaced when the oldest go, so that no reader sees numbers of the one and rows of the other.
        self._kept = Rows(0, [])
        self._tick = 0

    @property
    def begin(self) -> int:
        """Number of the oldest row."""
        return self._kept.begin

    @property
    def end(self) -> int:
        """Number of the row that comes next."""
        kept = self._kept
        return kept.begin + len(kept.rows)

    def since(self, number: int) -> Rows:
        """All rows from this number on that are kept."""
        kept = self._kept
        begin = max(number, kept.begin)
        return Rows(begin, kept.rows[begin - kept.begin :])

    def hear(self, stem: Stem) -> None:
        """A measurement; one that is no later than the last is here already.

        A later tick at an earlier time is of another run, such as one that was begun under the name of the last:
        numbers go on, times do not. The rows of the run before go.
        """
        if 0 < self._tick < stem.tick and self._kept.rows and stem.time_s < self._kept.rows[-1].time_s:
            # A number is left out, by which pages that are open see that theirs have gone.
            self._kept = Rows(self.end + 1, [])
        self._tick = max(self._tick, stem.tick)
        tip = stem.points_cm[-1] if stem.points_cm else None
        self._add(stem.time_s, stem.light, stem.outcome, tip)

    def read(self, run: RunFolder) -> None:
        """What the run's track tells of the time before.

        Raises:
            BadRunFolder: the track is damaged; the rows before the damage are there.
        """
        if not files.is_file(run.track_csv):
            return  # of a folder that is closed to us run.toml tells
        columns = TRACK_HEADER.split(",")
        for line, values in read_csv(run.track_csv, columns):
            where = f"{run.track_csv} line {line}"
            x_cm, y_cm = (finite_number(values[name], name, where) for name in columns[-2:])
            time_s = finite_number(values["time_s"], "time_s", where)
            self._add(time_s, known_light(values["light"], where), "ok", (x_cm, y_cm))

    def _add(self, time_s: float, light: Light, outcome: str, tip_cm: tuple[float, float] | None) -> None:
        rows = self._kept.rows
        if rows and time_s <= rows[-1].time_s:
            return
        if tip_cm is None:
            rows.append(Row(time_s, light, outcome))
        else:
            fitness = None if self._target is None else self._target.fitness(*tip_cm)
            rows.append(Row(time_s, light, outcome, *tip_cm, fitness))
        if len(rows) > self._most:
            # Some at once, so that the rest is not copied for each.
            gone = max(1, self._most // 20)
            self._kept = Rows(self._kept.begin + gone, rows[gone:])
