"""What came of each photograph of a sequence, and of all of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import msgspec
import numpy as np

from flora_common.runs import Light
from flora_common.vision.reading import BAD_PICTURE, PictureOutcome, StemReading
from flora_lab.sources import Frame


@dataclass(frozen=True, slots=True)
class Reading:
    """A frame's name, time and lamp, and what came of it; not its picture."""

    index: int
    name: str
    time_s: float
    light: Light
    covariates: dict[str, float]
    stem: StemReading


@dataclass(frozen=True, slots=True)
class Span:
    """The frames to use: first index, and the one after the last (None: to the end)."""

    first: int = 0
    end: int | None = None

    def indices(self, count: int) -> range:
        """Those of ``count`` frames that are in it."""
        return range(self.first, count if self.end is None else min(self.end, count))

    def take(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        for frame in frames:
            if self.end is not None and frame.index >= self.end:
                return
            if frame.index >= self.first:
                yield frame


class StoredReading(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A reading as text, and the method's memory after it; numbers keep every digit."""

    index: int
    name: str
    time_s: float
    light: Light
    covariates: dict[str, float]
    outcome: PictureOutcome
    quality: float
    points_cm: list[tuple[float, float]] | None
    tip_px: tuple[float, float] | None
    reason: str
    uncertainty_mm: list[float] | None
    folded: bool
    line_px: list[tuple[float, float]] | None
    stem_pixels: int
    tip_choice: Literal["c", "h"] | None
    memory: Any

    @classmethod
    def of(cls, reading: Reading, memory: object) -> StoredReading:
        s = reading.stem
        return cls(
            reading.index,
            reading.name,
            reading.time_s,
            reading.light,
            reading.covariates,
            s.outcome,
            s.quality,
            None if s.points_cm is None else s.points_cm.tolist(),
            s.tip_px,
            s.reason,
            None if s.uncertainty_mm is None else s.uncertainty_mm.tolist(),
            s.folded,
            None if s.line_px is None else s.line_px.tolist(),
            s.stem_pixels,
            s.tip_choice,
            memory,
        )

    def reading(self) -> Reading:
        stem = StemReading(
            self.outcome,
            self.quality,
            None if self.points_cm is None else np.array(self.points_cm),
            self.tip_px,
            self.reason,
            uncertainty_mm=None if self.uncertainty_mm is None else np.array(self.uncertainty_mm),
            folded=self.folded,
            line_px=None if self.line_px is None else np.array(self.line_px).reshape(-1, 2),
            stem_pixels=self.stem_pixels,
            tip_choice=self.tip_choice,
        )
        return Reading(self.index, self.name, self.time_s, self.light, self.covariates, stem)


class Summary:
    """What a whole sequence gave; grows as readings are added.

    Attributes:
        frames: how many were looked at.
        readings: how many gave a stem.
        folded: how many of these turn back.
        outcomes, lights: counts by name; lights of those with a stem.
        bad: reasons of bad pictures.
    """

    def __init__(self) -> None:
        self.frames = self.readings = self.folded = 0
        self.outcomes: Counter[str] = Counter()
        self.lights: Counter[str] = Counter()
        self.bad: list[str] = []
        self._quality_sum = 0.0

    def add(self, reading: Reading) -> None:
        self.frames += 1
        self.outcomes[reading.stem.outcome] += 1
        if reading.stem.points_cm is not None:
            self.readings += 1
            self.folded += reading.stem.folded
            self._quality_sum += reading.stem.quality
            self.lights[reading.light] += 1
        if reading.stem.outcome == BAD_PICTURE:
            self.bad.append(reading.stem.reason)

    @property
    def mean_quality(self) -> float:
        return self._quality_sum / self.readings if self.readings else 0.0

    def outcome_words(self) -> str:
        return ", ".join(f"{count} {name}" for name, count in self.outcomes.most_common())
