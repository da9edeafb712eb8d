"""One frame in, one stem out, whatever happened. Pictures, clocks and files are handed in or left to the caller."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from flora_common.arrays import FloatArray
from flora_common.errors import BadPicture, FloraError
from flora_common.messages import Frame, FrameMissed, Stem
from flora_common.messages.envelope import as_sentence
from flora_common.runs import Light
from flora_common.shapes import FARTHEST_CM
from flora_common.vision.picture import Picture
from flora_common.vision.reading import OCCLUDED, OK, StemReading, bad_picture, no_stem
from flora_stem.background import NO_BACKGROUND
from flora_stem.finder import Finder, Method
from flora_stem.record import StemRecord

IN_TRACK: Final = (OK, OCCLUDED)
"""Outcomes whose stem is written to the track, with its uncertainty."""


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """A line for ``track.csv``."""

    time_s: float
    light: Light
    points_cm: FloatArray
    extras: dict[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What to say, and what to add to the track (None for nothing)."""

    stem: Stem
    row: Row | None = None


class StemCore:
    """Finds the stem in each frame, once per tick.

    Args:
        method: its name, for the messages.
        record: where the last start was left.
        read: the picture of a frame, decoded and reduced; raises BadPicture.
        now_ms: a stopwatch, for ``took_ms`` alone.
    """

    def __init__(
        self,
        method: Method,
        record: StemRecord,
        *,
        read: Callable[[Frame], Picture],
        now_ms: Callable[[], float],
    ) -> None:
        self._method = method
        self._read = read
        self._now_ms = now_ms
        self._finder: Finder | None = None
        self._why_not = NO_BACKGROUND
        self.record = record

    @property
    def why_not(self) -> str:
        """Why no stem can be found at all; empty where it can."""
        return "" if self._finder is not None else self._why_not

    def use(self, finder: Finder | None, why_not: str) -> None:
        """Look for stems with this from now on; without one, say why there is none."""
        self._finder, self._why_not = finder, why_not or NO_BACKGROUND

    def on_frame(self, frame: Frame) -> Answer | None:
        """The stem of a frame of the run; the same again for a tick that was answered; None for an older one."""
        began_ms = self._now_ms()
        before = self._before(frame.tick)
        if before is not None or frame.tick < self.record.tick:
            return before
        self._forget_another_run(frame.time_s)
        if self._finder is None:
            reading = no_stem(self._why_not)
        else:
            self._finder.recall(self.record)
            reading = self._reading(self._finder, frame)
        points = reading.points_cm
        notes = [reading.reason]
        if not frame.flash_confirmed:
            notes.append("the flash was not confirmed")
        if not frame.exposure_ok:
            notes.append(f"exposure: {frame.exposure_note or 'not as locked'}")
        stem = Stem(
            tick=frame.tick,
            time_s=frame.time_s,
            outcome=reading.outcome,
            points_cm=() if points is None else tuple((float(x), float(y)) for x, y in points),
            quality=min(max(reading.quality, 0.0), 1.0),
            light=frame.light,
            method=self._method,
            folded=reading.folded,
            uncertainty_mm=() if reading.uncertainty_mm is None else _millimetres(reading.uncertainty_mm),
            frame_sha256=frame.sha256,
            run=frame.run,
            took_ms=max(0.0, self._now_ms() - began_ms),
            reason=as_sentence("; ".join(note for note in notes if note)),
        )
        self.record = msgspec.structs.replace(self.record, tick=stem.tick, stem=stem)
        if points is not None and self._finder is not None:
            self.record = self._finder.remembered(self.record)
        if points is None or stem.outcome not in IN_TRACK:
            return Answer(stem)
        return Answer(stem, Row(frame.time_s, frame.light, points, _extras(reading)))

    def on_missed(self, missed: FrameMissed) -> Answer | None:
        """The answer for a tick without a photograph."""
        before = self._before(missed.tick)
        if before is not None or missed.tick < self.record.tick:
            return before
        self._forget_another_run(missed.time_s)
        reason = f"no photograph ({missed.because}): {missed.reason}"
        stem = Stem(tick=missed.tick, time_s=missed.time_s, outcome="no_frame", reason=as_sentence(reason))
        self.record = msgspec.structs.replace(self.record, tick=stem.tick, stem=stem)
        return Answer(stem)

    def _forget_another_run(self, time_s: float) -> None:
        """Numbers go on; where times do not, the run was begun under the name of the last, with another plant."""
        last = self.record.stem
        if last is not None and time_s < last.time_s:
            self.record = StemRecord(run=self.record.run)

    def _before(self, tick: int) -> Answer | None:
        last = self.record.stem
        return Answer(last) if last is not None and last.tick == tick else None

    def _reading(self, finder: Finder, frame: Frame) -> StemReading:
        try:
            reading = finder.read(self._read(frame), frame.time_s)
        except BadPicture as problem:
            return bad_picture(str(problem))
        except FloraError:
            raise  # it is not the picture
        except Exception as problem:  # noqa: BLE001 - the bus keeps this picture: who ended here would end at each start
            return bad_picture(f"the stem finder failed, please report it: {_where(problem)}")
        points = reading.points_cm
        # a point farther away than the bus can say comes from a wrong scale in run.toml
        if points is not None and not (np.isfinite(points).all() and np.abs(points).max() <= FARTHEST_CM):
            return bad_picture(f"points more than {FARTHEST_CM:g} cm away; correct px_per_cm in run.toml")
        return reading


def _where(problem: Exception) -> str:
    """What went wrong and in which line of which file, on one line."""
    last = traceback.extract_tb(problem.__traceback__)[-1]
    said = " ".join(str(problem).split())
    return f"{type(problem).__name__} at {Path(last.filename).name}:{last.lineno}: {said}"


def _extras(reading: StemReading) -> dict[str, float]:
    """Further columns of the track."""
    tip_mm = float(reading.uncertainty_mm[-1]) if reading.uncertainty_mm is not None else 0.0
    return {
        "quality": round(reading.quality, 3),
        "folded": float(reading.folded),
        "tip_uncertainty_mm": round(tip_mm, 3),
    }


def _millimetres(values: FloatArray) -> tuple[float, ...]:
    return tuple(round(min(float(v), 10_000.0), 3) for v in values)
