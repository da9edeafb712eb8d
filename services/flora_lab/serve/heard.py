"""What was heard of one run, kept line by line, so that a restart in the middle of a run loses nothing."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import Final, Literal

import msgspec

from flora_common import files
from flora_common.messages import Stem
from flora_common.runs import Light, track_text
from flora_common.shapes import STEM_POINTS

ROWS_FILE: Final = "heard.jsonl"
TRACK_FILE: Final = "track.csv"
FOUND: Final = ("ok", "occluded")
"""Outcomes with a stem that counts, as in the rig's own track."""

Told = Literal["new", "known", "another run"]


class Row(msgspec.Struct, frozen=True):
    """One tick.

    Attributes:
        tick, time_s: of the photograph.
        light: lamp that shone before it; None where nobody told.
        points_cm: ten points; none where no stem was found.
        frame_sha256: of the photograph.
    """

    tick: int
    time_s: float
    light: Light | None
    points_cm: tuple[tuple[float, float], ...] = ()
    frame_sha256: str = ""


def row_of(stem: Stem, lit: Mapping[int, Light]) -> Row:
    """A tick from what was said of it.

    Args:
        stem: the tick's.
        lit: lamps that were lit from each tick on: where there is no photograph to say what shone before it.
    """
    light = lit.get(stem.tick - 1) if stem.outcome == "no_frame" else stem.light
    is_stem = stem.outcome in FOUND and len(stem.points_cm) == STEM_POINTS
    return Row(stem.tick, stem.time_s, light, stem.points_cm if is_stem else (), stem.frame_sha256)


class Heard:
    """All ticks of one run that were heard, by time.

    Args:
        folder: where they are kept.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._by_ms: dict[int, Row] = {row_ms(row): row for row in _read(folder / ROWS_FILE)}

    @property
    def rows(self) -> list[Row]:
        """In order of time."""
        return [self._by_ms[ms] for ms in sorted(self._by_ms)]

    def __len__(self) -> int:
        return len(self._by_ms)

    def tell(self, row: Row) -> Told:
        """Whether a tick is new, was here before, or is of another run: of the same time, with another photograph."""
        known = self._by_ms.get(row_ms(row))
        if known is None:
            return "new"
        differs = bool(known.frame_sha256 and row.frame_sha256) and known.frame_sha256 != row.frame_sha256
        return "another run" if differs else "known"

    def add(self, row: Row) -> None:
        """Keep a new tick; a late one finds its place.

        Raises:
            DiskFull: no room; it is not kept.
        """
        is_last = not self._by_ms or row_ms(row) > max(self._by_ms)
        by_ms = {**self._by_ms, row_ms(row): row}
        if is_last:
            files.append_line(self.folder / ROWS_FILE, _line(row))
        else:
            files.write_text(self.folder / ROWS_FILE, "".join(f"{_line(by_ms[ms])}\n" for ms in sorted(by_ms)))
        self._by_ms = by_ms

    def write_track(self) -> None:
        """The ticks with a stem as ``track.csv``, if there are two at least; a run that went on has another one.

        Raises:
            DiskFull: no room.
        """
        track = self.folder / TRACK_FILE
        rows = [row for row in self.rows if row.points_cm]
        if len(rows) < 2:
            return
        lights = [row.light or "dark" for row in rows]
        text = track_text([row.time_s for row in rows], lights, [row.points_cm for row in rows])
        if not track.exists() or track.read_bytes() != text.encode():
            files.write_text(track, text)


def row_ms(row: Row) -> int:
    """A table has milliseconds: a time that reads the same is the same."""
    return round(1000.0 * row.time_s)


def whole_hours(rows: list[Row], late_s: float) -> int:
    """Hours since the first stem that have ended, and of which no late one is to come."""
    times = [row.time_s for row in rows if row.points_cm]
    return int((times[-1] - times[0] - late_s) // 3600.0) if times and times[-1] > times[0] + late_s else 0


def of_hours(rows: list[Row], hours: int, late_s: float) -> list[Row]:
    """The rows up to the end of so many hours since the first stem."""
    first_s = next(row.time_s for row in rows if row.points_cm)
    return [row for row in rows if first_s <= row.time_s <= first_s + 3600.0 * hours + late_s]


def _line(row: Row) -> str:
    return msgspec.json.encode(row).decode()


def _read(path: Path) -> list[Row]:
    """Rows that were kept; a line that was torn by a power cut is none."""
    if not path.exists():
        return []
    rows = []
    for line in path.read_bytes().splitlines():
        with contextlib.suppress(ValueError, RecursionError):
            rows.append(msgspec.json.decode(line, type=Row))
    return rows
