"""One rig as the lab hears it: which run lasts, when it is time to look at it, and what is to be said.

Pure but for the folder in which all of it is kept: no bus, no clock, no mathematics.
"""

from __future__ import annotations

import contextlib
import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec

from flora_common import files
from flora_common.messages import ControllerState, Departure, Frame, Lamps, Recording, Stem
from flora_common.messages.envelope import as_sentence
from flora_common.runs import Light
from flora_lab.serve.heard import ROWS_FILE, Heard, Row, of_hours, row_of, whole_hours

STATE_FILE: Final = "watched.json"
LATE_TICKS: Final = 2.5
"""An hour is looked at so many ticks after its end: a stem may come late."""
_LAMPS_KEPT: Final = 50
_AHEAD: Final = 12
"""Ticks without a photograph after the last one that is known to be of this run, that are taken for its own."""
_USUAL_S: Final = 300.0


class Looked(msgspec.Struct, frozen=True):
    """What a look at a run found.

    Attributes:
        watched: a :class:`flora_lab.serve.departing.Watched` as plain values; kept as it is.
        hours: that were looked at by now.
        departed_at: hour; None where the plant is as expected.
        error_mm: of the tip, to the right and upwards.
        expected_mm: what is allowed.
        is_watched: whether it was compared with a plant that had been watched.
        sentence: about it.
    """

    watched: dict[str, Any]
    hours: int
    departed_at: int | None
    error_mm: tuple[float, float]
    expected_mm: float
    is_watched: bool
    sentence: str


class _Kept(msgspec.Struct, frozen=True):
    """``watched.json``.

    Attributes:
        against: the simulator's identity; what was found against another one is forgotten.
        watched: of the last look.
        hours: that it was about.
        said_departed: what was said last.
        to_say: what is to be said and was not yet.
    """

    against: str = ""
    watched: dict[str, Any] | None = None
    hours: int = 0
    said_departed: bool = False
    to_say: Departure | None = None


@dataclass(frozen=True, slots=True)
class Look:
    """A look that is due.

    Attributes:
        run: its name.
        rows: of all hours up to now.
        watched: what was found before; None at the first look, or against another simulator.
        hours: that will have been looked at.
    """

    run: str
    rows: list[Row]
    watched: dict[str, Any] | None
    hours: int


