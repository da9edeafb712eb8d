"""From photographs to a track: the core of ``flora-lab track`` without command line, files or screen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from flora_common.errors import BadInput, BadPicture
from flora_common.runs import TRACK_HEADER, CameraSection, Light, track_line
from flora_common.vision import setup as setup_matrices
from flora_common.vision.paper import PaperSettings, PaperTracker, StemReading, bad_picture
from flora_common.vision.picture import Picture
from flora_common.vision.setup import SetupMatrices
from flora_lab.lights import LightRule
from flora_lab.sources import Frame, Source

LEARN_FROM_AT_MOST: Final = 60
"""Frames of each lamp state that the empty setup is learnt from, evenly spread; more would only cost memory."""


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

    def take(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        for frame in frames:
            if self.end is not None and frame.index >= self.end:
                return
            if frame.index >= self.first:
                yield frame

    def count(self, of: int) -> int:
        return max(0, (of if self.end is None else min(self.end, of)) - self.first)


class LightOf:
    """The lamp of a frame: what the source says, else what the rule says."""

    def __init__(self, rule: LightRule) -> None:
        self._rule = rule

    def __call__(self, frame: Frame, picture: Picture) -> Light:
        return frame.light if frame.light is not None else self._rule(frame.index, picture)


def setup_for(
    source: Source,
    background: Sequence[Path],
    settings: PaperSettings,
    light_of: LightOf,
    span: Span,
    *,
    on_frame: Callable[[], None] = lambda: None,
) -> dict[Light, SetupMatrices] | SetupMatrices:
    """Setup matrices from the background pictures; where there are none, one pair per lamp state from the frames.

    Raises:
        BadPicture: a background picture that cannot be used.
        BadInput: no background, and a lamp state with too few frames to learn from.
    """
    if background:
        return setup_matrices.from_files(background, reduction=settings.reduction, expected_size=source.size_px)
    # Lamp states are only known once a picture is decoded, so this goes through all frames and keeps a thinned set.
    kept: dict[Light, _Thinned] = {}
    for frame in span.take(source.frames()):
        on_frame()
        try:
            picture = frame.load(settings.reduction)
        except BadPicture:
            continue  # counted and reported when the frame is read
        kept.setdefault(light_of(frame, picture), _Thinned(LEARN_FROM_AT_MOST)).add(picture)
    learnt: dict[Light, SetupMatrices] = {}
    for light, thinned in kept.items():
        try:
            learnt[light] = setup_matrices.learn_from_frames(thinned.pictures)
        except BadPicture as problem:
            raise BadInput(f"{source.name}: no background pictures, and with light `{light}` {problem}") from problem
    return learnt


def read_frames(
    source: Source,
    setup: Mapping[Light, SetupMatrices] | SetupMatrices,
    camera: CameraSection,
    settings: PaperSettings,
    *,
    light_of: LightOf,
    span: Span,
    interval_s: float,
) -> Iterator[tuple[Reading, Frame]]:
    """Every frame of the span in order, and what came of it.

    A picture that cannot be used gives the outcome ``bad_picture`` and does not end the sequence.

    Raises:
        BadInput: the window holds no pixel above the anchor.
    """
    tracker: PaperTracker | None = None
    for frame in span.take(source.frames()):
        time_s = frame.time_s if frame.time_s is not None else frame.index * interval_s
        light: Light = frame.light or "dark"
        try:
            picture = frame.load(settings.reduction)
            light = light_of(frame, picture)
            matrices = setup if isinstance(setup, SetupMatrices) else setup[light]
            if tracker is None:
                tracker = _tracker(source.name, matrices, camera, settings)
            tracker.set_setup(matrices)
            stem = tracker.read(picture)
        except BadPicture as problem:
            stem = bad_picture(str(problem))
        yield Reading(frame.index, frame.name, time_s, light, frame.covariates, stem), frame


def _tracker(name: str, setup: SetupMatrices, camera: CameraSection, settings: PaperSettings) -> PaperTracker:
    try:
        return PaperTracker(setup, camera, settings)
    except BadInput as problem:
        raise BadInput(f"{name}: {problem}") from problem


@dataclass(slots=True)
class Summary:
    """What a whole sequence gave; grows as readings are added."""

    frames: int
    readings: int
    quality_sum: float
    outcomes: Counter[str]
    lights: Counter[str]
    bad: list[str]

    @classmethod
    def empty(cls) -> Summary:
        return cls(0, 0, 0.0, Counter(), Counter(), [])

    def add(self, reading: Reading) -> None:
        self.frames += 1
        self.outcomes[reading.stem.outcome] += 1
        if reading.stem.points_cm is not None:
            self.readings += 1
            self.quality_sum += reading.stem.quality
            self.lights[reading.light] += 1
        if reading.stem.outcome == "bad_picture":
            self.bad.append(reading.stem.reason)

    @property
    def mean_quality(self) -> float:
        return self.quality_sum / self.readings if self.readings else 0.0

    def outcome_words(self) -> str:
        return ", ".join(f"{count} {name}" for name, count in self.outcomes.most_common())


def track_text(readings: Sequence[Reading]) -> str:
    """``track.csv``: the readings with a stem, and the covariates that ``frames.csv`` gave them."""
    with_stem = [(r, r.stem.points_cm) for r in readings if r.stem.points_cm is not None]
    names = list(with_stem[0][0].covariates) if with_stem else []
    lines = [",".join([TRACK_HEADER, *names])]
    for r, points_cm in with_stem:
        lines.append(",".join([track_line(r.time_s, r.light, points_cm), *(f"{r.covariates[n]!r}" for n in names)]))
    return "\n".join(lines) + "\n"


class _Thinned:
    """Keeps at most ``most`` pictures of a stream of unknown length, evenly spaced."""

    def __init__(self, most: int) -> None:
        self.pictures: list[Picture] = []
        self._most = most
        self._step = 1
        self._seen = 0

    def add(self, picture: Picture) -> None:
        if self._seen % self._step == 0:
            self.pictures.append(picture)
            if len(self.pictures) > self._most:
                self.pictures = self.pictures[::2]
                self._step *= 2
        self._seen += 1
