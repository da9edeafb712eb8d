"""One frame in, one stem out, whatever happened. Pictures, clocks and files are handed in or left to the caller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Final, get_args

import msgspec
import numpy as np

from flora_common.errors import BadInput, BadPicture
from flora_common.geometry import FloatArray
from flora_common.messages import Frame, FrameMissed, Stem
from flora_common.messages.catalogue import Outcome
from flora_common.runs import CameraSection, Light
from flora_common.vision.paper import PaperSettings, PaperTracker, StemReading, bad_picture
from flora_common.vision.picture import Picture
from flora_common.vision.setup import SetupMatrices
from flora_stem.record import StemRecord

LONGEST_REASON: Final = 500
FARTHEST_CM: Final = 500.0
"""A point farther away than the bus can say comes from a wrong scale in run.toml."""

NO_BACKGROUND: Final = "no background pictures; run flora-stem calibrate"


class StemSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[stem]``; ``[stem.paper]`` are the numbers of the published method."""

    largest_share: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.25
    """Where more of the picture than this differs from the empty setup, it is no plant but another light."""
    paper: PaperSettings = PaperSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """A line for ``track.csv``."""

    time_s: float
    light: Light
    points_cm: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What to say, and what to add to the track (None for nothing)."""

    stem: Stem
    row: Row | None = None


class StemCore:
    """Finds the stem in each frame, once per tick.

    Args:
        camera: size, anchor and scale.
        section: numbers of the method.
        record: where the last start was left.
        read: the picture of a frame, decoded and reduced; raises BadPicture.
        now_ms: a stopwatch, for ``took_ms`` alone.
    """

    def __init__(
        self,
        camera: CameraSection,
        section: StemSection,
        record: StemRecord,
        *,
        read: Callable[[Frame], Picture],
        now_ms: Callable[[], float],
    ) -> None:
        self._camera = camera
        self._section = section
        self._read = read
        self._now_ms = now_ms
        self._tracker: PaperTracker | None = None
        self._why_not = NO_BACKGROUND
        self.record = record

    @property
    def why_not(self) -> str:
        """Why no stem can be found at all; empty where it can."""
        return "" if self._tracker is not None else self._why_not

    def use(self, setup: SetupMatrices | None, why_not: str) -> None:
        """Look for what differs from this setup from now on; without one, say why there is none."""
        self._tracker, self._why_not = None, why_not or NO_BACKGROUND
        if setup is None:
            return
        try:
            self._tracker = PaperTracker(setup, self._camera, self._section.paper)
        except BadInput as problem:
            self._why_not = str(problem)

    def on_frame(self, frame: Frame) -> Answer | None:
        """The stem of a frame of the run; the same again for a tick that was answered; None for an older one."""
        began_ms = self._now_ms()
        before = self._before(frame.tick)
        if before is not None or frame.tick < self.record.tick:
            return before
        if self._tracker is None:
            reading = StemReading("no_stem", reason=self._why_not)
        else:
            self._tracker.tip_px = self.record.tip_px
            reading = self._reading(self._tracker, frame)
        points = reading.points_cm
        notes = [reading.reason]
        if not frame.flash_confirmed:
            notes.append("the flash was not confirmed")
        if not frame.exposure_ok:
            notes.append(f"exposure: {frame.exposure_note or 'not as locked'}")
        stem = Stem(
            tick=frame.tick,
            time_s=frame.time_s,
            outcome=_outcome(reading.outcome),
            points_cm=() if points is None else tuple((float(x), float(y)) for x, y in points),
            quality=min(max(reading.quality, 0.0), 1.0),
            light=frame.light,
            frame_sha256=frame.sha256,
            took_ms=max(0.0, self._now_ms() - began_ms),
            reason="; ".join(note for note in notes if note)[:LONGEST_REASON],
        )
        self.record = msgspec.structs.replace(
            self.record, tick=stem.tick, stem=stem, tip_px=reading.tip_px or self.record.tip_px
        )
        return Answer(
            stem, Row(frame.time_s, frame.light, points) if points is not None and stem.outcome == "ok" else None
        )

    def on_missed(self, missed: FrameMissed) -> Answer | None:
        """The answer for a tick without a photograph."""
        before = self._before(missed.tick)
        if before is not None or missed.tick < self.record.tick:
            return before
        reason = f"no photograph ({missed.because}): {missed.reason}"
        stem = Stem(tick=missed.tick, time_s=missed.time_s, outcome="no_frame", reason=reason[:LONGEST_REASON])
        self.record = msgspec.structs.replace(self.record, tick=stem.tick, stem=stem)
        return Answer(stem)

    def _before(self, tick: int) -> Answer | None:
        last = self.record.stem
        return Answer(last) if last is not None and last.tick == tick else None

    def _reading(self, tracker: PaperTracker, frame: Frame) -> StemReading:
        try:
            picture = self._read(frame)
            reading = tracker.read(picture)
        except BadPicture as problem:
            return bad_picture(str(problem))
        share = reading.stem_pixels / tracker.setup.L.size
        if share > self._section.largest_share:
            return bad_picture(
                f"{share:.0%} of the picture differ from the empty setup; flash, exposure or camera have changed"
            )
        points = reading.points_cm
        if points is not None and not (np.isfinite(points).all() and np.abs(points).max() <= FARTHEST_CM):
            return bad_picture(f"points more than {FARTHEST_CM:g} cm away; correct px_per_cm in run.toml")
        return reading


def _outcome(name: str) -> Outcome:
    """The catalogue's word; one that it does not know is told as ``no_stem``."""
    for known in get_args(Outcome):
        if name == known:
            word: Outcome = known
            return word
    return "no_stem"