class Watch:
    """One rig.

    Args:
        folder: where what was heard of its runs is kept, a folder per run.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.run = ""
        self._is_stopped = self._is_closed = False
        self._heard: Heard | None = None
        self._kept = _Kept()
        self._lit: dict[int, Light] = {}
        self._tick = 0
        last = _newest(folder)
        if last is not None:
            self._take_up(last.name)

    @property
    def heard(self) -> Heard | None:
        """Of the run that lasts, or lasted last."""
        return self._heard

    @property
    def is_over(self) -> bool:
        """Whether the bus said that the run is over."""
        return self._is_stopped or self._is_closed

    def on_frame(self, frame: Frame) -> bool:
        """Which run it is; True where another one begins."""
        if frame.purpose != "run":
            return False
        is_other = frame.run != self.run
        if is_other:
            self._take_up(frame.run)
        self._tick = max(self._tick, frame.tick)
        return is_other

    def on_lamps(self, lamps: Lamps) -> None:
        """What is lit from this tick on."""
        self._lit[lamps.tick] = lamps.lit
        while len(self._lit) > _LAMPS_KEPT:
            del self._lit[next(iter(self._lit))]

    def on_controller(self, said: ControllerState) -> None:
        """A stop rule that holds ends the run."""
        self._is_stopped = said.run_over

    def on_recording(self, said: Recording) -> None:
        """The recorder closes its file at the end, and opens another one at once where it goes on."""
        self._is_closed = said.closed

    def on_stem(self, stem: Stem) -> bool:
        """A tick; True where it is new.

        Raises:
            DiskFull: it could not be kept.
        """
        if self._heard is None or stem.tick > self._tick + _AHEAD:
            return False  # what the bus kept of a run before
        row = row_of(stem, self._lit)
        told = self._heard.tell(row)
        if told == "another run":
            self._set_aside(self._heard)
            self._take_up(self.run)
            told = "new"
        if told == "new":
            self._heard.add(row)
            self._tick = max(self._tick, stem.tick)
        return told == "new"

    def look(self, against: str) -> Look | None:
        """A look at the run, where an hour more has ended.

        Args:
            against: the simulator's identity.
        """
        if self._heard is None:
            return None
        rows = self._heard.rows
        late_s = LATE_TICKS * _interval_s(rows)
        hours = whole_hours(rows, late_s)
        is_same = self._kept.against == against
        if hours <= (self._kept.hours if is_same else 0):
            return None
        return Look(self.run, of_hours(rows, hours, late_s), self._kept.watched if is_same else None, hours)

    def take(self, look: Look, looked: Looked, against: str) -> None:
        """Keep what a look found; what is to be said is in :attr:`to_say` until :meth:`said`.

        Raises:
            DiskFull: no room; the next look finds it again.
        """
        if look.run != self.run:
            return
        departed = looked.departed_at is not None
        was = self._kept.said_departed
        to_say = self._kept.to_say
        if departed != was:
            to_say = Departure(
                tick=self._tick,
                run=look.run,
                is_departed=departed,
                hours=looked.hours,
                tip_error_mm=_within(float((looked.error_mm[0] ** 2 + looked.error_mm[1] ** 2) ** 0.5)),
                right_mm=_within(looked.error_mm[0]),
                up_mm=_within(looked.error_mm[1]),
                expected_mm=_within(looked.expected_mm),
                compared_with="watched" if looked.is_watched else "typical",
                sentence=as_sentence(looked.sentence),
            )
        self._keep(_Kept(against, looked.watched, look.hours, departed, to_say))

    @property
    def to_say(self) -> Departure | None:
        """That the plant departs, or is as expected again."""
        return self._kept.to_say

    def said(self) -> None:
        """It was said.

        Raises:
            DiskFull: no room; it may be said again after a restart.
        """
        self._keep(msgspec.structs.replace(self._kept, to_say=None))

    def finish(self) -> None:
        """The run has ended: what was heard of it becomes a track, where its folder is not to be had.

        Raises:
            DiskFull: no room.
        """
        if self._heard is not None:
            self._heard.write_track()

    def _take_up(self, run: str) -> None:
        self.run, self._is_stopped, self._is_closed, self._tick, self._lit = run, False, False, 0, {}
        self._heard = Heard(self.folder / run)
        self._kept = _read(self.folder / run / STATE_FILE)
        if len(self._heard):
            self._tick = self._heard.rows[-1].tick

    def _keep(self, kept: _Kept) -> None:
        self._kept = kept
        files.write_bytes(self.folder / self.run / STATE_FILE, msgspec.json.encode(kept))

    def _set_aside(self, heard: Heard) -> None:
        """A run of the same name was begun anew; what was heard of the old one stays, under another name."""
        number = 1
        while (aside := heard.folder.with_name(f"{heard.folder.name}.{number}")).exists():
            number += 1
        heard.write_track()
        heard.folder.rename(aside)


def _read(path: Path) -> _Kept:
    """What was kept; nothing where another version of flora wrote it, so that the run is looked at from its start."""
    with contextlib.suppress(FileNotFoundError, ValueError, RecursionError):
        return msgspec.json.decode(path.read_bytes(), type=_Kept)
    return _Kept()


def _newest(folder: Path) -> Path | None:
    """The run that was heard last."""
    rows = sorted(folder.glob(f"*/{ROWS_FILE}"), key=lambda path: path.stat().st_mtime_ns)
    return rows[-1].parent if rows else None


def _interval_s(rows: list[Row]) -> float:
    """Between ticks."""
    between = sorted(b.time_s - a.time_s for a, b in itertools.pairwise(rows))
    return between[len(between) // 2] if between else _USUAL_S


def _within(mm: float) -> float:
    return min(max(mm, -10_000.0), 10_000.0)
